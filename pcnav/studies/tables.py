"""A table of a study: one value that is written as CSV, as Markdown and on the terminal."""

from pcnav.evaluation.text_table import TextTable as StudyTable

__all__ = ["StudyTable"]
