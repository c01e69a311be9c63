"""A mesh that is of another size than what is seen is told, in a run and by its numbers."""

import numpy as np
import pytest
import trimesh

from pcnav.config.pipeline_file import Pipeline
from pcnav.evaluation.size_check import size_doubt, view_spans
from pcnav.pipeline import run
from pcnav.recordings.frame_survey import FrameSurvey, FrameSurveyor
from pcnav.recordings.opening import open_sequence
from pcnav.simulation.depth import Scene
from pcnav.target.satellite import load_target

SCENE = {
    "scenario": {"frames": 3, "frame_rate_hz": 2.0},
    "camera": {"width_px": 64, "height_px": 64},
    "orbit": {"r_hill_m": [25.0, 0.0, 0.0]},
}


@pytest.fixture(scope="module")
def recording(repository, tmp_path_factory):
    """Three frames of boxsat."""
    folder = tmp_path_factory.mktemp("sizes") / "recording"
    target = load_target(repository / "meshes" / "boxsat.obj")
    Scene.showing(target, Pipeline.model_validate(SCENE)).write(folder)
    return folder


@pytest.mark.parametrize(
    ("real_over_mesh", "says"),
    [
        (0.3048, "is it in feet (--mesh-unit ft)?"),
        (3.281, "times too small, or in another unit (--mesh-unit)?"),
    ],
)
@pytest.mark.usefixtures("quick_drawings")
def test_a_run_with_a_mesh_of_another_size_says_so(
    repository, recording, tmp_path, real_over_mesh, says
):
    mesh = trimesh.load_mesh(repository / "meshes" / "boxsat.obj", process=False)
    mesh.apply_scale(1.0 / real_over_mesh)
    mesh.export(tmp_path / "mesh.stl")
    summary = run(recording, tmp_path / "result", target_mesh=tmp_path / "mesh.stl")
    assert not summary.diagnosis.found
    (sentence,) = summary.warnings
    assert "the mesh as it was read" in sentence
    assert says in sentence


@pytest.mark.parametrize(
    ("real_over_mesh", "says"),
    [
        (0.1, "times too large, or in another unit (--mesh-unit)?"),
        (0.0254, "is it in inches (--mesh-unit in)?"),
        (0.01, "is it in centimetres (--mesh-unit cm)?"),
        (0.001, "is it in millimetres (--mesh-unit mm)?"),
        (3.281, "are other things seen, too, or is it"),
    ],
)
def test_frames_tell_other_sizes(repository, recording, real_over_mesh, says):
    surveyor = FrameSurveyor()
    for frame in open_sequence(recording):
        surveyor.add(frame)
    spans_m = view_spans(load_target(repository / "meshes" / "boxsat.obj"))
    assert size_doubt(surveyor.survey(), spans_m, 1.0) is None
    doubt = size_doubt(surveyor.survey(), spans_m / real_over_mesh, 1.0)
    assert doubt is not None
    assert says in doubt


def survey(span_m, cut_share=0.0):
    return FrameSurvey(np.full(5, 900), 20.0, 25.0, span_m, 600.0, cut_share)


def test_sizes_of_all_views_raise_no_doubt(repository):
    spans_m = view_spans(load_target(repository / "meshes" / "boxsat.obj"))
    # Nothing that is seen of a body is farther apart than its bounds' diagonal in camera axes.
    assert spans_m.max() < np.sqrt(3.0) * 10.03
    assert spans_m.min() > 2.0
    for span_m in spans_m:
        assert size_doubt(survey(float(span_m)), spans_m, 1.0) is None


def test_the_unit_that_a_file_declares_is_taken_into_account():
    spans_m = np.linspace(0.005, 0.010, 20)
    doubt = size_doubt(survey(7.0), spans_m * 39.3701, 0.0254)
    assert doubt is not None
    assert "is it in metres (--mesh-unit m)?" in doubt
    # A target cut by the border may be larger than it looks.
    assert size_doubt(survey(1.0, cut_share=0.9), spans_m * 1000.0, 1.0) is None
    assert size_doubt(survey(1.0), spans_m * 1000.0, 1.0) is not None
