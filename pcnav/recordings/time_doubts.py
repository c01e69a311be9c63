"""What looks wrong with the times of frames, in words; nothing is changed by it."""

import numpy as np

from pcnav.core.arrays import FloatArray

_GAP_STEPS = 1.5
"""A step so many times the usual one has lost a frame."""
_QUANTA_S = (1.0, 0.1, 0.01)
"""That clocks round to, coarsest first."""
_EXACT = 1e-6
_UNEVEN = 0.2
"""Spread of the steps, over the usual one, that a camera at a steady rate does not have."""
_MIN_FRAMES = 5
_OFTEN = 0.2
"""Share of the steps that rounding changes at least, where it is worth the name."""


def time_doubts(time_s: FloatArray) -> tuple[str, ...]:
    """Sentences about increasing times (n,): frames lost, stamps rounded, steps uneven."""
    if len(time_s) < _MIN_FRAMES:
        return ()
    steps = np.diff(time_s)
    usual = float(np.median(steps))
    quantum = _rounded_to(time_s - time_s[0], steps)
    lost = steps > _GAP_STEPS * usual + (quantum or 0.0)
    found = []
    if lost.any():
        missing = int(np.rint(steps[lost] / usual - 1.0).sum())
        found.append(
            f"{int(lost.sum())} gaps, as if {missing} frames were lost; the longest is "
            f"{float(steps.max()):.3g} s after {float(time_s[int(np.argmax(steps))]):.6g} s"
        )
    rest = steps[~lost]
    low, high, spread = float(rest.min()), float(rest.max()), float(np.ptp(rest))
    if quantum is not None:
        found.append(
            f"the time stamps look rounded to {quantum:g} s (steps of {low:.3g} to {high:.3g} s): "
            "a moving target is then seen at wrong times"
        )
    elif spread > _UNEVEN * usual:
        found.append(
            f"uneven steps, {low:.3g} to {high:.3g} s: stamped on arrival, not on exposure?"
        )
    return tuple(found)


def _rounded_to(time_s: FloatArray, steps: FloatArray) -> float | None:
    """The coarsest quantum that all times (n,) are multiples of, where it makes many steps differ.

    A camera of a rate that the quantum suits loses a frame now and then; rounding is the rule.
    """
    for quantum in _QUANTA_S:
        off = np.abs(time_s / quantum - np.rint(time_s / quantum))
        unusual = np.abs(steps - np.median(steps)) > 0.5 * quantum
        if off.max() < _EXACT and float(unusual.mean()) > _OFTEN:
            return quantum
    return None
