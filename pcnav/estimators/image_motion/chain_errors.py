"""How the errors of a chain's attitudes are correlated.

An attitude of the chain is that of its reference and a measured turn. So the error of a key frame
is in all that were compared with it, and the noise of its features is in all their turns alike:
what looks like many attitudes of half a degree is one of half a degree and many small ones. A
filter that takes them as independent becomes overconfident in a wrong inertia.
"""

from collections.abc import Sequence

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.estimators.image_motion.chain import ChainLink, shared_noise
from pcnav.estimators.image_motion.relative import matched

_REFERENCES_KEPT = 4
"""The noise of older references is in no new turn: the chain tries its last two key frames."""


class ChainErrors:
    """Joint covariance of attitude errors, ``R = R_hat exp(theta)`` each, to first order.

    Every frame's noise enters as the chain of links carries it on: by its own turn, by the turns
    of the frames compared with it, and through all of these.
    """

    def __init__(self) -> None:
        self._slot: dict[int, int] = {}
        self._joint = np.zeros((48, 48))
        self._links: dict[int, ChainLink] = {}
        self._by_noise: dict[int, list[FloatArray]] = {}
        """Of references: (k, 3, 2) gains by their features' noise, of all errors since."""

    def __len__(self) -> int:
        return len(self._slot)

    def begin(self, number: int, link: ChainLink, covariance: FloatArray) -> None:
        """A frame whose error (3, 3) is its own: the first of a segment."""
        here = self._new_slot(number)
        self._joint[here, here] = covariance
        self._links[number] = link
        for frame, gains in self._by_noise.items():
            gains.append(np.zeros((len(self._links[frame].seen), 3, 2)))

    def add(self, number: int, reference: int, link: ChainLink) -> None:
        """A frame compared with an earlier one that was added."""
        first = self._slot[reference]
        of_reference = slice(3 * first, 3 * first + 3)
        gains = self._gains_by(reference)
        here = self._new_slot(number)
        row = self._joint[of_reference, : here.start].copy()
        cross = shared_noise(link, self._links[reference].seen, np.stack(gains))
        row[:, 3 * first :] += np.concatenate(list(cross), axis=1)
        self._joint[here, : here.start] = row
        self._joint[: here.start, here] = row.T
        # The reference's own error, the turn's, and what the two share, in both orders.
        self._joint[here, here] = row[:, of_reference] + cross[0].T + link.covariance
        self._carry(reference, link)
        self._links[number] = link
        self._forget()

    def covariance(self, numbers: Sequence[int]) -> FloatArray:
        """(3n, 3n) of n frames."""
        at = np.concatenate([3 * self._slot[number] + np.arange(3) for number in numbers])
        return np.asarray(self._joint[np.ix_(at, at)])

    def _gains_by(self, reference: int) -> list[FloatArray]:
        """How the errors since a reference depend on its noise; at first its own alone does."""
        if reference not in self._by_noise:
            link = self._links[reference]
            later = len(self._slot) - 1 - self._slot[reference]
            self._by_noise[reference] = [link.by_own, *([np.zeros_like(link.by_own)] * later)]
        return self._by_noise[reference]

    def _carry(self, reference: int, link: ChainLink) -> None:
        """The new error has what its reference's has, and the turn's."""
        for frame, gains in self._by_noise.items():
            back = self._slot[reference] - self._slot[frame]
            gain = gains[back].copy() if back >= 0 else np.zeros_like(gains[0])
            if frame == reference:
                _, here, there = matched(self._links[frame].seen, link.features)
                gain[here] += link.by_reference[there]
            gains.append(gain)

    def _new_slot(self, number: int) -> slice:
        place = 3 * len(self._slot)
        self._slot[number] = len(self._slot)
        if place + 3 > len(self._joint):
            grown = np.zeros((2 * len(self._joint),) * 2)
            grown[:place, :place] = self._joint[:place, :place]
            self._joint = grown
        return slice(place, place + 3)

    def _forget(self) -> None:
        for number in sorted(self._by_noise)[:-_REFERENCES_KEPT]:
            del self._by_noise[number]
        if len(self._by_noise) == _REFERENCES_KEPT:
            oldest = min(self._by_noise)
            self._links = {number: link for number, link in self._links.items() if number >= oldest}
