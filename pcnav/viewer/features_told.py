"""What is said of the tracked features of one frame: a list, and a card of the one clicked at."""

from html import escape

import numpy as np

from pcnav.runs.feature_outcomes import INLIER, REFUSED, TRACKED, FeatureOutcomes, is_rejected
from pcnav.runs.records import ACCEPTED
from pcnav.viewer.card import Card
from pcnav.viewer.palette import ACCEPTED_COLOUR, REJECTED_COLOUR, SENSOR, Rgb, hex_of

_STYLE = "font-size:12px;line-height:1.45;padding:2px 10px"
_WHY = {
    TRACKED: "it is new, or nothing was known that it could be compared with",
    INLIER: "it agrees with the others; what the frame lacks is told beside it",
    REFUSED: "after a gap: it does not move as the others do",
}


def colour_of(outcome: str) -> Rgb:
    """Of a track: used, rejected, or seen alone."""
    if is_rejected(outcome):
        return REJECTED_COLOUR
    return ACCEPTED_COLOUR if outcome == ACCEPTED else SENSOR


def counts_text(outcomes: FeatureOutcomes) -> str:
    """How many were used, rejected and seen alone."""
    words = outcomes.outcome
    used, rejected = words.count(ACCEPTED), sum(map(is_rejected, words))
    return f"{used} used, {rejected} rejected, {len(words) - used - rejected} seen only"


def features_html(outcomes: FeatureOutcomes, frame_outcome: str) -> str:
    """A row a feature, the rejected first and of these the farthest; ``frame_outcome`` is what
    became of the frame, empty where that goes without saying."""
    if not len(outcomes.feature):
        return f"<div style='{_STYLE}'>no feature seen in this frame</div>"
    far = np.nan_to_num(outcomes.squared_distance, nan=-1.0)
    refused = np.array([is_rejected(word) for word in outcomes.outcome])
    alone = np.array([word in (TRACKED, INLIER) for word in outcomes.outcome])
    rows = []
    for k in np.lexsort((-far, alone, ~refused)).tolist():
        outcome = outcomes.outcome[k]
        colour = hex_of(colour_of(outcome))
        mark = "✗" if is_rejected(outcome) else "✓" if outcome == ACCEPTED else "·"
        rows.append(
            f"<tr><td style='color:{colour}'>{mark}</td><td>{outcomes.feature[k]}</td>"
            f"<td style='white-space:nowrap'>{_distance(outcomes, k)}</td>"
            f"<td style='color:{colour}'>{escape(outcome)}</td></tr>"
        )
    head = "".join(
        f"<th style='text-align:left;font-weight:400;opacity:.75'>{name}</th>"
        for name in ("", "feature", "d² / gate", "outcome")
    )
    frame = f"frame: {escape(frame_outcome)}; " if frame_outcome else ""
    return (
        f"<div style='{_STYLE}'>{frame}{counts_text(outcomes)}"
        "<table style='border-spacing:8px 0;margin-left:-8px'>"
        f"<tr>{head}</tr>{''.join(rows)}</table></div>"
    )


def feature_card(outcomes: FeatureOutcomes, number: int, frame_outcome: str) -> Card:
    """Of one feature. Raises ``KeyError`` for one that was not seen."""
    outcome, squared = outcomes.of(number)
    rows = [["outcome", outcome]]
    if np.isfinite(squared):
        told = f"{squared:.3g}"
        if np.isfinite(outcomes.gate):
            side = "within" if squared <= outcomes.gate else "beyond"
            told = f"{squared:.3g}, {side} the gate of {outcomes.gate:.3g}"
        rows.append(["squared distance", told])
    else:
        rows.append(["squared distance", "it was not compared"])
    if outcome in _WHY:
        rows.append(["why", _WHY[outcome]])
    if frame_outcome:
        rows.append(["frame", frame_outcome])
    return Card(f"feature {number}{' (rejected)' if is_rejected(outcome) else ''}", rows)


def _distance(outcomes: FeatureOutcomes, k: int) -> str:
    squared = outcomes.squared_distance[k]
    if not np.isfinite(squared):
        return "-"
    gate = f"{outcomes.gate:.3g}" if np.isfinite(outcomes.gate) else "none"
    return f"{squared:.3g} / {gate}"
