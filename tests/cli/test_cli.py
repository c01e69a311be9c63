"""The command line as users meet it: every test goes through the real entry point."""

import html
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from pcnav import cli
from pcnav.config.shipped import shipped_mesh, shipped_mesh_names
from pcnav.estimators.depth.tracker import Tracker
from pcnav.runs.reader import read_run
from studies import STUDIES

COMMANDS = ("demo", "simulate", "run", "target", "study")
FRAMES = 6
COMMAND = [sys.executable, "-c", "from pcnav.cli import main; main()"]
PIPELINE = """
seed = 7
target_mesh = "boxsat"
[scenario]
frames = 6
frame_rate_hz = 4.0
[orbit]
r_hill_m = [18.0, 0.0, 0.0]
[body]
attitude_rotvec_deg = [25.0, 40.0, -30.0]
omega_body_deg_s = [4.0, -2.8, 5.0]
inertia_ratios = [0.577, 0.735, -0.02, 0.06, -0.045]
[camera]
width_px = 128
height_px = 128
horizontal_fov_deg = 36.0
[noise]
range_sigma_m = 0.01
"""


@dataclass(frozen=True)
class Answer:
    """What a command said."""

    code: int
    out: str
    err: str

    @property
    def error_lines(self) -> list[str]:
        """Lines on stderr but those that tell how a run goes."""
        return [line for line in self.err.splitlines() if not line.startswith("INFO: frame ")]


Pcnav = Callable[..., Answer]


