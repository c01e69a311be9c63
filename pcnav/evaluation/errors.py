"""Errors of a run against the truth, frame by frame, in the axes that the run reports in."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import invert_transform, log_rotation, make_transform, rotation_angle
from pcnav.dynamics.blocks import ATTITUDE, CENTRE, RATE, RATIOS, Block
from pcnav.dynamics.rigid_body import inertia_from_ratios, ratios_from_inertia
from pcnav.dynamics.trajectory import Trajectory
from pcnav.estimators.interface import AxesPolicy
from pcnav.estimators.registry import ESTIMATORS
from pcnav.runs.reader import read_points
from pcnav.runs.run import PointTable, Run
from pcnav.runs.status import Status
from pcnav.target.roundness import Roundness

TIME_TOLERANCE_S = 1e-6
"""Frames of a run and of its truth are the same when their times are so near."""


@dataclass(frozen=True)
class Errors:
    """True minus estimated, per frame of a run; nan where either is missing."""

    state: Mapping[str, FloatArray]
    """(n, k) by name of a block, of all that the run has values of: SI and rad. The attitude's is
    the rotation vector theta in body axes, ``R_true = R_estimated exp(theta)``."""
    p_cam_m: FloatArray
    """(n, 3) position of the model origin, camera axes, m; all nan without true poses."""
    theta_model_rad: FloatArray
    """(n, 3) rotation vector of the pose error, model axes, rad."""
    truth: Trajectory
    """The truth at the run's own frames and in its axes; nan where unknown."""
    symmetry: int = 0
    """Which of the target's symmetries the truth was compared under; 0 is the identity."""
    R_true_run: FloatArray | None = None
    """(n, 3, 3) from the run's body axes to the true ones; None where they are the same."""
    defines_axes: BoolArray | None = None
    """(n,) frames at which the axes were made the same: their attitude has no error by
    construction. None where the axes were given."""
    points_rms_m: FloatArray | None = None
    """(n,) root mean square distance of the estimated points from the true ones, body axes; None of
    a run without points."""
    point_m: Mapping[int, float] | None = None
    """Distance of each point of the last estimate from the true one, by feature."""

    @property
    def has_pose(self) -> BoolArray:
        """(n,) frames in which a pose was compared."""
        return np.asarray(np.isfinite(self.p_cam_m).all(axis=1))

    def has(self, *blocks: Block) -> BoolArray:
        """(n,) frames in which all of some blocks were compared, with an error to speak of."""
        known = np.ones(len(self.p_cam_m), dtype=np.bool_)
        for block in blocks:
            known &= np.isfinite(self.state[block.name]).all(axis=1)
        return known if self.defines_axes is None else known & ~self.defines_axes

    def __getitem__(self, block: Block) -> FloatArray:
        """(n, k) of a block. Raises ``KeyError`` for one that the run has no values of."""
        return self.state[block.name]


def errors(
    run: Run,
    truth: Trajectory,
    axes: AxesPolicy | None = None,
    *,
    symmetry_transforms: FloatArray | None = None,
    roundness: Roundness | None = None,
    true_points: Mapping[int, FloatArray] | None = None,
) -> Errors:
    """Compare the frames of a run with the truth at the same time.

    Args:
        run: whose segments, where it has any, tell its axes.
        truth: of the recording.
        axes: how it is brought into the axes of the run; None asks the registry.
        symmetry_transforms: (k, 4, 4) motions of the model frame that leave the target unchanged.
        roundness: of a target that can be turned by any angle: it is then compared as it is turned
            in each frame of the run.
        true_points: (3,) by feature, true body axes, m.

    Raises `InputError` when no frame has a truth within `TIME_TOLERANCE_S`.
    """
    rows = match_times(run.time_s, truth.time_s, TIME_TOLERANCE_S)
    if not (rows >= 0).any():
        raise InputError("truth", "time_s", "expected times that the run shares; none match")
    matched = _at_rows(truth, rows, run.time_s)
    if axes is None:
        entry = ESTIMATORS.get(run.estimator)
        axes = AxesPolicy.SAME if entry is None else entry.axes
    found = _axes_of(run, matched, axes, symmetry_transforms, roundness)
    true = matched if found.T_true_run is None else relabelled(matched, found.T_true_run)
    compared = _compared(run.trajectory, true)
    compared = replace(compared, symmetry=found.symmetry, defines_axes=found.defines_axes)
    if found.T_true_run is not None:
        R = np.broadcast_to(found.T_true_run, (len(run), 4, 4))[:, :3, :3]
        compared = replace(compared, R_true_run=R)
    return _with_points(compared, run, true_points or {})


