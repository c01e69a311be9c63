"""A bank of filters over hypotheses of the inertia, from stereo features (Segal 2011)."""
