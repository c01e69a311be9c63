"""Truth and a simulated depth sensor: the only producer of synthetic sequences."""
