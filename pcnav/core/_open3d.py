"""Open3D, made importable: the only module that imports it."""

import ctypes
import importlib
import sys
from functools import lru_cache
from types import ModuleType


@lru_cache(maxsize=1)
def open3d() -> ModuleType:
    """The module open3d, imported when it is first needed: that takes about a second.

    Its wheels are linked against ``libusb-1.0.so.0`` (for depth cameras pcnav never opens) without
    carrying it, and slim Linux systems lack it. A library already loaded under that name satisfies
    the link, so it is loaded first: the system's own, or else the one of `libusb_package`.
    """
    if sys.platform == "linux":
        try:
            ctypes.CDLL("libusb-1.0.so.0", mode=ctypes.RTLD_GLOBAL)
        except OSError:
            libusb = importlib.import_module("libusb_package")
            ctypes.CDLL(str(libusb.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    module = importlib.import_module("open3d")
    # It prints its own warnings on standard output, where they would mix with tables and bars.
    module.utility.set_verbosity_level(module.utility.VerbosityLevel.Error)
    return module
