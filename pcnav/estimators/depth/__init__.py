"""The estimator on depth frames: acquisition, tracking, the 20-state filter (Yu 2019)."""
