"""Relative orbital motion and torque-free rotation."""
