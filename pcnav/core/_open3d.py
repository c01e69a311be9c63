"""Open3D, made importable: the only module that imports it."""

import ctypes
import importlib
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from types import ModuleType
from typing import Any

_PLOTS = "open3d.visualization.draw_plotly"
_PLOT_FUNCTIONS = ("get_plotly_fig", "draw_plotly", "draw_plotly_server")


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
    with _plots_left_out():
        module = importlib.import_module("open3d")
    # It prints its own warnings on standard output, where they would mix with tables and bars.
    module.utility.set_verbosity_level(module.utility.VerbosityLevel.Error)
    return module


@contextmanager
def _plots_left_out() -> Iterator[None]:
    """Import Open3D without its plots in a browser, whose web server takes longer to import than
    all else of it; who asks for a plot has them imported then."""
    if _PLOTS in sys.modules or "open3d" in sys.modules:
        yield
        return
    later = ModuleType(_PLOTS)
    for name in _PLOT_FUNCTIONS:
        setattr(later, name, _imported_when_called(name))
    sys.modules[_PLOTS] = later
    try:
        yield
    finally:
        del sys.modules[_PLOTS]


def _imported_when_called(name: str) -> Callable[..., Any]:
    def call(*args: Any, **options: Any) -> Any:
        return getattr(importlib.import_module(_PLOTS), name)(*args, **options)

    return call
