"""Frames that are read while the one before them is worked on."""

import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcnav.core.errors import InputError
from pcnav.recordings.bop import read_bop
from pcnav.recordings.depth_image import read_depth_image
from pcnav.recordings.read_ahead import read_ahead
from pcnav.recordings.sequence import Frame, Sequence

MakeScene = Callable[..., Path]
WAIT_S = 20.0


def test_the_next_frame_and_no_more_is_read_meanwhile(
    tmp_path: Path, make_scene: MakeScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    sequence = read_bop(make_scene(tmp_path / "s", tuple(range(4))))
    plain, begun = Sequence.frame, [threading.Event() for _ in range(4)]

    def watched(self: Sequence, index: int) -> Frame:
        begun[index].set()
        return plain(self, index)

    monkeypatch.setattr(Sequence, "frame", watched)
    with read_ahead(sequence) as read:
        for index in range(4):
            frame = read(index)
            assert frame.index == index
            np.testing.assert_array_equal(frame.depth_m, plain(sequence, index).depth_m)
            # Nobody has asked for it yet.
            assert index == 3 or begun[index + 1].wait(WAIT_S)
            assert not any(event.is_set() for event in begun[index + 2 :])


def test_a_fault_is_raised_where_its_frame_is_asked_for(
    tmp_path: Path, make_scene: MakeScene
) -> None:
    folder = make_scene(tmp_path / "s", tuple(range(3)))
    sequence = read_bop(folder)
    (folder / "depth" / "000001.png").write_bytes(b"")
    with read_ahead(sequence) as read:
        assert read(0).index == 0
        with pytest.raises(InputError, match=r"000001\.png"):
            read(1)
        assert read(2).index == 2
        # In any order, and twice.
        assert [read(k).index for k in (0, 2, 2)] == [0, 2, 2]


def test_what_may_keep_files_open_is_read_in_its_own_thread(
    tmp_path: Path, make_scene: MakeScene
) -> None:
    readers: set[int] = set()

    def reading(path: Path) -> np.ndarray:
        readers.add(threading.get_ident())
        return np.asarray(read_depth_image(path))

    sequence = replace(read_bop(make_scene(tmp_path / "s")), read_image=reading)
    with read_ahead(sequence) as read:
        assert [read(k).index for k in range(len(sequence))] == [*range(len(sequence))]
    assert readers == {threading.get_ident()}
