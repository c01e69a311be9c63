"""The web view of a run."""
