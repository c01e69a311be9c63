"""A motion over time, estimated or true: the one type that both have."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.dynamics.blocks import Block, Layout


@dataclass(frozen=True, repr=False)
class Trajectory:
    """Values of named blocks over time; nan in frames without a value."""

    time_s: FloatArray
    """(n,) increasing."""
    layout: Layout
    """The blocks of the error state that ``covariance`` and ``sd`` are of."""
    values: Mapping[str, FloatArray] = field(default_factory=dict)
    """(n, k) by name of a block; (n, 3, 3) R_world_body of the attitude. May hold blocks beyond
    the layout, of which no deviation is known."""
    sd: FloatArray | None = None
    """(n, size) standard deviations in the layout's order, SI and rad; None of a truth."""
    covariance: FloatArray | None = None
    """(n, size, size); None where it was not asked for or does not exist."""
    T_cam_target: FloatArray | None = None
    """(n, 4, 4) pose in the camera: of the model frame where there is a model, else of the body
    axes at the mass centre; None where no pose is known."""

    def __repr__(self) -> str:
        lasts = f"{self.time_s[0]:.12g} to {self.time_s[-1]:.12g} s" if len(self) else "no time"
        return f"<Trajectory of {', '.join(self.values) or 'poses'}: {len(self)} times, {lasts}>"

    def __len__(self) -> int:
        return len(self.time_s)

    def __contains__(self, block: object) -> bool:
        return isinstance(block, Block) and block.name in self.values

    def __getitem__(self, block: Block) -> FloatArray:
        """(n, ...) values of a block. Raises ``KeyError`` for one that is not there."""
        return self.values[block.name]

    @property
    def has_estimate(self) -> BoolArray:
        """(n,) whether the frame has all blocks of the layout, or a pose where there are none."""
        if self.layout.blocks:
            first = self[self.layout.blocks[0]]
            return np.asarray(np.isfinite(first[:, 0] if first.ndim == 2 else first[:, 0, 0]))
        if self.T_cam_target is not None:
            return np.asarray(np.isfinite(self.T_cam_target[:, 0, 0]))
        return np.zeros(len(self), dtype=np.bool_)

    @property
    def poses(self) -> FloatArray:
        """(n, 4, 4) `T_cam_target` of a motion that has poses. Raises ``ValueError``."""
        if self.T_cam_target is None:
            raise ValueError("expected a motion with the poses of the target in the camera")
        return self.T_cam_target

    def sd_of(self, block: Block) -> FloatArray:
        """(n, k) deviations of a block; nan where none are known."""
        if self.sd is None or block not in self.layout:
            return np.full((len(self), block.size), np.nan)
        return self.sd[:, self.layout.slice_of(block)]

    def covariance_of(self, block: Block) -> FloatArray | None:
        """(n, k, k) of a block; None without covariances."""
        if self.covariance is None or block not in self.layout:
            return None
        rows = self.layout.slice_of(block)
        return self.covariance[:, rows, rows]

    def at(self, frames: IntArray | BoolArray | slice) -> "Trajectory":
        """Some of the frames."""

        def of(array: FloatArray | None) -> FloatArray | None:
            return None if array is None else array[frames]

        return replace(
            self,
            time_s=self.time_s[frames],
            values={name: values[frames] for name, values in self.values.items()},
            sd=of(self.sd),
            covariance=of(self.covariance),
            T_cam_target=of(self.T_cam_target),
        )
