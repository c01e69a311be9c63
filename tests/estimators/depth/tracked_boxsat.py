"""A recording of the shipped satellite in memory, and tracks through it."""

from dataclasses import dataclass

from pcnav.config.depth import FilterTable, Measurements, PerceptionTable
from pcnav.config.pipeline_file import Pipeline
from pcnav.estimators.depth.tracker import Tracker
from pcnav.recordings.calibration import EXACT
from pcnav.recordings.sequence import Frame, SequenceInfo
from pcnav.runs.estimate import Estimate
from pcnav.simulation.motion import TrueMotion, true_motion
from pcnav.simulation.noise import add_sensor_faults
from pcnav.target.rendering import DepthRenderer
from pcnav.target.satellite import Target

FRAMES = 40
PIPELINE = Pipeline.model_validate(
    {
        "seed": 3,
        "scenario": {"frames": FRAMES, "frame_rate_hz": 2.0},
        "orbit": {
            "mean_motion_rad_s": 0.0011,
            "r_hill_m": [22.0, 0.2, -0.1],
            "v_hill_m_s": [0.004, -0.002, 0.003],
        },
        "body": {
            "attitude_rotvec_deg": [25.0, 40.0, -30.0],
            "omega_body_deg_s": [2.0, -1.4, 2.5],
            "com_model_m": [0.10, 0.12, -0.13],
            "inertia_ratios": [0.577, 0.735, -0.02, 0.06, -0.045],
        },
        "camera": {"horizontal_fov_deg": 30.0},
        "noise": {"range_sigma_m": 0.02},
    }
)
SIGMA_M = PIPELINE.noise.range_sigma_m
INFO = SequenceInfo("boxsat", PIPELINE.orbit.mean_motion_rad_s, SIGMA_M, None, calibration=EXACT)


@dataclass(frozen=True)
class Recording:
    target: Target
    frames: list[Frame]
    motion: TrueMotion


def recorded(target: Target, pipeline: Pipeline, first: int = 0) -> Recording:
    """The frames of a pipeline from the first one asked for, in memory."""
    motion = true_motion(pipeline)
    camera = pipeline.camera.pinhole
    renderer = DepthRenderer(target.mesh, camera)
    frames = []
    for k in range(first, len(motion.truth.time_s)):
        clean = renderer.render(motion.truth.poses[k])
        depth_m = add_sensor_faults(clean, pipeline.noise, pipeline.seed, k)
        frames.append(
            Frame(k, float(motion.truth.time_s[k]), depth_m, camera, motion.T_cam_world[k])
        )
    return Recording(target, frames, motion)


def shortened(pipeline: Pipeline, frames: int) -> Pipeline:
    scenario = pipeline.scenario.model_copy(update={"frames": frames})
    return pipeline.model_copy(update={"scenario": scenario})


def tracker_of(
    target: Target,
    info: SequenceInfo = INFO,
    filtering: FilterTable = PIPELINE.filter,
    perception: PerceptionTable = PIPELINE.perception,
) -> Tracker:
    return Tracker(target, info, perception, filtering, PIPELINE.seed)


def track(
    recording: Recording,
    frames: list[Frame],
    measurements: Measurements | None = None,
) -> list[Estimate]:
    perception = PerceptionTable(measurements=measurements)
    tracker = tracker_of(recording.target, perception=perception)
    return [tracker.step(frame) for frame in frames]


def note(estimate: Estimate, name: str) -> float:
    """A number of the tracker's own."""
    value = estimate.notes[name]
    assert isinstance(value, float | int)
    return value
