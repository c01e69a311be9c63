"""What two views can tell at all: accuracy by range, noise and turn, and the degenerate cases."""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from pcnav.config.image_motion import ImageMotionTable
from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation
from pcnav.core.statistics import root_mean_square
from pcnav.estimators.image_motion.refinement import motion_gain
from pcnav.estimators.image_motion.relative import measure
from pcnav.estimators.image_motion.translation import Known, RelativeView, translation
from pcnav.files.text_table import TextTable

from ..tables import table
from . import paper
from .scene import hull_points

_FOCAL = paper.CAMERA.fx
POINTS = paper.POINTS // 2
DRAWS = 20
SIGMA_PX = 0.1
DISPLACEMENT_M = np.array([0.9, -0.6, 0.7])
"""Of the mass centre between the two views of the translation."""
_AXIS = np.array([0.95, 0.28, 0.1]) / np.linalg.norm([0.95, 0.28, 0.1])


@dataclass(frozen=True)
class _Pair:
    """Two views of the same points, without noise."""

    first: FloatArray
    second: FloatArray
    R: FloatArray
    t: FloatArray


def _pair(points: FloatArray, turn_deg: float, first_m: FloatArray, second_m: FloatArray) -> _Pair:
    R = exp_rotation(np.deg2rad(turn_deg) * _AXIS)
    a, b = points + first_m, points @ R.T + second_m
    return _Pair(a[:, :2] / a[:, 2:], b[:, :2] / b[:, 2:], R, second_m - R @ first_m)


def accuracy_table() -> TextTable:
    """Stated deviations of one pair by range and turn."""
    points, _ = hull_points(POINTS, np.random.default_rng(5))
    rows = []
    for range_m in (10.0, 20.0, 40.0, 80.0):
        place = np.array([0.0, 0.0, range_m])
        cells: list[float] = []
        for turn_deg in (1.0, 5.0, 20.0):
            pair = _pair(points, turn_deg, place, place)
            t = pair.t / np.linalg.norm(pair.t)
            gain = motion_gain(pair.R, t, pair.first, pair.second, SIGMA_PX / _FOCAL)
            spread = np.sqrt(np.linalg.eigvalsh(gain.covariance))
            cells += np.rad2deg(spread[[2, 0]]).tolist()
        rows.append((f"{range_m:g}", *cells))
    header = ["range, m"]
    for turn_deg in (1, 5, 20):
        header += [f"{turn_deg} deg: worst axis, deg", f"{turn_deg} deg: best axis, deg"]
    return table("accuracy", header, rows)


def degenerate_table() -> TextTable:
    """What becomes of pairs that do not determine a motion."""
    place, settings = np.array(paper.PLACE_M), ImageMotionTable()
    rows = []
    for name in ("tumbling", "7 matches", "repeated frame", "no parallax", "plane"):
        for wrong in (0.0, 0.2):
            outcomes: Counter[str] = Counter()
            for draw in range(DRAWS):
                rng = np.random.default_rng([draw, 7])
                first, second = _degenerate(name, place, rng)
                noise = SIGMA_PX / _FOCAL
                first = first + noise * rng.standard_normal(first.shape)
                second = second + noise * rng.standard_normal(second.shape)
                bad = rng.uniform(size=len(second)) < wrong
                second[bad] = rng.permutation(second)[bad] + 0.01 * rng.standard_normal(2)
                outcomes[measure(first, second, noise, settings).outcome.value] += 1
            told = ", ".join(f"{what} {count}" for what, count in outcomes.most_common())
            rows.append((name, f"{wrong:.0%}", told))
    header = ("views", "wrong matches", "outcome")
    return table("degenerate", header, rows, text_columns=3)


def _degenerate(
    name: str, place: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    points, _ = hull_points(7 if name == "7 matches" else POINTS, rng)
    if name == "plane":
        points[:, 2] = 0.4 * points[:, 0] - 0.3 * points[:, 1]
    turn = 0.0 if name == "repeated frame" else 10.0
    R = exp_rotation(np.deg2rad(turn) * _AXIS)
    pair = _pair(points, turn, place, R @ place if name == "no parallax" else place)
    return pair.first, pair.second


def translation_table() -> TextTable:
    """Section 2.4: what is known, what follows, and how well at 0.1 px."""
    points, _ = hull_points(POINTS, np.random.default_rng(5))
    first, second = np.array(paper.PLACE_M), np.array(paper.PLACE_M) + DISPLACEMENT_M
    pair = _pair(points, 10.0, first, second)
    r1, r2 = float(np.linalg.norm(first)), float(np.linalg.norm(second))
    d1, d2, length = first / r1, second / r2, float(np.linalg.norm(pair.t))
    noise = SIGMA_PX / _FOCAL
    cases = {
        "both places": Known(d1, d2, r1, r2),
        "place and length of t": Known(d1, None, r1, None, length),
        "both directions, first range": Known(d1, d2, r1),
        "first place, second range": Known(d1, None, r1, r2),
        "both directions": Known(d1, d2),
        "first direction": Known(d1),
        "both ranges": Known(range_first_m=r1, range_second_m=r2),
    }
    rows = []
    for name, known in cases.items():
        errors, told = [], ""
        for draw in range(DRAWS):
            rng = np.random.default_rng([draw, 9])
            a = pair.first + noise * rng.standard_normal(pair.first.shape)
            b = pair.second + noise * rng.standard_normal(pair.second.shape)
            found = measure(a, b, noise, ImageMotionTable()).motion
            if found is None:
                continue
            view = RelativeView(found.R_second_first, found.direction, np.eye(3))
            answer = translation(view, known)
            told = f"{answer.verdict.value}{': needs ' if answer.missing else ''}{answer.missing}"
            scale = r1 if answer.verdict.value == "direction_only" else 1.0
            moved = [scale * each.displacement_m for each in answer.places]
            if moved:
                errors.append(min(float(np.linalg.norm(m - (second - first))) for m in moved))
        rows.append((name, told, root_mean_square(errors)))
    header = ("known of the mass centre", "answer", "RMS error, m")
    return table("translation", header, rows, text_columns=2)
