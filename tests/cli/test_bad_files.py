"""Meshes and pipeline files that cannot be used, through the real entry point."""

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.answers import PIPELINE, boxsat, content, expect_refusal, written
from tests.commands import Pcnav

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
