"""What became of each feature of each frame: the rows of feature_outcomes.csv."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.files.csv_table import read_csv
from pcnav.runs.records import ACCEPTED, GATE_COLUMNS
from pcnav.runs.result_files import FEATURE_OUTCOMES_FILE, RAW_COVARIANCES_FILE

TRACKED = "tracked"
"""It was seen and not compared: it is new, or nothing was known that it could be compared with."""
INLIER = "inlier of a frame that was not measured"
"""It agrees with the others, and the frame was left out all the same."""
GATED = "beyond the gate"
BEHIND = "would lie behind the camera"
REFUSED = "rejected before it was compared"
"""After a gap: it does not move as the other features do."""
FEATURE_OUTCOME_COLUMNS = ("time_s", "feature", "outcome", *GATE_COLUMNS)


@dataclass(frozen=True)
class FeatureOutcomes:
    """What became of the features of one frame."""

    feature: IntArray
    """(n,) numbers."""
    outcome: tuple[str, ...]
    """n of `ACCEPTED`, `TRACKED` and the others, which are reasons."""
    squared_distance: FloatArray
    """(n,) from the prediction, or from the motion that fits the others, squared, over its
    variance; nan where it was not compared."""
    gate: float = np.nan
    """What the squared distance of an accepted one stays below; nan without a gate."""

    def rows(self, time_s: float) -> Iterator[list[float | str]]:
        """In the order of `FEATURE_OUTCOME_COLUMNS`."""
        gate: float | str = "" if np.isnan(self.gate) else float(self.gate)
        distances = np.asarray(self.squared_distance, dtype=np.float64).tolist()
        for number, outcome, distance in zip(
            self.feature.tolist(), self.outcome, distances, strict=True
        ):
            told = [distance, gate] if np.isfinite(distance) else ["", ""]
            yield [time_s, number, outcome, *told]

    def of(self, number: int) -> tuple[str, float]:
        """Outcome and squared distance of one feature. Raises ``KeyError`` for one not seen."""
        found = np.flatnonzero(self.feature == number)
        if not found.size:
            raise KeyError(number)
        return self.outcome[int(found[0])], float(self.squared_distance[found[0]])


def is_rejected(outcome: str) -> bool:
    """Whether a feature was refused, for whatever reason."""
    return outcome not in (ACCEPTED, TRACKED, INLIER)


def read_feature_outcomes(folder: Path) -> Mapping[float, FeatureOutcomes]:
    """Of a run, finished or not, by time; empty of one without. Raises `InputError`."""
    path = folder / FEATURE_OUTCOMES_FILE
    if not path.is_file():
        return {}
    growing = (folder / RAW_COVARIANCES_FILE).is_file()
    table = read_csv(path, FEATURE_OUTCOME_COLUMNS, ("outcome",), growing=growing)
    time_s, feature = table.times(), table.counts("feature")
    squared, gates = table.numbers(GATE_COLUMNS).T
    words = table.words("outcome")
    # A row begins a frame when its time differs from the one before.
    starts = np.flatnonzero(np.diff(time_s, prepend=np.nan) != 0.0).tolist()
    found = {}
    for start, end in zip(starts, [*starts[1:], len(time_s)], strict=True):
        rows = slice(start, end)
        known = gates[rows][np.isfinite(gates[rows])]
        gate = float(known[0]) if known.size else np.nan
        found[float(time_s[start])] = FeatureOutcomes(
            feature[rows], words[rows], squared[rows], gate
        )
    return found
