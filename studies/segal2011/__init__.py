"""Segal, Carmi and Gurfil 2011: relative state of a target of unknown inertia from stereo."""
