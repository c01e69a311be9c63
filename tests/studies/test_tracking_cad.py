"""The chapter of the tracking study on meshes that are not quite the target's."""

from dataclasses import replace

import numpy as np
import pytest

from studies.tracking import another_cad
from studies.tracking.another_cad import OtherRun, foiled, larger, turned, without_panel
from studies.tracking.tumbles import boxsat

from .test_tracking_parts import judged_run


def test_bodies_differ_by_what_they_are_called_after() -> None:
    target = boxsat().target
    right = target.mesh
    assert turned(10.0)(target).volume == pytest.approx(right.volume)
    off_m = np.abs(turned(10.0)(target).triangles - right.triangles).max()
    assert off_m == pytest.approx(0.75 * np.deg2rad(10.0), rel=0.05)
    assert without_panel(target).area < 0.8 * right.area
    assert larger(target).volume == pytest.approx(1.01**3 * right.volume)
    foil = foiled(target)
    assert len(foil.faces) > 1000 and np.abs(foil.bounds - right.bounds).max() < 0.1


def test_bars_are_of_the_error_beside_the_right_mesh_and_of_the_name() -> None:
    words, off_m = ("locked",) * 4, np.full(4, 0.01)
    beside = judged_run(words, off_m, np.full(4, 0.01))
    beside.errors.theta_model_rad[:] = 0.001
    run = replace(judged_run(words, 1.5 * off_m, np.full(4, 0.01)), changed_parts=("panel_long",))
    run.errors.theta_model_rad[:] = 0.001
    own = OtherRun("panel missing", 0, run, beside)
    assert another_cad.ratios([own]) == pytest.approx((1.5, 1.0))
    assert [claim.met for claim in another_cad.claims({"panel missing": [own]})] == [True] * 3
    silent = replace(own, run=replace(run, changed_parts=()), beside=run)
    met = [claim.met for claim in another_cad.claims({"panel missing": [silent]})]
    assert met == [True, True, False]
