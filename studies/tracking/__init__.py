"""The tracker against its bars by Monte Carlo: starts, blackouts, consistency, faults, scenes."""
