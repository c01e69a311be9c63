"""pcnav: pose, motion, mass centre and inertia of a tumbling satellite from depth frames."""

__version__ = "0.1.0"
