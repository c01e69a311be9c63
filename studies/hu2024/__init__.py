"""Hu, Wu, Meng and Wu 2024: relative motion in the unique principal axes, from stereo features."""
