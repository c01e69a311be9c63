"""Which states the motion of a run or of a pipeline makes observable, and how soon."""
