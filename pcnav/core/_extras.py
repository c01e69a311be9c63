"""The libraries of the extras in pyproject.toml, imported when needed."""

import importlib
from importlib.util import find_spec
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


def rerun(needed_for: str) -> ModuleType:
    """The module rerun. Raises `InputError` where it is not installed."""
    return _module("rerun", "rerun-sdk", "rerun", needed_for)


def small_gicp(needed_for: str) -> ModuleType:
    """The module small_gicp. Raises `InputError` where it is not installed."""
    return _module("small_gicp", "small_gicp", "peers", needed_for)


def kiss_icp(needed_for: str) -> ModuleType:
    """The module kiss_icp. Raises `InputError` where it is not installed."""
    return _module("kiss_icp", "KISS-ICP", "peers", needed_for)


def require_view(needed_for: str) -> None:
    """Raise `InputError` where the web view is not installed; imports nothing."""
    _require(("viser", "msgspec", "zstandard"), "view", needed_for)


def require_batch(needed_for: str) -> None:
    """Raise `InputError` where what batches of runs take is not installed; imports nothing."""
    _require(("distributed", "pandas", "pyarrow"), "batch", needed_for)


def _require(names: tuple[str, ...], extra: str, needed_for: str) -> None:
    for name in names:
        if find_spec(name) is None:
            raise _missing(name, name, extra, needed_for)


def _module(name: str, title: str, extra: str, needed_for: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise _missing(name, title, extra, needed_for) from error


def _missing(name: str, title: str, extra: str, needed_for: str) -> InputError:
    expected = f"expected the extra `{extra}` to be installed, which brings {title}"
    return InputError(name, "module", f"{expected}, for {needed_for}: pip install 'pcnav[{extra}]'")
