"""Which topic of a bag holds the depth images, and which its camera: chosen, or guessed."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from pcnav.core.errors import InputError
from pcnav.recordings.bag_images import CLOUD, COMPRESSED, IMAGE

CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
_COLOUR = ("color", "colour", "rgb", "infra", "mono", "confidence", "mask", "camera_info")
_MAX_LISTED = 12


def depth_topic(path: Path, kinds: Mapping[str, str], chosen: str | None) -> str:
    """The topic of the depth images, of those of a bag with the kinds of their messages.

    Without a choice: raw images of depth by their names before compressed ones before clouds.
    Raises `InputError`, which lists them, where that leaves none or several.
    """
    if chosen is not None:
        if kinds.get(chosen) not in (IMAGE, COMPRESSED, CLOUD):
            expected = f"expected a topic of images or clouds: {_listed(_of(kinds))}"
            raise InputError(path, "--topic", f"{expected}; got {chosen}")
        return chosen
    raw = [t for t in _of(kinds, IMAGE) if "depth" in t.lower()]
    packed = [t for t in _of(kinds, COMPRESSED) if "depth" in t.lower()]
    plain = [t for t in _of(kinds, IMAGE) if not any(word in t.lower() for word in _COLOUR)]
    for some in (raw, packed, plain, _of(kinds, CLOUD)):
        if len(some) == 1:
            return some[0]
        if some:
            expected = f"expected --topic, one of {_listed(some)}"
            raise InputError(path, "--topic", expected)
    everything = ", ".join(f"{t} ({k})" for t, k in list(kinds.items())[:_MAX_LISTED])
    expected = "expected depth images (16UC1 or 32FC1), compressed depth or organised clouds"
    raise InputError(path, "topics", f"{expected}; got {everything or 'none'}")


def camera_topic(
    path: Path, kinds: Mapping[str, str], images: str, chosen: str | None
) -> str | None:
    """The CameraInfo of images: the one chosen, the one beside them, the only one; else None.

    Raises `InputError` for a choice that is none.
    """
    found = _of(kinds, CAMERA_INFO)
    if chosen is not None:
        if chosen not in found:
            expected = f"expected a topic of CameraInfo: {_listed(found)}"
            raise InputError(path, "--camera-topic", f"{expected}; got {chosen}")
        return chosen
    place = images
    while "/" in place.strip("/"):
        place = place.rsplit("/", 1)[0]
        if f"{place}/camera_info" in found:
            return f"{place}/camera_info"
    return found[0] if len(found) == 1 else None


def _of(kinds: Mapping[str, str], *wanted: str) -> list[str]:
    wanted = wanted or (IMAGE, COMPRESSED, CLOUD)
    return [topic for topic, kind in kinds.items() if kind in wanted]


def _listed(topics: Sequence[str]) -> str:
    more = f" and {len(topics) - _MAX_LISTED} more" if topics[_MAX_LISTED:] else ""
    return (", ".join(topics[:_MAX_LISTED]) or "none") + more
