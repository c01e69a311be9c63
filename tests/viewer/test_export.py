"""What is written to files: whole, never over something else, and complete in itself."""

import re
from pathlib import Path

import numpy as np
import pytest

from pcnav.core.errors import InputError
from pcnav.files.new_file import refuse_existing, write_whole
from pcnav.viewer.browser import on_background
from pcnav.viewer.export import (
    recorded_frames,
    recording,
    scene_html,
    shown_frame,
)
from pcnav.viewer.loaded_run import LoadedRun
from pcnav.viewer.playback import read_recording, recording_page
from pcnav.viewer.render_options import RenderOptions
from tests.viewer.conftest import FRAMES


def test_the_page_of_a_frame_holds_all_it_needs(loaded: LoadedRun) -> None:
    html = scene_html((loaded,), FRAMES - 1, RenderOptions()).decode()
    assert "__VISER_EMBED_DATA__" in html
    tags = re.findall(r"<(?:script|link|img)[^>]*(?:src|href)=[\"']?(https?:)", html)
    assert tags == []


def test_a_recording_grows_with_its_frames_and_plays_in_a_page(
    loaded: LoadedRun, tmp_path: Path
) -> None:
    told: list[tuple[int, int]] = []
    content = recording((loaded,), RenderOptions(), lambda done, total: told.append((done, total)))
    assert told[-1] == (FRAMES, FRAMES)
    assert len(content) > 10_000
    file = tmp_path / "a.viser"
    file.write_bytes(content)
    assert read_recording(file) == content
    page = recording_page(content, "number").decode()
    assert page.count("__VISER_EMBED_DATA__=") == 1


def test_long_runs_are_thinned_out(loaded: LoadedRun) -> None:
    assert recorded_frames(loaded) == tuple(range(FRAMES))


def test_a_frame_beyond_the_run_is_refused(loaded: LoadedRun) -> None:
    assert shown_frame(loaded, 3) == 3
    assert loaded.run.has_estimate[shown_frame(loaded, None)]
    with pytest.raises(InputError, match=rf"below {FRAMES}"):
        shown_frame(loaded, FRAMES)


def test_files_are_not_replaced_unasked(tmp_path: Path) -> None:
    file = tmp_path / "there.html"
    file.write_text("mine")
    with pytest.raises(InputError, match="--overwrite"):
        refuse_existing(file, overwrite=False)
    refuse_existing(file, overwrite=True)
    with pytest.raises(InputError):
        refuse_existing(tmp_path, overwrite=True)
    refuse_existing(tmp_path / "new.html", overwrite=False)


def test_files_are_written_whole(tmp_path: Path) -> None:
    write_whole(tmp_path / "a" / "b.png", b"content")
    assert (tmp_path / "a" / "b.png").read_bytes() == b"content"
    assert [file.name for file in (tmp_path / "a").iterdir()] == ["b.png"]
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="can be written"):
        write_whole(tmp_path / "file" / "c.png", b"content")


def test_transparent_pictures_get_the_background() -> None:
    image = np.zeros((1, 2, 4), dtype=np.uint8)
    image[0, 1] = (200, 100, 50, 255)
    assert on_background(image).tolist() == [[[20, 20, 20], [200, 100, 50]]]
