"""What has changed on purpose since the golden data were recorded, in one place.

A change of a name, a word or a number that is meant is written down here, with its reason; the data
themselves are recorded anew (`python -m tests.golden --update`) only when a reader of the history
would want to see every number change.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

TOLERANCE = 1e-9
"""Relative. Of a column over time it is also relative to the column's largest magnitude, so that
rounding does not count where a state passes through zero."""


@dataclass(frozen=True)
class Explained:
    """A difference that is meant, and how far it may go."""

    reason: str
    relative: float = TOLERANCE
    """Largest relative difference; with ``math.inf`` anything may differ, come or go."""
    absolute: float = 0.0
    """Differences up to this do not count, in the unit of the column."""


RENAMED: Mapping[str, str] = {
    "attitude.csv": "camera_attitude.csv",
    "attitude.csv.totals.json": "camera_attitude.csv.totals.json",
    "explained": "inlier_ratio",
    "fewest_sd": "min_significance",
    "most_iterations": "max_iterations",
    "most_features": "max_features",
    "most_rejections": "max_rejections",
    "longest_arc_s": "max_arc_s",
    "fewest_matches": "min_matches",
    "fewest_agreeing": "min_agreeing",
    "largest_sd_deg": "max_sd_deg",
    "largest_turn_deg": "max_turn_deg",
    "largest_view_angle_deg": "max_view_angle_deg",
    "least_correlation": "min_correlation",
}
"""Old name to new name of files, of columns and of keys (or of parts between their dots)."""

REWORDED: Mapping[str, str] = {}
"""Old words to new words in cells and in what is printed."""

EXPLAINED: Mapping[str, Explained] = {
    "observability/hu2024.txt/line": Explained(
        "what the prior leaves of a motion, some 1e-5 of its deviation, was rounding error; it is "
        "now what extended precision finds",
        relative=0.5,
    ),
    "*/states.csv*/window_nis*": Explained("every estimator has it now", relative=math.inf),
    "*/points.csv*": Explained("estimated points frame by frame", relative=math.inf),
    "*/feature_outcomes.csv*": Explained("what became of each feature", relative=math.inf),
    "*/segments.csv*": Explained("where body axes were begun anew", relative=math.inf),
    "applsci2022/*/covariances.npz.csv*": Explained("every estimator has them", relative=math.inf),
    "images/result/covariances.npz.csv*": Explained("as above", relative=math.inf),
    "deng2024/result/covariances.npz.csv*": Explained("as above", relative=math.inf),
    "applsci2022/attitudes/states.csv/outcome": Explained(
        "what became of the images that attitudes are taken from", relative=math.inf
    ),
    "applsci2022/attitudes/metrics.json/errors.attitude_deg.title": Explained(
        "said of every run whose axes are those of its first frame", relative=math.inf
    ),
    "study-hu2024/study/tables/fig06_11.csv/free: largest": Explained(
        "axes as they come depend on the numbering of the points, which the unique triple no "
        "longer does",
        relative=0.1,
    ),
    "study-hu2024/study/tables/inside.csv/axes as they come": Explained("as above", relative=0.1),
    "study-hu2024/study/tables/nees.csv/pixels used twice": Explained(
        "the disturbed truth has one integrator now, and its rounding grows in a filter that "
        "promises some hundred times more than it holds",
        relative=1e-4,
    ),
    "*/study/pipelines/*/perception.modalities.*": Explained(
        "a list in the settings now", relative=math.inf
    ),
    "study-tracking/study/tables/faults.csv/inlier_ratio": Explained(
        "headed inlier ratio", relative=math.inf
    ),
    "study-tracking/study/tables/faults.csv/inlier ratio": Explained(
        "was headed explained", relative=math.inf
    ),
    "batch/*/statistics.csv/r_hill_*": Explained(
        "tables have every quantity of metrics.json, the place of the mass centre too",
        relative=math.inf,
    ),
}
"""Changes that are meant, by a pattern of case/output/file/column; the first that fits counts."""