@pytest.fixture
def pcnav(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Iterator[Pcnav]:
    """Call the entry point with arguments, in this process."""
    before = signal.getsignal(signal.SIGTERM)

    def call(*arguments: str | Path) -> Answer:
        capsys.readouterr()
        monkeypatch.setattr(sys, "argv", ["pcnav", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        out, err = capsys.readouterr()
        return Answer(int(ended.value.code or 0), out, err)

    yield call
    signal.signal(signal.SIGTERM, before)


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six frames of the shipped satellite and a result made of them: sequence/ and result/."""
    folder = tmp_path_factory.mktemp("recorded")
    (folder / "six.toml").write_text(PIPELINE)
    sequence = folder / "sequence"
    for arguments in (
        ("simulate", folder / "six.toml", "-o", sequence),
        ("run", sequence, "-o", folder / "result"),
    ):
        with pytest.MonkeyPatch.context() as patch, pytest.raises(SystemExit) as ended:
            patch.setattr(sys, "argv", ["pcnav", *map(str, arguments)])
            cli.main()
        assert not ended.value.code
    # A copy of the sequence may lie anywhere.
    words = (sequence / "sequence.toml").read_text()
    mesh = f'target_mesh = "{satellite("boxsat").as_posix()}"'
    (sequence / "sequence.toml").write_text(re.sub('target_mesh = ".*"', mesh, words))
    return folder


def satellite(name: str) -> Path:
    """The mesh of a shipped satellite."""
    mesh = shipped_mesh(name)
    assert mesh is not None
    return mesh


@pytest.fixture
def sequence(recorded: Path, tmp_path: Path) -> Path:
    """A copy of the sequence to break."""
    copy = tmp_path / "sequence"
    shutil.copytree(recorded / "sequence", copy)
    return copy


def content(folder: Path) -> dict[str, bytes]:
    """Every file of a folder by its path within."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def expect_refusal(answer: Answer, *words: str | Path) -> None:
    """One line of error, every word in it, and exit code 2."""
    assert answer.code == 2, answer
    # What led to it may have been warned of.
    lines = [line for line in answer.error_lines if not line.startswith("WARNING: ")]
    assert len(lines) == 1, answer.err
    (line,) = lines
    assert line.startswith("error: ")
    for word in words:
        assert str(word) in line
    assert answer.out == ""


# Help and wrong command lines.


@pytest.mark.parametrize("flag", ["-h", "--help"])
@pytest.mark.parametrize("command", COMMANDS)
def test_help_shows_an_example_of_the_command(pcnav: Pcnav, command: str, flag: str) -> None:
    answer = pcnav(command, flag)
    assert answer.code == 0
    assert answer.err == ""
    assert f"Example: pcnav {command}" in answer.out


def test_help_of_study_names_every_study(pcnav: Pcnav) -> None:
    answer = pcnav("study", "--help")
    assert {"yu2019", "tracking"} <= set(STUDIES)
    for name in STUDIES:
        assert re.search(rf"\b{name}\b", answer.out.partition("Arguments")[2]), name


def test_without_a_command_the_help_is_shown(pcnav: Pcnav) -> None:
    answer = pcnav()
    assert answer.code == 0
    for command in COMMANDS:
        assert re.search(rf"^│ {command} ", answer.out, re.MULTILINE)
    assert pcnav("--version").out.startswith("pcnav ")


def examples() -> dict[str, list[str]]:
    """The examples in the help texts by command."""
    found = {}
    for command in COMMANDS:
        match = re.search(r"Example: `(pcnav .*)`", getattr(cli, command).__doc__ or "")
        assert match is not None, command
        found[command] = shlex.split(match[1])
    return found


@pytest.mark.usefixtures("quick_drawings")
def test_examples_use_what_is_shipped_and_work_in_order(
    pcnav: Pcnav, recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shown = examples()
    assert set(shown) == set(COMMANDS)
    target = pcnav(*shown["target"][1:])
    assert target.code == 0, target.err
    assert "bus_x_plus" in target.out
    assert "catalogue: boxsat.toml" in target.out
    # What `simulate` takes minutes to write stands here already, shorter.
    written = Path(shown["simulate"][shown["simulate"].index("-o") + 1])
    assert shown["run"][2] == str(written)
    shutil.copytree(recorded / "sequence", written)
    expect_refusal(pcnav(*shown["simulate"][1:]), written, "folder", "overwrite")
    answer = pcnav(*shown["run"][1:])
    assert answer.code == 0
    # Not a terminal: no bar and no blank lines, on either stream.
    assert answer.error_lines == []
    assert "\x1b" not in answer.out + answer.err
    assert "Errors against the truth" in answer.out
    assert re.search(r"known from data: \d+\s+of\s+20\s+states", answer.out)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("fly",), ("fly", "pcnav --help")),
        (("run",), ("sequence", "pcnav run --help")),
        (("run", "here"), ("--out", "pcnav run --help")),
        (("simulate", "demo", "-o", "x", "--fast"), ("--fast", "pcnav simulate --help")),
        (("study", "yu2019", "-o", "x", "--runs", "many"), ("--runs", "pcnav study --help")),
        (("study", "nobody1900", "-o", "x"), ("nobody1900", "study", "expected")),
        (("study", "yu2019", "-o", "x", "--jobs", "0"), ("--jobs", "expected at least 1")),
        (("study", "yu2019", "-o", "x", "--scheduler", "host"), ("host", "tcp://host:8786")),
        (("target", "boxsat", "extra"), ("extra", "pcnav target --help")),
        (("--nothing",), ("--nothing", "pcnav --help")),
    ],
)
def test_a_wrong_command_line_is_one_line(
    pcnav: Pcnav,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    words: tuple[str, ...],
) -> None:
    monkeypatch.chdir(tmp_path)
    expect_refusal(pcnav(*arguments), *words)
    assert not list(tmp_path.iterdir())


# Bad sequences.


def png(number: int) -> str:
    return f"depth/{number:06d}.png"


def truncate(sequence: Path) -> None:
    file = sequence / png(4)
    file.write_bytes(file.read_bytes()[:-40])


def store_eight_bits(sequence: Path) -> None:
    Image.fromarray(np.zeros((128, 128), dtype=np.uint8)).save(sequence / png(0))


def resize_one(sequence: Path) -> None:
    Image.fromarray(np.zeros((64, 128), dtype=np.uint16)).save(sequence / png(3))


def camera(number: int, field: str, value: object) -> Callable[[Path], None]:
    """Sets a field of scene_camera.json."""

    def change(sequence: Path) -> None:
        file = sequence / "scene_camera.json"
        scene: dict[str, dict[str, Any]] = json.loads(file.read_text())
        scene[str(number)][field] = value
        file.write_text(json.dumps(scene))

    return change


def text(name: str, old: str, new: str) -> Callable[[Path], None]:
    """Replaces text in a file of the sequence; an empty `old` stands for the whole text."""

    def change(sequence: Path) -> None:
        before = (sequence / name).read_text()
        assert old in before
        (sequence / name).write_text(before.replace(old, new, 1) if old else new)

    return change


def folder_instead(name: str) -> Callable[[Path], None]:
    """Puts a folder where a file belongs."""

    def change(sequence: Path) -> None:
        (sequence / name).unlink()
        (sequence / name).mkdir()

    return change


def file_instead(sequence: Path) -> None:
    shutil.rmtree(sequence)
    sequence.write_text("")


def not_text(name: str) -> Callable[[Path], None]:
    """Puts a byte into a file that UTF-8 does not have."""

    def change(sequence: Path) -> None:
        (sequence / name).write_bytes((sequence / name).read_bytes() + b"# caf\xe9\n")

    return change


REFLECTION = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0]
SHEAR = [1.0, 0.2, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
SCENE = "scene_camera.json"
BROKEN: dict[str, tuple[Callable[[Path], object], tuple[str, ...]]] = {
    "missing image": (lambda s: (s / png(2)).unlink(), (png(2), "file", "frame 2")),
    "image cut short": (truncate, (png(4), "file", "whole PNG")),
    "8-bit image": (store_eight_bits, (png(0), "pixels", "16-bit")),
    "image size changes": (resize_one, (png(3), "image size", "128 x 128", "128 x 64")),
    "folder for an image": (
        folder_instead(png(1)),
        (png(1), "file", "PNG"),
    ),
    "no images": (lambda s: shutil.rmtree(s / "depth"), ("depth", "folder")),
    "short matrix": (camera(1, "cam_K", [1.0] * 8), (SCENE, "1.cam_K", "9 items")),
    "not a rotation": (camera(2, "cam_R_w2c", SHEAR), (SCENE, "2.cam_R_w2c", "rotation matrix")),
    "reflection": (camera(2, "cam_R_w2c", REFLECTION), (SCENE, "2.cam_R_w2c", "determinant 1")),
    "nan time": (camera(1, "timestamp_s", float("nan")), (SCENE, "1.timestamp_s", "finite")),
    "nan translation": (
        camera(1, "cam_t_w2c", [0.0, float("nan"), 0.0]),
        (SCENE, "1.cam_t_w2c", "finite"),
    ),
    "no depth scale": (camera(0, "depth_scale", 0), (SCENE, "0.depth_scale", "greater than 0")),
    "no frames": (text(SCENE, "", "{}"), (SCENE, "frames", "at least one frame")),
    "comment in JSON": (text(SCENE, "{", "// mine\n{"), (SCENE, "file", "JSON")),
    "folder for a file": (
        folder_instead(SCENE),
        (SCENE, "file", "readable"),
    ),
    "unknown key": (
        text("sequence.toml", "range_sigma_m", "noise_m = 1.0\nrange_sigma_m"),
        ("sequence.toml", "sensor.noise_m", "unknown key"),
    ),
    "not UTF-8": (not_text("sequence.toml"), ("sequence.toml", "file", "utf-8")),
    "mesh moved": (
        text("sequence.toml", "boxsat.obj", "gone.obj"),
        ("sequence.toml", "sequence.target_mesh", "gone.obj"),
    ),
    "no mesh": (
        lambda s: (s / "sequence.toml").write_text("[sensor]\nrange_sigma_m = 0.01\n"),
        ("sequence", "target_mesh", "--target"),
    ),
    "truth damaged": (
        text("truth.csv", "\n0.25,", "\nx,"),
        ("truth.csv", "line 3", "expected a number"),
    ),
    "no scene": (shutil.rmtree, ("sequence", "folder", SCENE)),
    "file for the folder": (
        file_instead,
        ("sequence", "folder", SCENE),
    ),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_a_bad_sequence_is_one_line_and_leaves_nothing(
    pcnav: Pcnav, sequence: Path, tmp_path: Path, fault: str
) -> None:
    damage, words = BROKEN[fault]
    damage(sequence)
    expect_refusal(pcnav("run", sequence, "-o", tmp_path / "new" / "result"), *words)
    assert {path.name for path in tmp_path.iterdir()} <= {"sequence"}


# Bad meshes.


def boxsat(scale: float, path: Path) -> Path:
    mesh = trimesh.load_mesh(satellite("boxsat"))
    mesh.apply_scale(scale)
    mesh.export(path)
    return path


def written(path: Path, words: bytes) -> Path:
    path.write_bytes(words)
    return path


BAD_MESHES: dict[str, tuple[Callable[[Path], Path], tuple[str, ...]]] = {
    "millimetres": (lambda f: boxsat(1000.0, f / "m.stl"), ("m.stl", "units", "metres")),
    "kilometres": (lambda f: boxsat(0.001, f / "m.stl"), ("m.stl", "units", "metres")),
    "no mesh at all": (lambda f: written(f / "m.stl", b"hello"), ("m.stl", "expected")),
    "empty": (lambda f: written(f / "m.obj", b""), ("m.obj", "expected")),
    "unknown kind": (lambda f: written(f / "m.doc", b"solid"), ("m.doc", "file", "STL")),
    "nan": (
        lambda f: written(f / "m.obj", b"v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n"),
        ("m.obj", "vertices", "finite"),
    ),
    "no such file": (lambda f: f / "m.stl", ("m.stl", "mesh", "expected a mesh file or one of")),
    "folder": (lambda f: f, ("mesh", "expected a mesh file or one of")),
}


@pytest.mark.parametrize("fault", BAD_MESHES)
def test_a_bad_mesh_is_one_line_and_leaves_nothing(
    pcnav: Pcnav, sequence: Path, tmp_path: Path, fault: str
) -> None:
    make, words = BAD_MESHES[fault]
    mesh = make(tmp_path)
    before = content(tmp_path)
    result = tmp_path / "result"
    expect_refusal(pcnav("run", sequence, "--target", mesh, "-o", result), *words)
    if "units" not in words:
        expect_refusal(pcnav("target", mesh, "-o", tmp_path / "catalogue.toml"), *words)
    assert content(tmp_path) == before
    assert not result.exists()


# Bad pipeline files.


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("seed", "sead", ("sead", "unknown key")),
        ("frames = 6", "frame = 6", ("scenario.frame", "unknown key")),
        ("frames = 6", "frames = 0", ("scenario.frames", "greater than 0", "got 0")),
        ("range_sigma_m = 0.01", "range_sigma_m = nan", ("noise.range_sigma_m", "finite")),
        ("range_sigma_m = 0.01", "range_sigma_m = -0.01", ("noise.range_sigma_m", "-0.01")),
        ("18.0, 0.0, 0.0", "18.0, 0.0, inf", ("orbit.r_hill_m", "finite")),
        ("18.0, 0.0, 0.0", "18.0, 0.0", ("orbit.r_hill_m",)),
        ("[noise]", "[filter]\niterations = 0\n[noise]", ("filter.iterations", "equal to 1")),
        ('"boxsat"', '"nosat"', ("target_mesh", "nosat", "boxsat")),
        ("[noise]", "[noise", ("file", "TOML")),
    ],
)
def test_a_bad_pipeline_file_is_one_line(
    pcnav: Pcnav, tmp_path: Path, sequence: Path, old: str, new: str, words: tuple[str, ...]
) -> None:
    assert old in PIPELINE
    file = tmp_path / "bad.toml"
    file.write_text(PIPELINE.replace(old, new))
    expect_refusal(pcnav("simulate", file, "-o", tmp_path / "out"), file, *words)
    expect_refusal(pcnav("run", sequence, "--pipeline", file, "-o", tmp_path / "out"), file, *words)
    assert not (tmp_path / "out").exists()


