"""Comparison of a run with the truth, and the report of a run."""
