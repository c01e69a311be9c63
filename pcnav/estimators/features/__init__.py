"""What the estimators on feature tracks share: points, their map and the frame they span."""