def test_a_pipeline_that_is_no_text_file_is_one_line(pcnav: Pcnav, tmp_path: Path) -> None:
    file = tmp_path / "bad.toml"
    out = tmp_path / "out"
    file.write_bytes(PIPELINE.encode() + b"# caf\xe9\n")
    expect_refusal(pcnav("simulate", file, "-o", out), file, "file", "utf-8")
    expect_refusal(pcnav("simulate", tmp_path, "-o", out), tmp_path, "pipeline", "TOML file")
    expect_refusal(pcnav("simulate", "no-such", "-o", out), "no-such", "pipeline", "demo")
    file.write_text(PIPELINE.replace('target_mesh = "boxsat"', ""))
    expect_refusal(pcnav("simulate", file, "-o", out), file, "target_mesh", "mesh")
    assert not out.exists()


# A first pose.


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--initial-pose", "1 2 3"), ("--initial-pose", "tx ty tz qx qy qz qw")),
        (("--initial-pose", "nowhere.tum"), ("nowhere.tum", "tx ty tz qx qy qz qw")),
        (("--initial-pose-sd", "0.1", "5"), ("--initial-pose-sd", "expected --initial-pose")),
        (
            ("--initial-pose", "-0.1 0 18 0 0 0 1", "--initial-pose-sd", "0", "5"),
            ("position_sd_m", "greater than 0"),
        ),
    ],
)
def test_a_wrong_first_pose_is_one_line(
    pcnav: Pcnav, sequence: Path, tmp_path: Path, options: tuple[str, ...], words: tuple[str, ...]
) -> None:
    answer = pcnav("run", sequence, "-o", tmp_path / "result", *options)
    expect_refusal(answer, *words)
    assert not (tmp_path / "result").exists()


