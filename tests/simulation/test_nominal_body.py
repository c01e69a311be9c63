"""Mass properties that a scenario does not state are those of its mesh."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from pcnav.config.pipeline_file import Pipeline
from pcnav.config.scenario import BodyTable, ScenarioTable
from pcnav.dynamics.blocks import CENTRE, RATIOS
from pcnav.recordings.recording import RecordingKind
from pcnav.simulation.simulate import simulate

STATED = "[mass]\ncom_model_m = [1.1, 2.0, 2.9]\ninertia_ratios = [0.8, 0.7, 0.02, 0.0, -0.01]\n"


@pytest.fixture
def mesh_path(tmp_path: Path) -> Path:
    box = trimesh.creation.box((1.0, 0.8, 0.6))
    box.apply_translation((1.0, 2.0, 3.0))
    box.export(tmp_path / "box.stl")
    return tmp_path / "box.stl"


def true_mass(pipeline: Pipeline, mesh_path: Path | None) -> tuple[list[float], list[float]]:
    kind = RecordingKind.STEREO_TRACKS if mesh_path is None else RecordingKind.DEPTH
    pipeline = pipeline.model_copy(update={"scenario": ScenarioTable(frames=1)})
    truth = simulate(pipeline, "pipeline", mesh_path, kind).truth
    assert truth is not None
    found = truth[CENTRE][0] if CENTRE in truth else np.zeros(3)
    return np.round(found, 6).tolist(), np.round(truth[RATIOS][0], 6).tolist()


def test_a_box_has_its_centre_and_axes(mesh_path: Path) -> None:
    centre, ratios = true_mass(Pipeline(), mesh_path)
    # The nominal mass of an unknown density is the mean of a few thousand draws.
    np.testing.assert_allclose(centre, [1.0, 2.0, 3.0], atol=0.03)
    yy, zz, *products = ratios
    # Its longest side is x and its shortest z, whatever its density is.
    assert 1.0 < yy < zz < 3.0
    np.testing.assert_allclose(products, 0.0, atol=0.03)


def test_a_sidecar_states_them_and_a_pipeline_has_the_last_word(mesh_path: Path) -> None:
    mesh_path.with_suffix(".toml").write_text(STATED, encoding="utf-8")
    stated = [0.8, 0.7, 0.02, 0.0, -0.01]
    assert true_mass(Pipeline(), mesh_path) == ([1.1, 2.0, 2.9], stated)
    own = Pipeline(body=BodyTable(com_model_m=(0.0, 0.0, 0.0)))
    assert true_mass(own, mesh_path) == ([0.0, 0.0, 0.0], stated)


def test_without_a_mesh_it_is_a_ball() -> None:
    body = BodyTable()
    assert (body.com_model.tolist(), body.ratios.tolist()) == ([0.0] * 3, [1.0, 1.0, 0.0, 0.0, 0.0])
