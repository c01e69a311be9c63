"""What a run found: the final estimate with its deviations, and how far it may be believed."""
