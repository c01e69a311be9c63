"""Depth sequences: one reader per format behind `Sequence`, and the writer of our own."""
