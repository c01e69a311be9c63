"""What an estimator answers, and the result folder that keeps it."""