# What exists already.


def test_an_existing_result_stays_unless_told_to_overwrite(
    pcnav: Pcnav, recorded: Path, sequence: Path, tmp_path: Path
) -> None:
    result = tmp_path / "result"
    shutil.copytree(recorded / "result", result)
    before = content(result)
    expect_refusal(pcnav("run", sequence, "-o", result), result, "folder", "overwrite")
    assert content(result) == before
    truncate(sequence)
    expect_refusal(pcnav("run", sequence, "-o", result, "--overwrite"), png(4), "whole PNG")
    assert content(result) == before
    assert {path.name for path in tmp_path.iterdir()} == {"sequence", "result"}


@pytest.mark.usefixtures("quick_drawings")
def test_overwriting_replaces_an_earlier_result(
    pcnav: Pcnav, recorded: Path, sequence: Path, tmp_path: Path
) -> None:
    result = tmp_path / "result"
    shutil.copytree(recorded / "result", result)
    (result / "metrics.json").unlink()
    saved = recorded / "result" / "pipeline.toml"
    answer = pcnav("run", sequence, "--pipeline", saved, "-o", result, "--overwrite")
    assert answer.code == 0, answer.err
    assert (result / "metrics.json").is_file()
    # The saved settings repeat the run.
    states = (recorded / "result" / "states.csv").read_bytes()
    assert (result / "states.csv").read_bytes() == states
    assert {path.name for path in tmp_path.iterdir()} == {"sequence", "result"}


