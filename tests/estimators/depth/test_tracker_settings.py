"""What the tracker makes of units, priors and noise that are stated."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from pcnav.config.depth import FilterTable, PerceptionTable
from pcnav.core.errors import InputError
from pcnav.dynamics.state import COM_MODEL, INERTIA_RATIOS
from pcnav.estimators.depth.tracker import Tracker
from pcnav.recordings.sequence import InitialPrior
from pcnav.runs.status import Status
from tests.estimators.depth.tracked_boxsat import INFO, Recording, tracker_of


def test_a_speck_before_the_target_comes_into_view_is_no_fault_of_units(
    recording: Recording,
) -> None:
    speck = np.zeros_like(recording.frames[0].depth_m)
    speck[100:102, 100:102] = 20.0
    tracker = tracker_of(recording.target)
    estimate = tracker.step(replace(recording.frames[0], depth_m=speck))
    assert estimate.status == Status.ACQUIRING


def test_a_mesh_in_millimetres_is_told(recording: Recording) -> None:
    mesh: trimesh.Trimesh = recording.target.mesh.copy()
    mesh.apply_scale(1000.0)
    rectangles = tuple(
        replace(r, length_m=1000.0 * r.length_m, width_m=1000.0 * r.width_m)
        for r in recording.target.rectangles
    )
    wrong = replace(recording.target, mesh=mesh, rectangles=rectangles)
    with pytest.raises(InputError, match=r"units.*metres") as caught:
        tracker_of(wrong).step(recording.frames[0])
    assert caught.value.file == recording.target.mesh_path
    assert "\n" not in str(caught.value)


def test_prior_is_that_of_the_file_then_the_sequence_then_the_target(recording: Recording) -> None:
    prior = InitialPrior(
        com_model_m=tuple(recording.motion.state(0).com_model.tolist()),
        com_sd_m=(1e-3,) * 3,
        inertia_ratios=tuple(recording.motion.state(0).inertia_ratios.tolist()),
        inertia_ratios_sd=(1e-3,) * 5,
    )
    stated = replace(INFO, initial=prior)
    com_of_shape, ratios_of_shape = (float(sd.max()) for sd in recording.target.mass.prior.sd)
    for info, filtering, com_sd, ratio_sd in (
        # A wide distribution of ratios is one of the parameters, bent.
        (INFO, FilterTable(), com_of_shape, 1.3 * ratios_of_shape),
        (stated, FilterTable(), 1e-3, 1e-3),
        (stated, FilterTable(com_sd_m=0.02, inertia_ratio_sd=0.03), 0.02, 0.03),
    ):
        tracker = tracker_of(recording.target, info, filtering)
        steps = (tracker.step(frame) for frame in recording.frames[:6])
        first = next(estimate for estimate in steps if estimate.covariance is not None)
        assert first.covariance is not None
        sd = np.sqrt(np.diag(first.covariance))
        # A few frames tell little of the mass properties: their prior still stands.
        assert np.all(sd[COM_MODEL] <= com_sd * 1.001)
        assert np.max(sd[COM_MODEL]) > 0.5 * com_sd
        # The covariance of the ratios is that of the filter's parameters, taken where the estimate
        # is now.
        assert np.all(sd[INERTIA_RATIOS] <= ratio_sd * 1.05)
        assert np.max(sd[INERTIA_RATIOS]) > 0.5 * ratio_sd


def test_range_noise_of_the_perception_table_replaces_the_sequence_s(recording: Recording) -> None:
    deviations = []
    for table in (PerceptionTable(), PerceptionTable(range_sigma_m=0.04)):
        tracker = Tracker(recording.target, INFO, table, FilterTable(), 0)
        estimate = tracker.step(recording.frames[0])
        deviations.append(estimate.records[0].sd[2])
    assert deviations[1] == pytest.approx(2.0 * deviations[0], rel=0.2)
