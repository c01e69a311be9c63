"""Following the features of a target with the filter of its principal axes (Hu 2024, section 4)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pcnav.config.principal_axes import FeatureMeasurements, PrincipalAxesTable
from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.spatial import rotation_angle
from pcnav.core.stereo import StereoRig
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.estimators.attitude_inertia.rotation_model import AttitudeSet
from pcnav.estimators.features.bookkeeping import FeatureBook
from pcnav.estimators.features.feature_map import TriangulatedFrame, moves_rigidly, triangulated
from pcnav.estimators.features.photogrammetric_frame import align
from pcnav.estimators.principal_axes.arc_fit import bounded_steps
from pcnav.estimators.principal_axes.arc_start import ArcStart
from pcnav.estimators.principal_axes.feature_measurements import (
    FeatureView,
    PointMeasurement,
)
from pcnav.estimators.principal_axes.feature_state_changes import (
    relabelled,
    with_point,
    without_points,
)
from pcnav.estimators.principal_axes.feature_states import PrincipalAxesModel, PrincipalState
from pcnav.estimators.principal_axes.linearised import Prior, smoothed
from pcnav.estimators.principal_axes.principal_choice import (
    CLEAR_SD,
    AxesCertainty,
    axes_certainty,
    free_choice,
    signing_triple,
    unique_choice,
)
from pcnav.filtering.batched_filter import Together
from pcnav.filtering.error_state import ErrorStateFilter, Measurement, UpdateResult
from pcnav.recordings.tracks import TrackFrame

_GAP_S = 2.0
"""Without features for longer, those that re-appear must agree with one another first."""
_GAP_NODES = 20
"""About so many states stand for the path over a gap."""
_PIXEL_ITERATIONS = 2
"""Pixels are taken once more about the state that they lead to. They turn the points: taken where
these were predicted, they would measure the mass centre along one direction and carry it on along
another, and every frame would seem to tell a little of it (Huang, Mourikis, Roumeliotis 2010)."""
_NEW_POINT_DISTANCE = 16.3
"""Squared, of two observations of a new feature: the 99.9 % point of three components."""


@dataclass(frozen=True)
class Taken:
    """What came of a frame."""

    result: UpdateResult | None = None
    used: tuple[int, ...] = ()
    rejected: tuple[int, ...] = ()
    squared: Mapping[int, float] = field(default_factory=dict)
    """See `pcnav.estimators.features.answer.Used`."""

    @property
    def gate(self) -> float:
        """Of the features, which are measured first; nan where none was."""
        return self.result.gates[0] if self.result is not None and self.result.gates else np.nan


@dataclass(frozen=True)
class _Passed:
    """A time since the last frame that was used."""

    time_s: float
    state: PrincipalState
    covariance: FloatArray


class FeatureFollower:
    """The filter from its start on: predicts, measures, and keeps its points and axes."""

    def __init__(
        self,
        start: ArcStart,
        rig: StereoRig,
        orbit: KeplerOrbit,
        table: PrincipalAxesTable,
        rng: np.random.Generator,
    ) -> None:
        self._rig, self._orbit, self._table, self._rng = rig, orbit, table, rng
        self._model = PrincipalAxesModel(
            orbit, table.acceleration_psd_m2_s3, table.angular_acceleration_psd_rad2_s3
        )
        self.triple = start.triple
        self._time_s = start.time_s
        self._filter = self._filter_of(start.state, start.covariance)
        self._book = FeatureBook().added(start.time_s, start.features)
        self._candidates: dict[int, tuple[FloatArray, FloatArray]] = {}
        """Features that one frame has shown: point (body axes, m) and covariance."""
        self._has_broken_down = False
        self._shape = dict(zip(start.features, start.state.points, strict=True))
        self._path = [_Passed(start.time_s, start.state, start.covariance)]

    @property
    def state(self) -> PrincipalState:
        """As it is now."""
        return self._filter.state

    @property
    def covariance(self) -> FloatArray:
        """(14 + 3N, 14 + 3N) of the state's error."""
        return self._filter.covariance

    @property
    def features(self) -> tuple[int, ...]:
        """In the order of the state's points."""
        return self._book.features

    @property
    def certainty(self) -> AxesCertainty:
        """How well the principal axes are known, with their signs where these are to be unique."""
        corners = self._corners if self._table.unique_frame else None
        return axes_certainty(self.state, self.covariance, corners)

    @property
    def _corners(self) -> FloatArray | None:
        """(3, 3) the points that sign the axes; None when one of them is no longer followed."""
        if not set(self.triple) <= set(self.features):
            return None
        return self.state.points[[self.features.index(name) for name in self.triple]]

    @property
    def is_lost(self) -> bool:
        """Whether what is seen has not been what is expected for too long, or the numbers broke
        down."""
        return self._has_broken_down or self._book.frames_refused >= self._table.max_rejections

    def predict(self, time_s: float) -> None:
        """Move to a time; nothing happens at the present one."""
        if time_s > self._time_s:
            for time, step in bounded_steps(self._time_s, time_s):
                self._filter.predict(self._model, time, step)
            self._time_s = time_s
            self._path.append(_Passed(time_s, self.state, self.covariance))

    def take(self, frame: TrackFrame) -> Taken:
        """Measure the features of a frame at the present time."""
        seen = triangulated(frame, self._rig)
        slots = self._book.slots(frame.features)
        after_gap = self._time_s - max(self._book.last_used_s.values()) >= _GAP_S
        if after_gap and not self._table.unique_frame:
            self._choose_freely(slots)
        trusted = slots >= 0
        if after_gap or self._book.frames_refused:
            trusted = self._agreeing(seen, slots)
        try:
            taken = self._measured(frame, seen, slots, trusted, after_gap)
        except np.linalg.LinAlgError:
            # Under a strong disturbance a gap may leave a point at the rig, where it has no pixel.
            self._has_broken_down = True
            return Taken(rejected=tuple(frame.features.tolist()))
        self._book = self._book.noted(self._time_s, taken.used, taken.rejected)
        if taken.used:
            self._keep_axes_unique()
            self._drop_rejected()
            self._add_new(seen)
            self._path = [_Passed(self._time_s, self.state, self.covariance)]
        return taken

    def _filter_of(
        self, state: PrincipalState, covariance: FloatArray, max_iterations: int = 1
    ) -> ErrorStateFilter[PrincipalState]:
        return ErrorStateFilter(
            state,
            covariance,
            gate_probability=self._table.gate_probability,
            max_iterations=max_iterations,
        )

    # Measuring

    def _agreeing(self, seen: TriangulatedFrame, slots: IntArray) -> BoolArray:
        """(n,) features of the state that together move as the body does.

        After a gap the prediction is wide and its gate lets wrong matches in.
        """
        known = slots >= 0
        if known.sum() < 4:
            return known
        points = self.state.points[slots[known]]
        exact = np.broadcast_to(1e-12 * np.eye(3), (len(points), 3, 3))
        motion = moves_rigidly(seen.p_world[known], points, seen.noise[known], exact, self._rng)
        if motion.fit is None:
            return known
        trusted = known.copy()
        trusted[known] = motion.pairs
        return trusted

    def _measured(
        self,
        frame: TrackFrame,
        seen: TriangulatedFrame,
        slots: IntArray,
        trusted: BoolArray,
        after_gap: bool,
    ) -> Taken:
        """Update with the trusted features."""
        refused = frame.features[(slots >= 0) & ~trusted].tolist()
        if not trusted.any():
            return Taken(rejected=tuple(refused))
        names = frame.features[trusted].tolist()
        if self._table.measurements is FeatureMeasurements.PIXELS:
            measurements = self._pixels(frame, slots, trusted)
        else:
            measurements = self._points_and_attitude(seen, slots, trusted)
        if after_gap and self._table.measurements is FeatureMeasurements.PIXELS:
            result = self._smoothed_over_gap(frame, slots, trusted)
        else:
            pixels = self._table.measurements is FeatureMeasurements.PIXELS
            usual = _PIXEL_ITERATIONS if pixels else 1
            iterations = self._table.max_iterations if after_gap else usual
            self._filter = self._filter_of(self.state, self.covariance, iterations)
            result = self._filter.update(measurements)
        passed = dict(zip(names, result.accepted, strict=False))
        return Taken(
            result,
            tuple(name for name in names if passed[name]),
            (*(name for name in names if not passed[name]), *refused),
            dict(zip(names, result.nis, strict=False)),
        )

    def _smoothed_over_gap(
        self, frame: TrackFrame, slots: IntArray, trusted: BoolArray
    ) -> UpdateResult:
        """Take the first frame after a gap.

        What it says of rate and inertia goes by how they moved the attitude meanwhile. That is
        known only now: by the path that was predicted, it would say more, and something else.
        """
        every = max(1, len(self._path) // _GAP_NODES)
        nodes = [*self._path[:-1:every], self._path[-1]]
        views = [*[None] * (len(nodes) - 1), self._view(frame, slots, trusted)]
        found = smoothed(
            [node.state for node in nodes],
            [node.time_s for node in nodes],
            views,
            self._model,
            Prior(nodes[0].covariance, nodes[0].state),
            self._table.gate_probability,
        )
        if not found.is_settled:
            raise np.linalg.LinAlgError("the path over the gap is not found")
        self._filter = self._filter_of(found.state, found.covariance)
        return found.result

    def _view(self, frame: TrackFrame, slots: IntArray, trusted: BoolArray) -> FeatureView:
        if not trusted.all():
            frame = replace(frame, features=frame.features[trusted], pixels=frame.pixels[trusted])
        R_hill_world = self._orbit.R_hill_world(frame.time_s)
        return FeatureView(frame, self._rig, R_hill_world, slots[trusted])

    def _pixels(
        self, frame: TrackFrame, slots: IntArray, trusted: BoolArray
    ) -> list[Measurement[PrincipalState]]:
        return [*self._view(frame, slots, trusted).measurements()]

    def _points_and_attitude(
        self, seen: TriangulatedFrame, slots: IntArray, trusted: BoolArray
    ) -> list[Measurement[PrincipalState]]:
        """The printed measurements (33): the points, and the attitude that the same points give."""
        R = self._orbit.R_hill_world(seen.time_s)
        rows = np.flatnonzero(trusted)
        found: list[Measurement[PrincipalState]] = [
            PointMeasurement(int(slots[k]), R @ seen.p_world[k], R @ seen.noise[k] @ R.T, R)
            for k in rows
        ]
        identified = [k for k in rows if int(seen.features[k]) in self._shape]
        if len(identified) >= 3:
            shape = np.stack([self._shape[int(seen.features[k])] for k in identified])
            fit = align(seen.p_world[identified], shape, seen.noise[identified])
            noise = fit.R_a_b.T @ fit.covariance[:3, :3] @ fit.R_a_b
            found.append(Together(AttitudeSet(fit.R_a_b, noise)))
        return found

    # The choice of axes

    def _keep_axes_unique(self) -> None:
        """Choose the axes anew where their order or a sign is clearly another by now (17)."""
        if not self._table.unique_frame:
            return
        certainty = self.certainty
        if certainty.are_axes_known and not certainty.is_signed:
            slots = [self.features.index(name) for name in self.triple]
            i, j, k = signing_triple(self.state, self.covariance, (slots[0], slots[1], slots[2]))
            self.triple = self.features[i], self.features[j], self.features[k]
            certainty = self.certainty
        if min(certainty.order_significance, certainty.sign_significance) > -CLEAR_SD:
            return
        self._relabel(unique_choice(self.state, self._corners))

    def _choose_freely(self, slots: IntArray) -> None:
        """Axes as the decomposition comes, where features re-appear: the filter without (17).

        Its photogrammetric frame is that of three of the features, in the order they are found.
        """
        shown = slots[slots >= 0]
        if len(shown) >= 3:
            corners = self.state.points[self._rng.permutation(shown)[:3]]
            self._relabel(free_choice(self.state, corners))

    def _relabel(self, R_body_new: FloatArray) -> None:
        if float(rotation_angle(R_body_new)) > 1e-6:
            moved = relabelled(self.state, self.covariance, R_body_new)
            self._filter = self._filter_of(*moved)
            self._shape = {name: p @ R_body_new for name, p in self._shape.items()}

    # Points that come and go

    def _drop_rejected(self) -> None:
        """Forget points that are rejected again and again."""
        self._drop(self._book.rejected(self._table.max_rejections))

    def _add_new(self, seen: TriangulatedFrame) -> None:
        """Add features that two frames agree on."""
        unknown = np.flatnonzero(self._book.slots(seen.features) < 0)
        if not len(unknown):
            return
        state = self.state
        R = state.R_world_body
        R_hill_world = self._orbit.R_hill_world(seen.time_s)
        r_world = R_hill_world.T @ state.r_hill
        for k in unknown:
            name = int(seen.features[k])
            p, noise = R.T @ (seen.p_world[k] - r_world), R.T @ seen.noise[k] @ R
            before = self._candidates.pop(name, None)
            if before is not None and _distance(p, noise, *before) < _NEW_POINT_DISTANCE:
                self._add(name, p, noise, R_hill_world)
            else:
                self._candidates[name] = p, noise

    def _add(self, name: int, p: FloatArray, noise: FloatArray, R_hill_world: FloatArray) -> None:
        if len(self.features) >= self._table.max_features:
            self._drop([min(self.features, key=lambda f: self._book.last_used_s[f])])
        R_body_hill = (R_hill_world @ self.state.R_world_body).T
        grown = with_point(self.state, self.covariance, p, noise, R_body_hill)
        self._filter = self._filter_of(*grown)
        self._book = self._book.added(self._time_s, [name])

    def _drop(self, names: Sequence[int]) -> None:
        if names:
            slots = [self.features.index(name) for name in names]
            left = without_points(self.state, self.covariance, slots)
            self._filter = self._filter_of(*left)
            self._book = self._book.without(names)


def _distance(p: FloatArray, noise: FloatArray, before: FloatArray, earlier: FloatArray) -> float:
    """Squared, of two observations of a point (3,) with covariances (3, 3)."""
    apart = p - before
    return float(apart @ np.linalg.solve(noise + earlier, apart))