def test_overwriting_deletes_neither_the_input_nor_other_folders(
    pcnav: Pcnav, sequence: Path, tmp_path: Path, recorded: Path
) -> None:
    other = tmp_path / "photographs"
    other.mkdir()
    (other / "mine.jpg").write_bytes(b"dear")
    outer = tmp_path / "outer"
    shutil.copytree(recorded / "result", outer)
    shutil.move(sequence, outer / "sequence")
    before = content(tmp_path)
    for out, words in ((other, "states.csv"), (outer, "does not hold"), (outer / "sequence", "")):
        answer = pcnav("run", outer / "sequence", "-o", out, "--overwrite")
        expect_refusal(answer, out, "folder", words)
    expect_refusal(
        pcnav("simulate", recorded / "six.toml", "-o", other, "--overwrite"),
        other,
        "scene_camera.json",
    )
    assert content(tmp_path) == before


def test_a_file_is_never_taken_for_a_folder(pcnav: Pcnav, sequence: Path, tmp_path: Path) -> None:
    file = written(tmp_path / "notes", b"dear")
    for arguments in (("run", sequence), ("simulate", "demo"), ("study", "yu2019")):
        for out in (file, file / "below"):
            answer = pcnav(*arguments, "-o", out, "--overwrite")
            assert answer.code == 2
            assert len(answer.error_lines) == 1, answer.err
            assert "notes" in answer.err
    assert file.read_bytes() == b"dear"


