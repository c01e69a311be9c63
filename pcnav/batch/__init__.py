"""Many runs over a grid of cases: what is run, where, and what is kept of it."""
