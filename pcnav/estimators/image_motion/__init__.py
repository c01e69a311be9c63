"""Attitude and rate of a target from one camera's feature tracks (Appl. Sci. 2022, 12, 12625)."""