def test_the_demo_replaces_nothing_by_itself(pcnav: Pcnav, recorded: Path, tmp_path: Path) -> None:
    for name in ("sequence", "result"):
        out = tmp_path / name
        shutil.copytree(recorded / name, out / name)
        before = content(out)
        expect_refusal(pcnav("demo", "-o", out), out / name, "folder", "overwrite")
        assert content(out) == before


def test_a_catalogue_file_is_written_once_and_its_folder_made(pcnav: Pcnav, tmp_path: Path) -> None:
    out = tmp_path / "new" / "catalogue.toml"
    assert pcnav("target", "cubesat6u", "-o", out).code == 0
    before = out.read_bytes()
    assert b"rectangles" in before
    expect_refusal(pcnav("target", "boxsat", "-o", out), out, "file", "--overwrite")
    assert out.read_bytes() == before
    assert pcnav("target", "boxsat", "-o", out, "--overwrite").code == 0
    assert out.read_bytes() != before
    expect_refusal(pcnav("target", "boxsat", "-o", tmp_path, "--overwrite"), tmp_path, "file")


@pytest.mark.parametrize("name", shipped_mesh_names())
def test_every_shipped_satellite_can_be_described(pcnav: Pcnav, name: str) -> None:
    answer = pcnav("target", name)
    assert answer.code == 0
    assert answer.err == ""
    for heading in ("symmetry group", "mass centre", "rectangles", "length m"):
        assert heading in answer.out
    assert "object at 0x" not in answer.out


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="no folder that nobody can write to")
def test_a_place_that_cannot_be_written_is_one_line(pcnav: Pcnav, sequence: Path) -> None:
    for arguments in (("run", sequence), ("simulate", "demo"), ("target", "boxsat")):
        for out in ("/proc/result", "/proc/new/result"):
            expect_refusal(pcnav(*arguments, "-o", out), "/proc/", "expected")


# Interruption.


