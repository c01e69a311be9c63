"""Result folders that are incomplete or damaged."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcnav.core.errors import InputError
from pcnav.runs.estimate import Estimate
from pcnav.runs.reader import read_records, read_run
from tests.runs.made_estimates import made, write


def test_half_an_estimate_is_refused(tmp_path: Path) -> None:
    whole = made()[3]
    for half in (
        replace(whole, T_cam_target=None),
        replace(whole, covariance=None),
        replace(whole, values={}),
    ):
        with pytest.raises(ValueError, match="together"):
            write(tmp_path / "run", [half])
    with pytest.raises(ValueError, match="shape"):
        write(tmp_path / "run", [replace(made()[3], covariance=np.eye(3))])


@pytest.mark.parametrize(
    ("name", "line", "column", "text", "told"),
    [
        ("states.csv", 0, 1, "r_X", "expected a column r_x_m"),
        ("states.csv", 4, 0, "", "line 5, time_s"),
        ("states.csv", 4, 2, "abc", "line 5, r_y_m: expected a number, got 'abc'"),
        ("states.csv", 4, 2, "", "line 5: expected all of the state or none"),
        ("states.csv", 4, 7, "5.0", "line 5: expected a unit quaternion"),
        ("states.csv", 0, 23, "sd_X", "expected a column sd_r_y_m"),
        ("states.csv", 4, -4, "1.5", "line 5, nis_dof: expected a whole number"),
        ("states.csv", 4, -1, "1,1", "line 5: expected 48 fields, got 49"),
        ("measurements.csv", 2, 2, "long", "line 3, length_m"),
        ("poses.tum", 0, 0, "99.0", "poses.tum: timestamp"),
        ("poses.tum", 0, 1, "x", "expected rows of numbers"),
        ("poses.tum", 0, 4, "nan", "poses.tum: line 1: expected finite numbers"),
    ],
)
def test_a_damaged_field_is_told_in_one_line(
    tmp_path: Path,
    frames: list[Estimate],
    name: str,
    line: int,
    column: int,
    text: str,
    told: str,
) -> None:
    frames = [replace(frame, records=frame.records[:1]) for frame in frames]
    frames = [
        replace(frame, records=tuple(replace(r, rectangle="a") for r in frame.records))
        for frame in frames
    ]
    write(tmp_path / "run", frames)
    path = tmp_path / "run" / name
    separator = " " if name.endswith(".tum") else ","
    lines = path.read_text().splitlines()
    fields = lines[line].split(separator)
    fields[column] = text
    lines[line] = separator.join(fields)
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError) as raised:
        read_run(tmp_path / "run")
        read_records(tmp_path / "run")
    assert told in str(raised.value)
    assert name in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("name", ["states.csv", "poses.tum", "covariances.npz", "measurements.csv"])
@pytest.mark.parametrize("content", [None, b"", b"\xff\xfe broken \x00"])
def test_a_missing_or_broken_file_is_told(
    tmp_path: Path, frames: list[Estimate], name: str, content: bytes | None
) -> None:
    write(tmp_path / "run", frames)
    path = tmp_path / "run" / name
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=name):
        read_run(tmp_path / "run", with_covariance=True)
        read_records(tmp_path / "run")


def test_an_unknown_compression_is_told(tmp_path: Path, frames: list[Estimate]) -> None:
    write(tmp_path / "run", frames)
    path = tmp_path / "run" / "covariances.npz"
    content = bytearray(path.read_bytes())
    entry = content.index(b"PK\x01\x02")
    content[entry + 10] = 99
    content[content.index(b"PK\x01\x02", entry + 1) + 10] = 99
    path.write_bytes(content)
    with pytest.raises(InputError, match="arrays P and time_s"):
        read_run(tmp_path / "run", with_covariance=True)


def test_covariances_of_another_run_are_refused(tmp_path: Path, frames: list[Estimate]) -> None:
    write(tmp_path / "run", frames)
    write(tmp_path / "other", frames[:4])
    (tmp_path / "other" / "covariances.npz").replace(tmp_path / "run" / "covariances.npz")
    assert read_run(tmp_path / "run").trajectory.covariance is None
    with pytest.raises(InputError, match=r"covariances.npz: P: expected \(5, 20, 20\)"):
        read_run(tmp_path / "run", with_covariance=True)
