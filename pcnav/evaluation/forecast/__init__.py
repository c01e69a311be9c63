"""Where a target and its points will be: the future of a run's last estimate."""
