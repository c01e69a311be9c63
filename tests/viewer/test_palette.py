"""Things that mean different things differ to every eye."""

from itertools import combinations

import numpy as np
import pytest

from pcnav.core.arrays import FloatArray
from pcnav.viewer import palette
from pcnav.viewer.palette import Rgb

_FAR = 20.0
_BACKGROUND: Rgb = (20, 20, 20)
# Machado, Oliveira and Fernandes (2009), table 1: no receptors for green, linear light.
_DEUTERANOPIA = np.array(
    [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ]
)
# IEC 61966-2-1: sRGB to CIE XYZ under D65.
_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
_WHITE = _XYZ.sum(axis=1)

SEEN_TOGETHER: dict[str, dict[str, Rgb]] = {
    "returns": {
        **{str(k): (int(r), int(g), int(b)) for k, (r, g, b) in enumerate(palette.LABELS)},
        "unexplained": palette.UNEXPLAINED,
        "beside": palette.BESIDE,
    },
    "residuals": {
        **dict(zip(("nearer", "on it", "behind"), palette.RESIDUAL_STOPS, strict=True)),
        "unexplained": palette.UNEXPLAINED,
        "beside": palette.BESIDE,
    },
    "lines": {
        "accepted": palette.ACCEPTED_COLOUR,
        "rejected": palette.REJECTED_COLOUR,
        "truth": palette.TRUTH,
        **{f"run {k}": colour for k, colour in enumerate(palette.RUNS)},
    },
    "states": {
        "rate": palette.RATE,
        "momentum": palette.MOMENTUM,
        "mass centre": palette.MASS_CENTRE,
        "position": palette.POSITION,
        "attitude": palette.ATTITUDE,
    },
    "status": {str(status): colour for status, colour in palette.STATUS.items()},
}


def lab(linear: FloatArray) -> FloatArray:
    """CIE 1976 L*a*b* of linear RGB."""
    ratio = np.clip(linear, 0.0, 1.0) @ _XYZ.T / _WHITE
    f = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])])


def difference(one: Rgb, other: Rgb) -> float:
    """The smaller of what usual and deuteranope eyes see."""
    shares = np.array([one, other]) / 255.0
    linear = np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4)
    seen = ([lab(each) for each in linear], [lab(_DEUTERANOPIA @ each) for each in linear])
    return float(min(np.linalg.norm(a - b) for a, b in seen))


def test_the_simulation_knows_what_deuteranopes_confuse() -> None:
    """Red and green of one brightness; blue and yellow stay apart."""
    assert difference((255, 0, 0), (160, 118, 0)) < 12.0
    assert difference((0, 0, 255), (255, 255, 0)) > 100.0
    assert difference((70, 220, 110), (255, 90, 80)) < _FAR


@pytest.mark.parametrize("group", SEEN_TOGETHER)
def test_different_things_differ_to_all_eyes(group: str) -> None:
    colours = {**SEEN_TOGETHER[group], "background": _BACKGROUND}
    near = {
        (a, b): round(difference(colours[a], colours[b]), 1)
        for a, b in combinations(colours, 2)
        if difference(colours[a], colours[b]) < _FAR
    }
    assert near == {}
