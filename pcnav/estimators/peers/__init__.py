"""What can be put to the test: pcnav in its modes, and its peers on the same frames."""