def match_times(time_s: FloatArray, truth_time_s: FloatArray, tolerance_s: float) -> IntArray:
    """(n,) row of the truth nearest in time to each frame, -1 beyond the tolerance."""
    if not len(truth_time_s):
        return np.full(len(time_s), -1, dtype=np.intp)
    order = np.argsort(truth_time_s)
    ordered = truth_time_s[order]
    after = np.searchsorted(ordered, time_s).clip(0, len(ordered) - 1)
    before = (after - 1).clip(0)
    nearest = np.where(
        np.abs(ordered[before] - time_s) <= np.abs(ordered[after] - time_s), before, after
    )
    close = np.abs(ordered[nearest] - time_s) <= tolerance_s
    return np.where(close, order[nearest], -1).astype(np.intp)


def relabelled(truth: Trajectory, T_true_run: FloatArray) -> Trajectory:
    """The same motion told in other body axes, which ``T_true_run`` (4, 4) or (n, 4, 4) takes to
    the true ones: a symmetry of the target, or a turn.

    A point p of the body becomes ``T^-1 p``; rates and inertia turn with it, the orbit stays.
    """
    T = np.broadcast_to(T_true_run, (len(truth), 4, 4))
    R = T[:, :3, :3]
    values = dict(truth.values)
    if ATTITUDE in truth:
        values[ATTITUDE.name] = truth[ATTITUDE] @ R
    if RATE in truth:
        values[RATE.name] = np.einsum("ni,nij->nj", truth[RATE], R)
    if CENTRE in truth:
        back = invert_transform(T)
        turned = np.einsum("nij,nj->ni", back[:, :3, :3], truth[CENTRE])
        values[CENTRE.name] = turned + back[:, :3, 3]
    if RATIOS in truth:
        inertia = np.swapaxes(R, -1, -2) @ inertia_from_ratios(truth[RATIOS]) @ R
        values[RATIOS.name] = ratios_from_inertia(inertia)
    pose = truth.T_cam_target
    return replace(truth, values=values, T_cam_target=None if pose is None else pose @ T)


def principal_rotation(inertia: FloatArray) -> FloatArray:
    """(3, 3) R_body_principal: axes of falling moment, right-handed, of arbitrary signs."""
    _, axes = np.linalg.eigh(inertia)
    axes = axes[:, ::-1]
    return np.asarray(axes * [1.0, 1.0, np.linalg.det(axes)])


@dataclass(frozen=True)
class _Axes:
    """How the axes of a run lie in the true ones."""

    T_true_run: FloatArray | None = None
    """(4, 4) or (n, 4, 4); None where they are the same."""
    symmetry: int = 0
    defines_axes: BoolArray | None = None


def _axes_of(
    run: Run,
    truth: Trajectory,
    axes: AxesPolicy,
    symmetries: FloatArray | None,
    roundness: Roundness | None,
) -> _Axes:
    if run.segments and ATTITUDE in truth:
        return _segment_axes(run, truth)
    if axes is AxesPolicy.SYMMETRY and symmetries is not None:
        return _symmetric_axes(run, truth, symmetries, roundness)
    if axes is AxesPolicy.SYMMETRY_OF_FRAME and symmetries is not None:
        relative = _relative_attitudes(run.trajectory, truth)
        chosen = symmetries[_nearest_symmetries(relative, symmetries, roundness)]
        return _Axes(_turned_alike(relative, chosen, roundness))
    if axes is AxesPolicy.PRINCIPAL:
        R_true_run = _nearest_principal(run.trajectory, truth)
        return _Axes(make_transform(R_true_run, np.zeros(3)))
    return _Axes()


def _relative_attitudes(run: Trajectory, truth: Trajectory) -> FloatArray:
    """(n, 3, 3) from the true model axes to the run's, frame by frame; nan where one is missing."""
    if truth.T_cam_target is not None and run.T_cam_target is not None:
        return _between(truth.T_cam_target[:, :3, :3], run.T_cam_target[:, :3, :3])
    if ATTITUDE in truth and ATTITUDE in run:
        return _between(truth[ATTITUDE], run[ATTITUDE])
    return np.full((len(run), 3, 3), np.nan)


