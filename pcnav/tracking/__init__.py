"""The tracker: perception and filter joined, one frame in, one estimate out."""

from pcnav.status import Status
from pcnav.tracking.tracker import Tracker

__all__ = ["Status", "Tracker"]
