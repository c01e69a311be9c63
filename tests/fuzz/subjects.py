"""What is mutated and how it is read: good files of every kind, and the readers a user reaches."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh

from pcnav.batch.compare import case_table, compare, overall_table, verdict_lines
from pcnav.batch.grid import read_grid
from pcnav.batch.store import open_store
from pcnav.batch.tabulate import tabulate
from pcnav.config.pipeline_file import read_pipeline
from pcnav.config.region import RegionTable
from pcnav.config.shipped import shipped_mesh
from pcnav.evaluation.metrics import evaluate
from pcnav.recordings.first_pose import parsed_first_pose
from pcnav.recordings.images import open_images
from pcnav.recordings.intake import Intake
from pcnav.recordings.opening import open_recording
from pcnav.recordings.recording import RecordingKind
from pcnav.recordings.sequence import Sequence
from pcnav.recordings.stereo_tracks import read_truth_features
from pcnav.recordings.truth import read_truth
from pcnav.runs.reader import count_outcomes, read_features, read_points, read_records, read_run
from pcnav.simulation.simulate import simulate
from pcnav.target.satellite import load_target
from pcnav.viewer.loading import load_run
from pcnav.viewer.playback import read_recording
from tests.batch.stored_batch import RUNS, stored
from tests.fuzz.recording_subjects import RECORDING_SUBJECTS
from tests.fuzz.subject import Subject
from tests.made_runs import made_run
from tests.recordings.conftest import write_scene
from tests.recordings.test_images import folder_of
from tests.recordings.test_track_files import made_tracks, made_truth

_PIPELINE = """
seed = 7
target_mesh = "boxsat"
[scenario]
frames = 3
frame_rate_hz = 4.0
[orbit]
r_hill_m = [18.0, 0.0, 0.0]
[body]
attitude_rotvec_deg = [25.0, 40.0, -30.0]
omega_body_deg_s = [4.0, -2.8, 5.0]
inertia_ratios = [0.577, 0.735, -0.02, 0.06, -0.045]
[camera]
width_px = 48
height_px = 32
horizontal_fov_deg = 36.0
[noise]
range_sigma_m = 0.01
"""
_SIMULATED = {
    "depth": "",
    "images": '[estimator]\nkind = "image_motion"\n[feature_tracker]\n',
    "stereo": '[estimator]\nkind = "principal_axes"\n[features]\ncount = 12\n',
    "attitudes": '[estimator]\nkind = "attitude_inertia"\n',
}
_GRID = """
[batch]
name = "small"
runs = 3
seed = 5
frames = 8
[base]
satellite = "boxsat"
[[grid]]
cross = { range_m = [15, 20.5], tumble_deg_s = [1, 2, 3], estimator = ["pcnav", "kiss_icp"] }
"""


def _sequence(folder: Path) -> None:
    write_scene(folder)
    truth = '{"cam_R_m2c": [1, 0, 0, 0, 1, 0, 0, 0, 1], "cam_t_m2c": [1.5, 2, 9000], "obj_id": 1}'
    entries = ", ".join(f'"{k}": [{truth}]' for k in range(3))
    (folder / "scene_gt.json").write_text(f"{{{entries}}}")
    (folder / "first.json").write_text(f'{{"0": [{truth}]}}')
    (folder / "first.tum").write_text("0.0 1.0 2.0 9.0 0.0 0.0 0.0 1.0\n")


def _of_format(suffix: str) -> Callable[[Path], None]:
    def build(folder: Path) -> None:
        import tifffile

        write_scene(folder)
        for png in sorted((folder / "depth").iterdir()):
            depth = np.full((6, 8), 5.25, dtype=np.float32)
            path = png.with_suffix(suffix)
            np.save(path, depth) if suffix == ".npy" else tifffile.imwrite(path, depth)
            png.unlink()

    return build


def _tsdf(folder: Path) -> None:
    from PIL import Image

    folder.mkdir()
    np.savetxt(folder / "camera-intrinsics.txt", np.array([[50, 0, 3.5], [0, 51, 2.5], [0, 0, 1]]))
    for number in (3, 12):
        image = np.full((6, 8), 1000 + number, np.uint16)
        Image.fromarray(image).save(folder / f"frame-{number:06d}.depth.png")
        np.savetxt(folder / f"frame-{number:06d}.pose.txt", np.eye(4))


def _masked(folder: Path) -> None:
    from PIL import Image

    write_scene(folder)
    (folder / "mask").mkdir()
    for number in range(3):
        mask = np.full((6, 8), 255, np.uint8)
        Image.fromarray(mask).save(folder / "mask" / f"{number:06d}.png")


def _stereo(folder: Path) -> None:
    from pcnav.recordings.stereo_tracks import write_stereo_tracks

    write_stereo_tracks(folder, made_tracks(), made_truth(), np.ones((18, 3)))


def _simulated(kind: RecordingKind) -> Callable[[Path], None]:
    def build(folder: Path) -> None:
        file = folder.parent / f"{folder.name}.toml"
        file.write_text(_PIPELINE + _SIMULATED[{v: k for k, v in _KINDS.items()}[kind]])
        simulate(read_pipeline(file), file, shipped_mesh("boxsat"), kind).write(folder)

    return build


_KINDS = {
    "depth": RecordingKind.DEPTH,
    "images": RecordingKind.IMAGES,
    "stereo": RecordingKind.STEREO_TRACKS,
    "attitudes": RecordingKind.ATTITUDES,
}


def _images(folder: Path) -> None:
    folder_of(folder)
    (folder / "times.csv").write_text("time_s\n0\n1\n3\n4\n")


_MESHES = ("stl", "ply", "glb", "gltf", "off", "obj")


def _satellite(folder: Path) -> None:
    folder.mkdir()
    mesh = shipped_mesh("boxsat")
    assert mesh is not None
    for file in (mesh, mesh.with_suffix(".toml")):
        shutil.copyfile(file, folder / f"sat{file.suffix}")


def _mesh(kind: str) -> Callable[[Path], None]:
    def build(folder: Path) -> None:
        folder.mkdir()
        box = trimesh.creation.box((1.6, 1.8, 2.2))
        if kind == "gltf":
            for name, data in trimesh.exchange.gltf.export_gltf(trimesh.Scene([box])).items():
                (folder / name).write_bytes(data)
        else:
            box.export(folder / f"box.{kind}")

    return build


def _file(name: str, text: str) -> Callable[[Path], None]:
    def build(folder: Path) -> None:
        folder.mkdir()
        (folder / name).write_text(text)

    return build


def _run(kind: str) -> Callable[[Path], None]:
    def build(folder: Path) -> None:
        made_run(kind, 6).stored(folder)
        mesh = shipped_mesh("boxsat")
        (folder / "pipeline.toml").write_text(_PIPELINE.replace('"boxsat"', f'"{mesh}"'))

    return build


def _unfinished(folder: Path) -> None:
    made_run("depth", 6).stored(folder)
    (folder / "covariances.npz").unlink()
    (folder / "covariances.partial").write_bytes(b"\0" * 8000)


def _batch(folder: Path) -> None:
    stored(folder, RUNS)


def _viser(folder: Path) -> None:
    import msgspec
    import zstandard

    folder.mkdir()
    frame = {"type": "FrameMessage", "name": "/a", "props": {}}
    content = {"durationSeconds": 1.0, "messages": [(0.0, frame)] * 9}
    content |= {"viserVersion": "1.1.1", "binaryBufferLengths": []}
    payload = msgspec.msgpack.encode(content)
    inner = len(payload).to_bytes(8, "little") + payload
    (folder / "a.viser").write_bytes(len(inner).to_bytes(8, "little") + zstandard.compress(inner))


def _read_recording(folder: Path) -> None:
    recording = open_recording(folder)
    truth = read_truth(folder)
    read_truth_features(folder)
    if isinstance(recording, Sequence):
        masks = str(folder / "mask") if (folder / "mask").is_dir() else None
        for _ in Intake(recording, RegionTable(masks=masks), skip_bad_frames=False):
            pass
    elif hasattr(recording, "__iter__"):
        for _ in recording:
            pass
    del truth


def _read_first_poses(folder: Path) -> None:
    for name in ("first.json", "first.tum"):
        parsed_first_pose(str(folder / name))


def _read_mesh(folder: Path) -> None:
    (mesh,) = [path for path in folder.iterdir() if path.suffix[1:] in _MESHES]
    load_target(mesh)


def _read_run(folder: Path) -> None:
    run = read_run(folder, with_covariance=True)
    read_points(folder)
    read_features(folder)
    if (folder / "measurements.csv").is_file():
        read_records(folder)
        count_outcomes(folder)
    evaluate(run, None)
    load_run(folder)


def _tabulate(folder: Path) -> None:
    tabulate(open_store(folder), folder.parent / f"{folder.name}-tables")


def _compare(folder: Path) -> None:
    store = open_store(folder)
    found = compare(store, store)
    overall_table(found)
    case_table(found, only_sure=False)
    verdict_lines(found)


def _simulate(kind: RecordingKind) -> Callable[[Path], None]:
    def read(folder: Path) -> None:
        path = folder / "p.toml"
        simulate(read_pipeline(path), path, shipped_mesh("boxsat"), kind)

    return read


SUBJECTS = (
    Subject("sequence", _sequence, ("*.json", "*.toml", "depth/*.png"), _read_recording),
    Subject("first poses", _sequence, ("first.*",), _read_first_poses),
    Subject("npy", _of_format(".npy"), ("depth/*.npy",), _read_recording),
    Subject("tiff", _of_format(".tiff"), ("depth/*.tiff",), _read_recording),
    Subject("masks", _masked, ("mask/*.png",), _read_recording),
    Subject("truth", _simulated(RecordingKind.DEPTH), ("truth.csv", "*.json"), _read_recording),
    Subject("tsdf-fusion", _tsdf, ("*.txt", "*.png"), _read_recording),
    Subject("stereo tracks", _stereo, ("*.csv", "*.toml"), _read_recording),
    Subject("images", _images, ("*.png", "*.csv", "*.toml"), lambda f: list(open_images(f))),
    Subject("attitudes", _simulated(RecordingKind.ATTITUDES), ("*.csv", "*.toml"), _read_recording),
    *(Subject(f"mesh {kind}", _mesh(kind), ("*",), _read_mesh) for kind in _MESHES),
    Subject("mesh sidecar", _satellite, ("*.toml", "*.obj"), _read_mesh),
    *(
        Subject(f"pipeline {name}", _file("p.toml", _PIPELINE + text), ("*",), _simulate(kind))
        for (name, text), kind in zip(_SIMULATED.items(), _KINDS.values(), strict=True)
    ),
    Subject("grid", _file("g.toml", _GRID), ("*",), lambda f: read_grid(f / "g.toml").check()),
    *(
        Subject(f"run {kind}", _run(kind), ("*.csv", "*.npz", "*.toml", "*.tum"), _read_run)
        for kind in ("depth", "inertia_bank", "attitude_inertia", "image_motion")
    ),
    Subject("unfinished run", _unfinished, ("*.csv", "*.tum", "*.partial"), _read_run),
    Subject("batch tables", _batch, ("batch.json", "runs/*"), _tabulate),
    Subject("batch compare", _batch, ("batch.json", "runs/*"), _compare),
    Subject("playback", _viser, ("*",), lambda f: read_recording(f / "a.viser")),
    *RECORDING_SUBJECTS,
)
