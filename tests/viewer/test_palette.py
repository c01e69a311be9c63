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


def ciede2000(one: FloatArray, other: FloatArray) -> float:
    """Of two colours L*a*b*: Sharma, Wu and Dalal (2005), equations 2 to 22, k = 1."""
    (L1, a1, b1), (L2, a2, b2) = one, other
    C = 0.5 * (np.hypot(a1, b1) + np.hypot(a2, b2))
    G = 0.5 * (1.0 - np.sqrt(C**7 / (C**7 + 25.0**7)))
    a1, a2 = (1.0 + G) * a1, (1.0 + G) * a2
    C1, C2 = np.hypot(a1, b1), np.hypot(a2, b2)
    h1, h2 = (np.degrees(np.arctan2(b, a)) % 360.0 for a, b in ((a1, b1), (a2, b2)))
    dh = 0.0 if C1 * C2 == 0.0 else (h2 - h1 + 180.0) % 360.0 - 180.0
    dH = 2.0 * np.sqrt(C1 * C2) * np.sin(np.radians(dh) / 2.0)
    L, C = 0.5 * (L1 + L2), 0.5 * (C1 + C2)
    h = h1 + h2
    if C1 * C2 > 0.0:
        h = 0.5 * h if abs(h1 - h2) <= 180.0 else 0.5 * (h + (360.0 if h < 360.0 else -360.0))
    T = 1.0 + sum(
        share * np.cos(np.radians(times * h + turn))
        for share, times, turn in ((-0.17, 1, -30), (0.24, 2, 0), (0.32, 3, 6), (-0.20, 4, -63))
    )
    S_L = 1.0 + 0.015 * (L - 50.0) ** 2 / np.sqrt(20.0 + (L - 50.0) ** 2)
    S_C, S_H = 1.0 + 0.045 * C, 1.0 + 0.015 * C * T
    turned = 30.0 * np.exp(-(((h - 275.0) / 25.0) ** 2))
    R_T = -2.0 * np.sqrt(C**7 / (C**7 + 25.0**7)) * np.sin(np.radians(2.0 * turned))
    along_C, along_H = (C2 - C1) / S_C, dH / S_H
    squared = ((L2 - L1) / S_L) ** 2 + along_C**2 + along_H**2 + R_T * along_C * along_H
    return float(np.sqrt(squared))


def difference(one: Rgb, other: Rgb) -> float:
    """The smaller of what usual and deuteranope eyes see, CIEDE2000."""
    shares = np.array([one, other]) / 255.0
    linear = np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4)
    seen = ([lab(each) for each in linear], [lab(_DEUTERANOPIA @ each) for each in linear])
    return min(ciede2000(a, b) for a, b in seen)


@pytest.mark.parametrize(
    ("one", "other", "apart"),
    [
        ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
        ((50.0, 0.0, 0.0), (50.0, -1.0, 2.0), 2.3669),
        ((50.0, 2.5, 0.0), (50.0, 0.0, -2.5), 4.3065),
        ((50.0, 2.5, 0.0), (73.0, 25.0, -18.0), 27.1492),
        ((50.0, 2.5, 0.0), (56.0, -27.0, -3.0), 31.9030),
        ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
        ((22.7233, 20.0904, -46.6940), (23.0331, 14.9730, -42.5619), 2.0373),
        ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
    ],
)
def test_differences_are_those_that_were_published(
    one: tuple[float, ...], other: tuple[float, ...], apart: float
) -> None:
    """Table 1 of Sharma, Wu and Dalal (2005)."""
    assert ciede2000(np.array(one), np.array(other)) == pytest.approx(apart, abs=1e-4)
    assert ciede2000(np.array(other), np.array(one)) == pytest.approx(apart, abs=1e-4)


def test_the_simulation_knows_what_deuteranopes_confuse() -> None:
    """Red and green of one brightness; blue and yellow stay apart."""
    assert difference((255, 0, 0), (160, 118, 0)) < 12.0
    assert difference((0, 0, 255), (255, 255, 0)) > 80.0
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
