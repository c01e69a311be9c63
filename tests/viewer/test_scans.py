"""A scan of a target that turns meanwhile is compared as it was taken."""

from pathlib import Path

import numpy as np

from pcnav.config.pipeline_file import Pipeline
from pcnav.estimators.depth.motion_within import motion_about
from pcnav.recordings.opening import open_sequence
from pcnav.recordings.truth import truth_of
from pcnav.simulation.depth import Scene
from pcnav.target.satellite import load_target
from pcnav.viewer.frames import FrameStore


def test_residuals_of_a_scan_are_noise_where_its_motion_is_known(
    tmp_path: Path, repository: Path
) -> None:
    pipeline = Pipeline.model_validate(
        {
            "scenario": {"frames": 3},
            "scan": {"pattern": "raster", "duration_s": 0.4},
            "orbit": {"r_hill_m": (20.0, 0.0, 0.0)},
            "camera": {"horizontal_fov_deg": 32.0, "width_px": 96, "height_px": 96},
            "body": {"omega_body_deg_s": (12.0, -16.0, 20.0)},
        }
    )
    target = load_target(repository / "meshes" / "boxsat.obj")
    Scene.showing(target, pipeline).write(tmp_path / "sequence")
    sequence = open_sequence(tmp_path / "sequence")
    truth = truth_of(sequence)
    assert truth is not None and truth.T_cam_target is not None
    poses = [(float(t), T) for t, T in zip(truth.time_s, truth.T_cam_target, strict=True)]
    spreads = []
    for motion in (motion_about(poses, 1), None):
        store = FrameStore(sequence, target, pipeline.perception, 0)
        assert store.takes_time
        shot = store.get(1, poses[1][0], poses[1][1], motion=motion)
        assert shot is not None and shot.residual_m is not None
        known = shot.residual_m[np.isfinite(shot.residual_m)]
        spreads.append(float(np.quantile(np.abs(known), 0.8)) / store.sigma_m)
    # 80 % of normal numbers are within 1.28.
    assert spreads[0] < 1.5 < 2.0 < spreads[1], spreads