def _symmetric_axes(
    run: Run, truth: Trajectory, symmetries: FloatArray, roundness: Roundness | None
) -> _Axes:
    """One symmetry for every track; that of the first in which any is known is reported.

    A track that jumps from one equivalent attitude to another is wrong and is not to be excused
    frame by frame. Where a target was lost and found anew, nothing tells which it was before.
    """
    relative = _relative_attitudes(run.trajectory, truth)
    known = np.isfinite(relative).all(axis=(1, 2))
    track = np.cumsum(np.isin(run.status, (Status.ACQUIRING, Status.LOST)))
    best = {
        k: _best_symmetry(relative[known & (track == k)], symmetries, roundness)
        for k in np.unique(track[known]).tolist()
    }
    first = next(iter(best.values()), 0)
    chosen = symmetries[first]
    if len(set(best.values())) > 1:
        chosen = symmetries[[best.get(k, first) for k in track.tolist()]]
    return _Axes(_turned_alike(relative, chosen, roundness), first)


def _best_symmetry(
    relative: FloatArray, symmetries: FloatArray, roundness: Roundness | None
) -> int:
    """Which symmetry S makes ``T_cam_model @ S`` of the truth fit attitudes (n, 3, 3) best."""
    angles = np.median(_angles_under(relative, symmetries, roundness), axis=0)
    # Equal angles differ by rounding; the identity comes first and is to win then.
    return int(np.argmax(angles <= angles.min() + 1e-9))


def _nearest_symmetries(
    relative: FloatArray, symmetries: FloatArray, roundness: Roundness | None
) -> IntArray:
    """(n,) which symmetry brings the truth nearest to the run in attitude, frame by frame."""
    choice = np.zeros(len(relative), dtype=np.intp)
    known = np.isfinite(relative).all(axis=(1, 2))
    if known.any():
        choice[known] = _angles_under(relative[known], symmetries, roundness).argmin(axis=1)
    return choice


def _angles_under(
    relative: FloatArray, symmetries: FloatArray, roundness: Roundness | None
) -> FloatArray:
    """(n, k) by how much attitudes differ under each symmetry, however a round target is turned."""
    left = np.swapaxes(symmetries[:, :3, :3], -1, -2) @ relative[:, None]
    if roundness is not None:
        left = np.swapaxes(roundness.towards(left)[..., :3, :3], -1, -2) @ left
    return rotation_angle(left)


def _turned_alike(
    relative: FloatArray, T_true_run: FloatArray, roundness: Roundness | None
) -> FloatArray:
    """(4, 4) or (n, 4, 4) motions, those of a round target turned as the run has it in each frame;
    as in the frame before where the run has no pose."""
    if roundness is None:
        return T_true_run
    T = np.broadcast_to(T_true_run, (len(relative), 4, 4))
    left = np.swapaxes(T[:, :3, :3], -1, -2) @ relative
    known = np.asarray(np.isfinite(left).all(axis=(1, 2)))
    if not known.any():
        return T_true_run
    last = np.maximum.accumulate(np.where(known, np.arange(len(known)), -1))
    last[last < 0] = int(np.argmax(known))
    return np.asarray(T @ roundness.towards(left[last]))


def _nearest_principal(run: Trajectory, truth: Trajectory) -> FloatArray:
    """(3, 3) R_body_principal of the truth whose signs fit the run best, one for the whole run."""
    if RATIOS not in truth or ATTITUDE not in truth:
        return np.eye(3)
    relative = _between(run[ATTITUDE], truth[ATTITUDE])
    known = np.flatnonzero(np.isfinite(relative).all(axis=(1, 2)))
    if not known.size:
        return np.eye(3)
    axes = principal_rotation(inertia_from_ratios(truth[RATIOS][known[0]]))
    signs = [np.array([a, b, a * b]) for a, b in product((1.0, -1.0), repeat=2)]
    angles = [np.median(rotation_angle(relative[known] @ (axes * sign))) for sign in signs]
    return np.asarray(axes * signs[int(np.argmin(angles))])


