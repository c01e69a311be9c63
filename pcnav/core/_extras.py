"""The libraries of the extras `images`, `formats`, `bags` and `bench`, imported when needed."""

import importlib
from types import ModuleType

from pcnav.core.errors import InputError


def opencv(needed_for: str) -> ModuleType:
    """The module cv2. Raises `InputError` where it is not installed."""
    return _module("cv2", "OpenCV", "images", needed_for)


def openexr(needed_for: str) -> ModuleType:
    """The module OpenEXR. Raises `InputError` where it is not installed."""
    return _module("OpenEXR", "OpenEXR", "formats", needed_for)


def poselib(needed_for: str) -> ModuleType:
    """The module PoseLib. Raises `InputError` where it is not installed."""
    return _module("poselib", "PoseLib", "images", needed_for)


def rosbags(part: str, needed_for: str) -> ModuleType:
    """A module of rosbags, like "rosbag2". Raises `InputError` where it is not installed."""
    return _module(f"rosbags.{part}", "rosbags", "bags", needed_for)


def mcap(part: str, needed_for: str) -> ModuleType:
    """A module of mcap, like "stream_reader". Raises `InputError` where it is not installed."""
    return _module(f"mcap.{part}", "mcap", "bags", needed_for)


def small_gicp(needed_for: str) -> ModuleType:
    """The module small_gicp. Raises `InputError` where it is not installed."""
    return _module("small_gicp", "small_gicp", "bench", needed_for)


def _module(name: str, title: str, extra: str, needed_for: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        expected = f"expected the extra `{extra}` to be installed, which brings {title}"
        raise InputError(name, "module", f"{expected}, for {needed_for}") from error
