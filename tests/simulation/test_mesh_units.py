"""Units and files of a mesh go with the recording that shows it, and with the run made from it."""

import numpy as np
import pytest
import trimesh

from pcnav.config.length_unit import LengthUnit
from pcnav.config.pipeline_file import Pipeline, read_pipeline
from pcnav.core.errors import InputError
from pcnav.estimators.choice import simulated_kind
from pcnav.pipeline import run
from pcnav.recordings.opening import open_sequence
from pcnav.simulation.depth import Scene
from pcnav.simulation.simulate import simulate
from pcnav.target.satellite import load_target, target_mesh_of, write_target_toml

PIPELINE = """
target_mesh = "sat.gltf"
mesh_unit = "cm"
[scenario]
frames = 2
[camera]
width_px = 64
height_px = 64
"""


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A pipeline file, and the recording of a glTF in centimetres beside its buffers."""
    folder = tmp_path_factory.mktemp("units")
    box = trimesh.creation.box(extents=(100.0, 200.0, 300.0))
    for name, content in box.export(file_type="gltf").items():
        (folder / name.replace("model.gltf", "sat.gltf")).write_bytes(content)
    (folder / "pipeline.toml").write_text(PIPELINE)
    pipeline = read_pipeline(folder / "pipeline.toml")
    kind = simulated_kind(pipeline, folder / "pipeline.toml")
    simulation = simulate(pipeline, folder / "pipeline.toml", folder / "sat.gltf", kind)
    simulation.write(folder / "recording", False, None)
    return folder


def test_a_recording_states_the_unit_and_takes_the_buffers_along(written):
    info = open_sequence(written / "recording").info
    assert info.mesh_unit is LengthUnit.CENTIMETRE
    assert info.target_mesh is not None
    assert info.target_mesh.parent == written / "recording"
    target = load_target(info.target_mesh, info.mesh_unit)
    assert np.allclose(target.mesh.extents, [1.0, 2.0, 3.0])


def test_a_run_takes_the_unit_of_what_it_is_given(written):
    for name, unit, expected in (
        ("own", None, LengthUnit.CENTIMETRE),
        ("told", LengthUnit.INCH, LengthUnit.INCH),
    ):
        run(written / "recording", written / name, Pipeline(), mesh_unit=unit)
        stated = read_pipeline(written / name / "pipeline.toml")
        assert stated.mesh_unit is expected
    # Of another mesh the recording's unit says nothing.
    run(written / "recording", written / "other", target_mesh=written / "sat.gltf")
    assert read_pipeline(written / "other" / "pipeline.toml").mesh_unit is None


def test_the_toml_beside_a_mesh_states_a_unit_too(tmp_path):
    path = tmp_path / "box.stl"
    trimesh.creation.box(extents=(100.0, 200.0, 300.0)).export(path)
    path.with_suffix(".toml").write_text('mesh_unit = "mm"')
    target = load_target(path)
    assert target.diameter_m == pytest.approx(np.sqrt(0.14))
    assert np.allclose(target_mesh_of(path).extents, [0.1, 0.2, 0.3])
    assert np.allclose(target_mesh_of(path, LengthUnit.METRE).extents, [100.0, 200.0, 300.0])
    # What is written beside it keeps it.
    write_target_toml(target, path.with_suffix(".toml"))
    assert load_target(path).diameter_m == target.diameter_m
    path.with_suffix(".toml").write_text('mesh_unit = "furlong"')
    with pytest.raises(InputError, match="mesh_unit"):
        load_target(path)


def test_a_mesh_without_rectangles_is_simulated_and_run(tmp_path):
    egg = trimesh.creation.icosphere(subdivisions=3)
    egg.apply_scale([1000.0, 1400.0, 2000.0])
    egg.export(tmp_path / "egg.ply")
    (tmp_path / "egg.toml").write_text('mesh_unit = "mm"')
    scene = {"scenario": {"frames": 6}, "camera": {"width_px": 64, "height_px": 64}}
    target = load_target(tmp_path / "egg.ply")
    assert target.rectangles == ()
    Scene.showing(target, Pipeline.model_validate(scene)).write(tmp_path / "recording")
    # The recording has the mesh and the TOML beside it.
    summary = run(tmp_path / "recording", tmp_path / "result")
    assert summary.diagnosis.found
