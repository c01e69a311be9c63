"""Loaded by a worker as it starts: it then is of another version of pcnav."""

import pcnav

pcnav.__version__ = "0.0.1"
