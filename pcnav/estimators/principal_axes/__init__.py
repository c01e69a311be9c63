"""Motion in the unique principal axes, from stereo features (Hu 2024)."""
