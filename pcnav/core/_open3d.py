"""Open3D, made importable: the only module that imports it.

Open3D's wheels are linked against ``libusb-1.0.so.0`` (for depth cameras pcnav never opens) without
carrying it, and slim Linux systems lack it. A library already loaded under that name satisfies
the link, so it is loaded first: the system's own, or else the one `libusb_package` carries.

The import takes about a second: modules that a command line start reaches must not import this one
at their top.
"""

import ctypes
import sys


def _load_libusb() -> None:
    """Load libusb into the process, so that the import of Open3D finds it."""
    if sys.platform != "linux":
        return  # The wheels of the other systems carry what they need.
    try:
        ctypes.CDLL("libusb-1.0.so.0", mode=ctypes.RTLD_GLOBAL)
    except OSError:
        import libusb_package

        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)


_load_libusb()

import open3d  # noqa: E402

# Open3D prints its own warnings on standard output, where they would mix with tables and progress
# bars; whatever matters to a caller reaches it as a return value or an exception.
open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)

__all__ = ["open3d"]
