"""Simulated rows that are exposed one after the other, against the true motion at their times."""

from pathlib import Path
from typing import Any

import numpy as np

from pcnav.config.pipeline_file import Pipeline
from pcnav.simulation.depth import Scene
from pcnav.simulation.motion import true_motion
from pcnav.simulation.readout import RowTimes
from pcnav.target.row_motion import row_times
from pcnav.target.satellite import load_target


def pipeline(frames: int, rate_hz: float, **camera: Any) -> Pipeline:
    return Pipeline.model_validate(
        {
            "scenario": {"frames": frames, "frame_rate_hz": rate_hz},
            "orbit": {"mean_motion_rad_s": 0.0011, "v_hill_m_s": [0.02, -0.05, 0.03]},
            "body": {
                "omega_body_deg_s": [8.0, -9.0, 16.0],
                "com_model_m": [0.1, 0.12, -0.13],
                "inertia_ratios": [0.577, 0.735, -0.02, 0.06, -0.045],
            },
            "camera": {"width_px": 96, "height_px": 96} | camera,
            "noise": {"range_sigma_m": 0.0},
        }
    )


def test_poses_of_rows_are_those_of_the_true_motion() -> None:
    coarse, fine = true_motion(pipeline(8, 10.0)), true_motion(pipeline(711, 1000.0))
    rows = RowTimes(coarse.truth.time_s, 0.04)
    for k in (0, 3, 7):
        poses = rows.poses(coarse.truth.poses, k, 41)
        assert poses is not None
        for v in (0, 10, 20, 30, 40):
            at_ms = 100 * k + v - 20
            if not 0 <= at_ms < 711:
                continue
            expected = fine.truth.poses[at_ms]
            # At the ends, with a neighbour on one side only, to the first order.
            atol = 2e-6 if k == 3 else 3e-4
            np.testing.assert_allclose(poses[v], expected, atol=atol)
    assert RowTimes(coarse.truth.time_s[:1], 0.04).poses(coarse.truth.poses[:1], 0, 41) is None


def test_frames_are_read_out_row_by_row(repository: Path) -> None:
    target = load_target(repository / "meshes" / "boxsat.obj")
    still, rolling = (
        Scene.showing(target, pipeline(3, 10.0, row_readout_s=readout_s))
        for readout_s in (0.0, 0.03)
    )
    assert rolling.info.row_readout_s == 0.03
    np.testing.assert_array_equal(rolling.truth.poses, still.truth.poses)
    a, b = list(still)[1].depth_m, list(rolling)[1].depth_m
    seen = (a > 0.0) & (b > 0.0)
    # The middle rows are seen at the time of the frame, the outer ones up to 15 ms from it.
    off = np.abs(a - b)
    middle = seen & (np.abs(row_times(0.03, 96)) < 2e-4)[:, None]
    assert middle.sum() > 10
    assert np.median(off[middle]) < 1.5e-3
    outer = seen & (np.abs(row_times(0.03, 96)) > 3e-3)[:, None]
    assert np.median(off[outer]) > np.median(off[middle])
