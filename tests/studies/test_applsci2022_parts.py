"""The parts of the study of Appl. Sci. 2022: its satellite, its runs, its tables."""

import numpy as np
import pytest

from pcnav.batch.monte_carlo import Run
from pcnav.estimators.image_motion.relative import Outcome
from pcnav.simulation.images import TrackFaults
from studies.applsci2022 import limits, paper, rendered, runs
from studies.applsci2022.runs import Chained, ChainErrors, errors_table, outcomes_table, run_case
from studies.applsci2022.scene import nutation, tracks_of

pytest.importorskip("poselib", reason="the extra `images` is not installed")


def test_the_box_has_the_printed_mass_properties() -> None:
    half, R_body_hull = paper.hull_half_sides_m()
    a, b, c = half**2
    moments = paper.MASS_KG / 3.0 * np.array([b + c, a + c, a + b])
    assert R_body_hull @ np.diag(moments) @ R_body_hull.T == pytest.approx(paper.INERTIA_KG_M2)
    assert np.linalg.det(R_body_hull) == pytest.approx(1.0)
    # Some metres, as the text has it.
    assert 1.0 < 2.0 * half.min() < 2.0 * half.max() < 7.0


def test_the_motion_keeps_energy_and_momentum() -> None:
    truth = nutation(60.0, 1.0, seed=0)
    momentum = truth.R_world_body @ (truth.omega_body @ paper.INERTIA_KG_M2)[..., None]
    assert np.ptp(momentum, axis=0).max() < 1e-9 * np.linalg.norm(momentum[0])
    energy = np.einsum("ni,ij,nj->n", truth.omega_body, paper.INERTIA_KG_M2, truth.omega_body)
    assert np.ptp(energy) < 1e-9 * energy[0]
    half, R_body_hull = paper.hull_half_sides_m()
    inside = np.abs(truth.points @ R_body_hull) / half
    assert inside.max() == pytest.approx(1.0)
    assert np.all(np.isclose(inside, 1.0).sum(axis=1) == 1)
    assert min(len(frame.features) for frame in tracks_of(truth, TrackFaults(), 0).frames) > 8


def chained(chain, faults):
    return run_case(Run(Chained(chain, faults, 1.0, 20.0).case("chain, faults"), 0, seed=1))


def test_the_printed_chain_is_exact_without_noise_and_lost_with_wrong_matches() -> None:
    exact = chained(runs.PRINTED, TrackFaults())
    assert np.nanmax(exact.angle_deg) < 1e-5
    assert exact.outcomes == {Outcome.FIRST: 1, Outcome.MEASURED: 20}
    wrong = TrackFaults(0.1, wrong_match_fraction=0.2)
    lost = chained(runs.PRINTED, wrong)
    assert np.nanmax(lost.angle_deg) > 20.0
    kept = chained(runs.KEY_FRAMES, wrong)
    assert np.nanmax(kept.angle_deg) < 2.0
    both = ChainErrors.of([lost, kept])
    last = np.concatenate([lost.angle_deg[0, 10:], kept.angle_deg[0, 10:]])
    assert both.error_at_end == pytest.approx(np.sqrt(np.nanmean(last**2)))
    shown = float(errors_table("key", [both]).rows[0][5])
    assert shown == pytest.approx(both.error_at_end, rel=5e-3)
    counts = outcomes_table("key", [both]).rows[0][1:]
    assert sum(int(count) for count in counts) == 2 * 21


def test_accuracy_falls_with_the_square_of_the_range() -> None:
    rows = limits.accuracy_table().rows
    worst = np.array([float(row[1]) for row in rows])
    best = np.array([float(row[2]) for row in rows])
    assert worst[1:] / worst[:-1] == pytest.approx(np.full(3, 4.0), rel=0.1)
    assert best[1:] / best[:-1] == pytest.approx(np.full(3, 2.0), rel=0.1)


def test_degenerate_views_are_never_measured() -> None:
    for name, _, told in limits.degenerate_table().rows:
        assert ("measured" in told) == (name == "tumbling")


def test_the_translation_answers_what_is_known() -> None:
    rows = {row[0]: row for row in limits.translation_table().rows}
    assert rows["both places"][1] == "found"
    assert rows["both directions"][1].startswith("direction_only: needs the range")
    assert rows["both ranges"][1].startswith("open")
    assert float(rows["both directions, first range"][2]) < 0.05


def test_corners_of_rendered_images_stay_on_the_hull() -> None:
    """Against the point of the box that the first sight of each is a ray to."""
    pytest.importorskip("cv2", reason="the extra `images` is not installed")
    tracked = rendered.track_images(3.0)
    first = tracked.tracks.frames[0].pixels
    assert len(first) > 100
    columns, rows = np.rint(first).astype(int).T
    assert tracked.first[rows, columns].min() > 0
    assert tracked.matches.min() > 8
    # The tracker states 0.1 px; a hull half a degree off would leave a pixel.
    assert 0.0 < np.sqrt(np.mean(tracked.pixel_error**2)) < 0.1
    assert np.nanmax(tracked.angle_deg) < 0.5
    met = {claim.quantity.split(",")[0]: claim.met for claim in rendered.rendered_claims(tracked)}
    assert met["features followed"]
    figures = rendered.rendered_figures(tracked)
    assert [figure.key for figure in figures] == ["fig_5", "fig_7"]
    assert b"<image" in figures[0].svg
