"""How much of what faces err by lasts, learnt from draws that are correlated as is known."""

import numpy as np
import pytest

from pcnav.core.arrays import FloatArray
from pcnav.perception.lasting_errors import FaceMemory

FACES = (0, 2, 5)
WHITE_SHARE = 0.4


def drawn(seed: int, correlation: float, frames: int) -> FloatArray:
    """(frames, faces) offsets of unit variance, part of it white and the rest an AR(1) process."""
    rng = np.random.default_rng(seed)
    lasting = np.empty((frames, len(FACES)))
    lasting[0] = rng.normal(size=len(FACES))
    for k in range(1, frames):
        fresh = np.sqrt(1.0 - correlation**2) * rng.normal(size=len(FACES))
        lasting[k] = correlation * lasting[k - 1] + fresh
    white = rng.normal(size=lasting.shape)
    return np.asarray(np.sqrt(1.0 - WHITE_SHARE) * lasting + np.sqrt(WHITE_SHARE) * white)


def learnt(correlation: float) -> list[float]:
    found = []
    for seed in range(10):
        memory = FaceMemory(1.0)
        for off in drawn(seed, correlation, 40):
            by_face = dict(zip(FACES, off.tolist(), strict=True))
            memory = memory.with_offsets(by_face, dict.fromkeys(FACES, 1.0 - WHITE_SHARE))
        found.append(memory.correlation)
    return found


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.95])
def test_the_correlation_of_successive_frames_is_learnt(correlation: float) -> None:
    assert np.mean(learnt(correlation)) == pytest.approx(correlation, abs=0.12)


def test_before_anything_is_known_all_of_it_is_taken_to_last() -> None:
    assert FaceMemory(1.0).correlation == 1.0
    once = FaceMemory(1.0).with_offsets({0: 1.0}, {0: 0.5})
    assert once.correlation == 1.0
    # Another face says nothing of the first.
    assert once.with_offsets({1: -1.0}, {1: 0.5}).correlation == 1.0
    assert once.with_offsets({0: -1.0}, {0: 0.5}).correlation < 0.7
