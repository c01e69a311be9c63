"""Appl. Sci. 2022, 12, 12625, rebuilt: a nutating satellite seen by one camera."""