def test_an_interrupted_run_leaves_nothing(
    pcnav: Pcnav, sequence: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    step = Tracker.step

    def interrupted_at_frame_4(self: Tracker, frame: Any) -> Any:
        if frame.index == 4:
            raise KeyboardInterrupt
        return step(self, frame)

    monkeypatch.setattr(Tracker, "step", interrupted_at_frame_4)
    answer = pcnav("run", sequence, "-o", tmp_path / "new" / "result")
    assert answer.code == 130
    assert len(answer.error_lines) == 1
    assert answer.error_lines[0].startswith("interrupted")
    assert {path.name for path in tmp_path.iterdir()} == {"sequence"}


@pytest.mark.skipif(os.name == "nt", reason="Windows ends a process without asking it")
def test_a_command_told_to_terminate_leaves_nothing(tmp_path: Path) -> None:
    endless = tmp_path / "endless.toml"
    endless.write_text(PIPELINE.replace("frames = 6", "frames = 20000"))
    arguments = ["simulate", str(endless), "-o", str(tmp_path / "sequence")]
    with subprocess.Popen([*COMMAND, *arguments], stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 60.0
        while not list(tmp_path.glob(".sequence-*/depth/000003.png")):
            assert time.monotonic() < deadline and process.poll() is None
            time.sleep(0.02)
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err.splitlines() == ["interrupted: nothing is left half-written"]
    assert list(tmp_path.iterdir()) == [endless]


# Terminals.


@pytest.mark.skipif(os.name == "nt", reason="needs a pseudo-terminal")
def test_a_terminal_shows_a_bar_and_the_log_above_it(sequence: Path, tmp_path: Path) -> None:
    ours, theirs = os.openpty()
    arguments = ["run", str(sequence), "-o", str(tmp_path / "result")]
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "100"}
    with subprocess.Popen(
        [*COMMAND, *arguments], stdout=subprocess.PIPE, stderr=theirs, env=environment
    ) as process:
        os.close(theirs)
        shown = b""
        # Linux answers the end of a pseudo-terminal with an error.
        while chunk := read_or_end(ours):
            shown += chunk
        out, _ = process.communicate(timeout=60)
    os.close(ours)
    assert process.returncode == 0, shown
    assert f"{FRAMES}/{FRAMES}".encode() in shown
    # The line of the bar is erased before the log line is written, and the bar is gone at the end.
    assert re.search(rb"\x1b\[2KINFO: frame \d+: acquiring -> locked \(.*\)\s*\r\n", shown), shown
    assert shown.rstrip().endswith(b"\x1b[2K")
    assert b"\x1b[2K" not in out


def read_or_end(terminal: int) -> bytes:
    try:
        return os.read(terminal, 4096)
    except OSError:
        return b""


# Nothing to see, or too little.


def blank(sequence: Path, numbers: range) -> None:
    for number in numbers:
        Image.fromarray(np.zeros((128, 128), dtype=np.uint16)).save(sequence / png(number))


def expect_nothing_found(answer: Answer, report: Path, *words: str) -> None:
    """A warning with every word in it, its own exit code, and the same words in the report."""
    assert answer.code == 3, answer
    (line,) = answer.error_lines
    assert line.startswith("WARNING: no target found in ")
    page = html.unescape(report.read_text(encoding="utf-8"))
    for word in words:
        assert word in line
        assert word in page


def test_a_sequence_without_returns_says_so_and_ends_with_its_own_code(
    pcnav: Pcnav, sequence: Path, tmp_path: Path
) -> None:
    blank(sequence, range(FRAMES))
    answer = pcnav("run", sequence, "-o", tmp_path / "result")
    report = tmp_path / "result" / "report.html"
    expect_nothing_found(answer, report, "in 6 frames", "no frame has any return")
    assert read_run(tmp_path / "result").status == ("acquiring",) * FRAMES
    assert "acquiring 100.0%" in answer.out
    assert "acquiring 100.0%" in (tmp_path / "result" / "report.html").read_text()
    assert (tmp_path / "result" / "poses.tum").read_text() == ""


@pytest.mark.usefixtures("quick_drawings")
def test_empty_first_frames_delay_the_lock(pcnav: Pcnav, sequence: Path, tmp_path: Path) -> None:
    blank(sequence, range(2))
    answer = pcnav("run", sequence, "-o", tmp_path / "result")
    assert answer.code == 0, answer.err
    track = read_run(tmp_path / "result")
    assert track.status[:2] == ("acquiring", "acquiring")
    assert track.status[-1] == "locked"


@pytest.mark.usefixtures("quick_drawings")
def test_an_empty_frame_in_between_is_coasted_over(
    pcnav: Pcnav, sequence: Path, tmp_path: Path
) -> None:
    blank(sequence, range(4, 5))
    assert pcnav("run", sequence, "-o", tmp_path / "result").code == 0
    track = read_run(tmp_path / "result")
    assert track.status[3:] == ("locked", "coasting", "locked")
    assert track.notes["n_rectangles"][4] == 0


@pytest.mark.usefixtures("quick_drawings")
def test_one_frame_is_a_sequence(pcnav: Pcnav, tmp_path: Path) -> None:
    file = tmp_path / "one.toml"
    file.write_text(PIPELINE.replace("frames = 6", "frames = 1"))
    assert pcnav("simulate", file, "-o", tmp_path / "new" / "sequence").code == 0
    answer = pcnav("run", tmp_path / "new" / "sequence", "-o", tmp_path / "result")
    assert read_run(tmp_path / "result").status == ("acquiring",)
    report = tmp_path / "result" / "report.html"
    expect_nothing_found(answer, report, "in 1 frame:", "a motion takes 3")


@pytest.mark.usefixtures("quick_drawings")
def test_a_target_out_of_view_is_told(pcnav: Pcnav, tmp_path: Path) -> None:
    file = tmp_path / "behind.toml"
    file.write_text(PIPELINE.replace("18.0, 0.0, 0.0", "-18.0, 0.0, 0.0"))
    answer = pcnav("simulate", file, "-o", tmp_path / "sequence")
    assert answer.code == 0
    assert re.fullmatch(r"WARNING: .*outside the image in 6 of 6 frames\n", answer.err)
    answer = pcnav("run", tmp_path / "sequence", "-o", tmp_path / "result")
    expect_nothing_found(answer, tmp_path / "result" / "report.html", "no frame has any return")
    assert set(read_run(tmp_path / "result").status) == {"acquiring"}
