"""The tracker as programs use it: numpy arrays in, estimates out, one frame at a time.

It is a thin layer over the estimators that ``pcnav run`` uses, and leaves the same result folder.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from pcnav.config.length_unit import LengthUnit
from pcnav.config.pipeline_file import EstimatorTable, Pipeline
from pcnav.config.scenario import OrbitTable
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.errors import InputError
from pcnav.dynamics.blocks import ATTITUDE, MASS_CENTRE_LAYOUT
from pcnav.dynamics.state import NavigationState
from pcnav.estimators.depth.pose_measurement import ObserverPose, pose_covariance
from pcnav.estimators.registry import ESTIMATORS
from pcnav.files.new_folder import refuse_unless_replaceable
from pcnav.navigation import Inputs, Navigation, RunSummary
from pcnav.recordings.calibration import Calibration
from pcnav.recordings.depth_arrays import DepthArrays, DepthUnit, plain_array
from pcnav.recordings.first_pose import first_pose_table, prior_of
from pcnav.recordings.frame_checks import checked_time, checked_transform
from pcnav.recordings.given_frames import GivenFrames
from pcnav.recordings.recording import RecordingKind
from pcnav.recordings.region import Region, restricted
from pcnav.recordings.region_files import gates_of
from pcnav.recordings.sequence import Frame, SequenceInfo
from pcnav.recordings.time_line import zero_of
from pcnav.recordings.writer import depth_step, write_sequence
from pcnav.runs.estimate import Estimate
from pcnav.runs.result_files import STATES_FILE
from pcnav.runs.status import Status
from pcnav.runs.writer import RunWriter
from pcnav.target.mesh_files.writing import write_mesh
from pcnav.target.satellite import Target

_MESH_FILE = "target.obj"
"""In a result, of a target whose mesh is no file."""


class Tracker:
    """Follows one target through depth frames that a program hands over.

    Usage::

        target = pcnav.Target.from_mesh("satellite.stl", unit="mm")
        tracker = pcnav.Tracker(target, camera=K)
        for depth, t in frames:
            est = tracker.step(depth, t)
            if est.is_claimed:
                print(est.pose, est.pose_covariance)
        tracker.save("run")
    """

    def __init__(
        self,
        target: Target,
        camera: PinholeCamera | npt.ArrayLike,
        *,
        range_sigma_m: float | None = None,
        calibration: Calibration | None = None,
        depth_unit: DepthUnit = None,
        depth_is: str = "z",
        invalid_depth: float | None = None,
        mean_motion_rad_s: float = 0.0,
        initial_pose: npt.ArrayLike | None = None,
        initial_pose_sd: tuple[float, float] | None = None,
        estimator: str | None = None,
        pipeline: Pipeline | None = None,
        keep_frames: bool = False,
        name: str = "frames",
    ) -> None:
        """Nothing but the target and the camera has to be known.

        Args:
            target: of `Target.from_mesh`.
            camera: camera matrix (3, 3), pixel centres at integers, or a `PinholeCamera`, which may
                have a lens that distorts.
            range_sigma_m: noise along the ray, m; it is learnt where it is not known.
            calibration: how well camera, clock and mesh are known; None takes what a careful
                calibration leaves, see `pcnav.Calibration`.
            depth_unit: of the arrays: "mm", ..., or metres per unit; floats are metres without it.
            depth_is: "z", along the optical axis, or "range", along the ray.
            invalid_depth: value that means no return besides 0, negative and not finite ones.
            mean_motion_rad_s: of the camera's carrier on a circular orbit; 0 of a laboratory.
            initial_pose: T_cam_model (4, 4) in the first frame, where it is known.
            initial_pose_sd: of its position, m, and attitude, deg; 2 % of the distance and 5 deg.
            estimator: a key of `pcnav.ESTIMATORS` for depth frames; else the pipeline's.
            pipeline: other settings, as `pcnav.read_pipeline` reads them.
            keep_frames: whether frames stay in memory, so that `save` can write them as well.
            name: of the recording, in reports.

        Raises `InputError` for what cannot be.
        """
        given: object = target
        if not isinstance(given, Target):
            expected = f"expected one of Target.from_mesh, got {type(target).__name__}"
            raise InputError("Tracker", "target", expected)
        self._arrays = DepthArrays.of(camera, depth_unit, depth_is, invalid_depth)
        self._info = SequenceInfo(
            name, mean_motion_rad_s, range_sigma_m, None, calibration=calibration
        )
        self._as_run = _settings(pipeline or Pipeline(), estimator, range_sigma_m)
        if initial_pose is not None:
            table = first_pose_table(np.asarray(initial_pose), initial_pose_sd)
            self._as_run = self._as_run.model_copy(update={"initial_pose": table})
        hint = ": step() takes the mask of a frame"
        self._region = gates_of(self._as_run.region, "Tracker", hint)
        self._target, self._keeps_frames = target, keep_frames
        self.reset()

    def reset(self) -> None:
        """Forget all frames and estimates, and begin anew with the next frame."""
        inputs = Inputs(GivenFrames(self._info), self._as_run, self._target)
        self._navigation = Navigation(inputs)
        self._estimates: list[Estimate] = []
        self._kept: list[Frame] = []
        self._zero_s, self._rests = 0.0, True
        self._last: tuple[Estimate, FloatArray] | None = None

    def __repr__(self) -> str:
        answer = "no frame yet" if self.last is None else repr(self.last)
        return f"<Tracker of {self._target.name}: {len(self)} frames, {answer}>"

    def __len__(self) -> int:
        """Frames that were taken in."""
        return len(self._estimates)

    @property
    def target(self) -> Target:
        """What is followed."""
        return self._target

    @property
    def last(self) -> Estimate | None:
        """The answer to the last frame."""
        return None if self._last is None else self._last[0]

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """All answers so far; their times count from the first frame where stamps are of an epoch,
        and they have no `Estimate.pose_covariance`."""
        return tuple(self._estimates)

    @property
    def frames(self) -> tuple[Frame, ...]:
        """Those that are kept, without what was masked."""
        return tuple(self._kept)

    def step(
        self,
        depth: npt.ArrayLike,
        t: float,
        T_cam_world: npt.ArrayLike | None = None,
        *,
        mask: npt.NDArray[np.bool_] | None = None,
    ) -> Estimate:
        """Take in one frame.

        Args:
            depth: (height, width); no return is 0, NaN, infinite, negative or masked.
            t: time stamp, s, later than the one before.
            T_cam_world: (4, 4) pose of the camera, ``p_cam = T_cam_world @ p_world``, in an
                inertial world; without it the camera rests. In every frame or in none.
            mask: (height, width) of bool, pixels that may show the target; by default all.

        Raises `InputError` for a frame that cannot be, which is then as if it had never come, and
        where target and depths are of sizes that differ by far.
        """
        where, index = f"frame {len(self)}", len(self)
        time_s, zero_s = self._time(where, t)
        camera_pose = self._camera_pose(where, T_cam_world)
        array = plain_array(where, depth)
        arrays = self._arrays.seen_by(array)
        assert arrays.camera is not None, "its size is known"
        frame = Frame(
            *(index, time_s - zero_s, arrays.in_metres(where, array), arrays.camera, camera_pose)
        )
        if mask is not None:
            frame = restricted(frame, Region(mask=np.asarray(mask)))
        try:
            estimate = self._navigation.step(restricted(frame, self._region))
        except InputError as error:
            if error.field != "units":
                raise
            hint = "; Target.from_mesh(unit=...) and Tracker(depth_unit=...) say which they are in"
            raise InputError(error.file, error.field, error.expected + hint) from error
        # Nothing is remembered of a frame that was refused.
        self._arrays, self._zero_s = arrays, zero_s
        self._estimates.append(estimate)
        if self._keeps_frames:
            self._kept.append(frame)
        answer = self._answer(estimate, time_s, camera_pose)
        self._last, self._rests = (answer, camera_pose), T_cam_world is None
        return answer

    def predict(self, t: float, T_cam_world: npt.ArrayLike | None = None) -> Estimate:
        """The estimate at a later time, if nothing is seen until then; nothing changes.

        ``T_cam_world`` is the camera's pose then, by default that of the last frame. Raises
        `InputError` for an earlier time than that of the last frame, and for an estimator that
        tells poses alone.
        """
        time_s = _seconds("predict", t)
        if self._last is None:
            return Estimate(time_s, str(Status.ACQUIRING))
        last, camera_pose = self._last
        if T_cam_world is not None:
            camera_pose = checked_transform("predict", "T_cam_world", np.asarray(T_cam_world))
        elif time_s == last.time_s:
            return last
        if not time_s > last.time_s:
            expected = f"expected a time after the {last.time_s} s of the last frame"
            raise InputError("predict", "t", f"{expected}, got {time_s} s")
        assert self._arrays.camera is not None, "there was a frame"
        blind = Frame.blind(len(self), time_s - self._zero_s, self._arrays.camera, camera_pose)
        found = self._navigation.estimator.forecast(blind)
        if found is None:
            expected = f"expected an estimator of motions, {self._estimator} tells poses alone"
            raise InputError("predict", "estimator", expected)
        return self._answer(found, time_s, camera_pose)

    def save(
        self,
        folder: Path | str,
        *,
        overwrite: bool = False,
        report: bool = True,
        recording: Path | str | None = None,
    ) -> RunSummary:
        """Write the result folder of all frames so far, as ``pcnav run`` does.

        ``recording`` also writes the frames, as a sequence that ``pcnav run`` reads and
        ``pcnav view`` shows beside the result; it takes ``keep_frames``. Raises `InputError` for a
        folder that exists, or is no earlier result to be overwritten.
        """
        out = Path(folder)
        refuse_unless_replaceable(out.resolve(), overwrite, STATES_FILE)
        if not self._estimates:
            raise InputError(out, "frames", "expected at least one frame to be saved")
        orbit = OrbitTable(mean_motion_rad_s=self._info.mean_motion_rad_s)
        changes: dict[str, object] = {
            **{"time_zero_s": self._zero_s, "mesh_unit": self._mesh_unit, "orbit": orbit},
        }
        if recording is not None:
            changes["sequence"] = str(self._record(Path(recording), overwrite))
        navigation, given = self._navigation, GivenFrames(self._info, self._arrays.camera)
        with RunWriter(out, navigation.estimator.output, overwrite) as writer:
            mesh = self._target.mesh_path.resolve()
            if self._target.as_given is not None:
                write_mesh(self._target.as_given, writer.staging / _MESH_FILE)
                mesh = out.resolve() / _MESH_FILE
            changes["target_mesh"] = str(mesh)
            as_run = self._as_run.model_copy(update=changes)
            navigation.inputs = Inputs(given, as_run, self._target)
            navigation.begin(writer)
            for estimate in navigation.estimator.finish() or self._estimates:
                writer.add(estimate)
            return navigation.complete(writer, command="pcnav.Tracker", report=report)

    @property
    def _estimator(self) -> str:
        return str(self._as_run.estimator.kind)

    @property
    def _mesh_unit(self) -> LengthUnit | None:
        """Of the mesh as it is saved."""
        if self._target.as_given is not None:
            return LengthUnit.METRE
        return self._target.mesh_origin.stated_unit

    def _time(self, where: str, t: float) -> tuple[float, float]:
        """The time stamp of a frame, and that which is time 0: an epoch is not counted from."""
        time_s = _seconds(where, t)
        if self._last is None:
            stated_s = self._as_run.time_zero_s
            return time_s, zero_of(time_s, stated_s or None)
        last_s = self._last[0].time_s
        if not time_s > last_s:
            expected = f"expected a time after the {last_s} s of frame {len(self) - 1}"
            raise InputError(where, "t", f"{expected}, got {time_s} s")
        return time_s, self._zero_s

    def _camera_pose(self, where: str, T_cam_world: npt.ArrayLike | None) -> FloatArray:
        if self._last is not None and self._rests != (T_cam_world is None):
            expected = "expected the camera's pose in every frame or in none"
            raise InputError(where, "T_cam_world", expected)
        if T_cam_world is None:
            return np.eye(4)
        return checked_transform(where, "T_cam_world", np.asarray(T_cam_world))

    def _answer(self, estimate: Estimate, t: float, T_cam_world: FloatArray) -> Estimate:
        """An estimate as a program is given it: under the frame's own time stamp, and with all
        covariances."""
        layout, P = self._navigation.estimator.output.layout, None
        if layout == MASS_CENTRE_LAYOUT and estimate.covariance is not None:
            rate = self._info.mean_motion_rad_s
            observer = ObserverPose.of(T_cam_world, estimate.time_s, rate)
            state = NavigationState(
                **{_FIELDS.get(name, name): value for name, value in estimate.values.items()}
            )
            P = pose_covariance(state, estimate.covariance, observer)
        return replace(estimate, time_s=t, layout=layout, pose_covariance=P)

    def _record(self, folder: Path, overwrite: bool) -> Path:
        """Write the frames as a sequence with the target's mesh; where it then is."""
        if len(self._kept) < len(self):
            expected = "expected keep_frames=True of the Tracker whose frames are written"
            raise InputError(folder, "recording", expected)
        with tempfile.TemporaryDirectory() as place:
            mesh = self._target.mesh_path
            if self._target.as_given is not None:
                mesh = Path(place) / _MESH_FILE
                write_mesh(self._target.as_given, mesh)
            info = replace(
                self._info,
                target_mesh=mesh,
                mesh_unit=self._mesh_unit,
                time_zero_s=self._zero_s,
                first_pose=prior_of(self._as_run.initial_pose),
            )
            write_sequence(folder, info, depth_step(self._kept), self._kept, overwrite=overwrite)
        return folder.resolve()


_FIELDS = {ATTITUDE.name: "R_world_body"}
"""Of a `NavigationState` that are called otherwise than their blocks."""


def _seconds(where: str, t: float) -> float:
    try:
        time_s = float(t)
    except (TypeError, ValueError) as error:
        expected = f"expected seconds as a number, got {type(t).__name__}"
        raise InputError(where, "t", expected) from error
    checked_time(where, time_s)
    return time_s


def _settings(pipeline: Pipeline, estimator: str | None, range_sigma_m: float | None) -> Pipeline:
    """The pipeline as run. Raises `InputError` for an estimator of something else."""
    kind = estimator or str(pipeline.estimator.kind)
    known = [key for key, entry in ESTIMATORS.items() if RecordingKind.DEPTH in entry.takes]
    if kind not in known:
        expected = f"expected one of {', '.join(known)}, which take depth frames, got {kind}"
        raise InputError("Tracker", "estimator", expected)
    changes: dict[str, object] = {}
    if estimator is not None:
        changes["estimator"] = EstimatorTable(kind=estimator)
    if range_sigma_m is not None:
        perception = pipeline.perception.model_copy(update={"range_sigma_m": range_sigma_m})
        changes["perception"] = perception
    return pipeline.model_copy(update=changes)