def _segment_axes(run: Run, truth: Trajectory) -> _Axes:
    """Of axes that are the run's own: tied to the true ones where each segment begins.

    Without a truth there, at the segment's first frame that has both; before that nothing is known.
    """
    n, own, true = len(run), run.trajectory[ATTITUDE], truth[ATTITUDE]
    T, defines = np.full((n, 4, 4), np.nan), np.zeros(n, dtype=np.bool_)
    both = np.isfinite(own[:, 0, 0] + true[:, 0, 0])
    starts = [int(np.searchsorted(run.time_s, segment.time_s)) for segment in run.segments]
    for segment, first, end in zip(run.segments, starts, [*starts[1:], n], strict=True):
        tie, R_world_run = first, segment.R_world_body
        if first < end and np.isnan(true[first, 0, 0]) and both[first:end].any():
            tie = first + int(np.argmax(both[first:end]))
            R_world_run = own[tie]
        if tie < end:
            T[tie:end] = make_transform(true[tie].T @ R_world_run, np.zeros(3))
            defines[tie] = True
    return _Axes(T, defines_axes=defines)


def _compared(run: Trajectory, truth: Trajectory) -> Errors:
    n = len(run)
    p_cam_m, theta = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
    if truth.T_cam_target is not None and run.T_cam_target is not None:
        p_cam_m = truth.T_cam_target[:, :3, 3] - run.T_cam_target[:, :3, 3]
        theta = _log_between(run.T_cam_target[:, :3, :3], truth.T_cam_target[:, :3, :3])
    state = {}
    for name, values in run.values.items():
        true = truth.values.get(name)
        if true is None:
            size = 3 if name == ATTITUDE.name else values.shape[1]
            state[name] = np.full((n, size), np.nan)
        elif name == ATTITUDE.name:
            state[name] = _log_between(values, true)
        else:
            state[name] = true - values
    return Errors(state, p_cam_m, theta, truth)


def _with_points(compared: Errors, run: Run, true_points: Mapping[int, FloatArray]) -> Errors:
    """With the distances of the estimated points from the true ones, turned into the run's axes."""
    table = None if run.folder is None else read_points(run.folder)
    if table is None:
        return compared
    R = np.eye(3)
    if compared.R_true_run is not None and len(run):
        R = compared.R_true_run[0]
    points = {number: R.T @ p for number, p in true_points.items()}
    rms, last = point_errors(table, points, run.time_s)
    known = np.isfinite(compared.truth[ATTITUDE][:, 0, 0]) if ATTITUDE in compared.truth else False
    return replace(compared, points_rms_m=np.where(known, rms, np.nan), point_m=last)


def point_errors(
    table: PointTable, true_points: Mapping[int, FloatArray], time_s: FloatArray
) -> tuple[FloatArray, dict[int, float]]:
    """RMS distances (n,) of the points at times (n,), and those of the last points by feature."""
    known = np.array([number in true_points for number in table.feature.tolist()], dtype=np.bool_)
    rms, last = np.full(len(time_s), np.nan), dict[int, float]()
    if not known.any():
        return rms, last
    feature, frame = table.feature[known], np.searchsorted(time_s, table.time_s[known])
    true = np.stack([true_points[number] for number in feature.tolist()])
    squared = np.sum(np.square(table.p_body[known] - true), axis=1)
    count = np.bincount(frame, minlength=len(time_s))
    total = np.bincount(frame, squared, minlength=len(time_s))
    rms[count > 0] = np.sqrt(total[count > 0] / count[count > 0])
    at_end = frame == np.searchsorted(time_s, table.time_s[-1])
    distances = np.sqrt(squared[at_end]).tolist()
    return rms, dict(zip(feature[at_end].tolist(), distances, strict=True))


def _at_rows(truth: Trajectory, rows: IntArray, time_s: FloatArray) -> Trajectory:
    """The truth at frames whose rows are given, nan where it is -1."""
    missing = rows < 0

    def without(array: FloatArray) -> FloatArray:
        array = array.copy()
        array[missing] = np.nan
        return array

    found = truth.at(rows)
    pose = found.T_cam_target
    return replace(
        found,
        time_s=time_s,
        values={name: without(values) for name, values in found.values.items()},
        T_cam_target=None if pose is None else without(pose),
    )


def _between(R_from: FloatArray, R_to: FloatArray) -> FloatArray:
    """(n, 3, 3) ``R_from^T R_to``."""
    return np.asarray(np.swapaxes(R_from, -1, -2) @ R_to)


def _log_between(R_from: FloatArray, R_to: FloatArray) -> FloatArray:
    """(n, 3) log of ``R_from^T R_to``, nan where either is."""
    relative = _between(R_from, R_to)
    known = np.isfinite(relative).all(axis=(1, 2))
    vectors = np.full((len(relative), 3), np.nan)
    if known.any():
        vectors[known] = log_rotation(relative[known])
    return vectors
