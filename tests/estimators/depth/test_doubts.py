"""What speaks against an estimate, provoked by recordings that are not what they are said to be."""

from collections import Counter
from dataclasses import replace
from typing import Any

import pytest

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.camera import PinholeCamera
from pcnav.estimators.depth.doubts import rim_step_px
from pcnav.estimators.depth.tracker import Tracker
from pcnav.recordings.calibration import NOT_STATED
from pcnav.recordings.sequence import Frame, InitialPrior
from pcnav.runs.doubts import Doubt, doubts_in
from pcnav.runs.status import CLAIMED
from pcnav.simulation.depth import Scene
from pcnav.target.satellite import Target
from tests.estimators.depth.tracked_boxsat import PIPELINE, shortened

FRAMES = 24


def raised(
    target: Target,
    initial: InitialPrior | None = None,
    stated: PinholeCamera | None = None,
    **tables: object,
) -> tuple[Counter[Doubt], Tracker]:
    """How many claimed frames raise each doubt, of frames that are said to be of a camera."""
    pipeline: dict[str, Any] = shortened(PIPELINE, FRAMES).model_dump()
    for name, keys in tables.items():
        pipeline[name].update(keys)
    scene = Scene.of(Pipeline.model_validate(pipeline), target.mesh)
    info = replace(scene.info, initial=initial, calibration=NOT_STATED)
    p = scene.pipeline
    tracker = Tracker(target, info, p.perception, p.filter, p.seed)
    counts: Counter[Doubt] = Counter()
    for frame in scene.frames():
        shown: Frame = frame if stated is None else replace(frame, camera=stated)
        estimate = tracker.step(shown)
        if estimate.status in CLAIMED:
            counts.update(doubts_in(str(estimate.notes["doubts"] or "")))
    return counts, tracker


@pytest.fixture(scope="module")
def camera() -> PinholeCamera:
    return PIPELINE.camera.pinhole


def test_a_recording_that_is_as_it_is_said_to_be_raises_none(boxsat: Target) -> None:
    counts, tracker = raised(boxsat)
    assert not counts
    assert not tracker.remarks


def test_a_principal_point_elsewhere_lies_across_the_image(
    boxsat: Target, camera: PinholeCamera
) -> None:
    counts, tracker = raised(boxsat, stated=replace(camera, cx=camera.cx + 4.0))
    assert counts[Doubt.TILT] > FRAMES // 3
    assert "principal point" in tracker.remarks[-1]


def test_another_focal_length_makes_innovations_too_large(
    boxsat: Target, camera: PinholeCamera
) -> None:
    far = replace(camera, fx=1.03 * camera.fx, fy=1.03 * camera.fy)
    counts, _ = raised(boxsat, stated=far)
    assert counts[Doubt.NIS] > FRAMES // 3
    assert counts[Doubt.TILT] > 0


def test_pixels_that_return_from_any_of_their_area_are_a_step_at_the_rim(boxsat: Target) -> None:
    """Half a pixel outside; of slanted edges a part of that is their slope's."""
    counts, tracker = raised(boxsat, noise={"footprint": "any"})
    assert counts[Doubt.RIM] > FRAMES // 3
    assert counts[Doubt.TILT] == 0
    assert 0.3 < rim_step_px(tracker.sensor_noise) < 0.6


def test_what_stands_before_the_target_is_not_explained(boxsat: Target) -> None:
    crossing = {"kind": "arm", "start_s": 5.0, "end_s": 9.0}
    assert raised(boxsat, occluder=crossing)[0][Doubt.EXPLAINED] > 0


def test_frames_against_the_stated_mass_say_so_from_then_on(boxsat: Target) -> None:
    wrong = InitialPrior(inertia_ratios=(1.4, 1.2, 0.0, 0.0, 0.0), inertia_ratios_sd=5 * (0.01,))
    counts, tracker = raised(boxsat, initial=wrong)
    # The arc is fitted anew now and then.
    assert counts[Doubt.PRIOR] >= 3
    assert "inertia" in tracker.remarks[0]
