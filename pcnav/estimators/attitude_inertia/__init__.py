"""Attitude, rate and inertia ratios from attitudes alone (Deng 2024)."""
