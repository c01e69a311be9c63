"""The tracker against its bars: cold starts, blackouts, consistency and faults, by Monte Carlo."""
