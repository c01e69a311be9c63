"""What is written to files: whole, never over something else, and complete in itself."""

import re
from pathlib import Path

import numpy as np
import pytest

from pcnav.core.errors import InputError
from pcnav.files.new_file import refuse_existing, write_whole
from pcnav.viewer.annotate import annotated, legend_words
from pcnav.viewer.assessment import Opening
from pcnav.viewer.browser import on_background
from pcnav.viewer.export import (
    recorded_frames,
    recording,
    scene_html,
    shown_frame,
)
from pcnav.viewer.frames import ColourBy
from pcnav.viewer.layers import shot_of
from pcnav.viewer.loaded_run import LoadedRun
from pcnav.viewer.palette import RESIDUAL_STOPS, STATUS
from pcnav.viewer.playback import read_recording, recording_page
from pcnav.viewer.render_options import RenderOptions
from tests.viewer.conftest import FRAMES


def test_the_page_of_a_frame_holds_all_it_needs(loaded: LoadedRun) -> None:
    html = scene_html((loaded,), FRAMES - 1, RenderOptions()).decode()
    assert "__VISER_EMBED_DATA__" in html
    tags = re.findall(r"<(?:script|link|img)[^>]*(?:src|href)=[\"']?(https?:)", html)
    assert tags == []
    # What a picture of points alone would not say.
    assert "locked" in html and "inliers" in html and "returns drawn" in html


def test_a_picture_has_its_status_above_and_its_legend_below(loaded: LoadedRun) -> None:
    picture = np.full((50, 900, 3), 20, dtype=np.uint8)
    last, options = FRAMES - 1, RenderOptions(colour_by=ColourBy.RESIDUAL)
    shot = shot_of(loaded, last)
    made = annotated(picture, (loaded,), last, options, shot)
    assert made.shape[0] > 50 + 2 * 24 and made.shape[1] == 900
    above, below = made[:24], made[74:]
    assert (made[24:74] == 20).all()
    # Its status in the status' colour, and the ends of the scale of residuals.
    assert (above == STATUS["locked"]).all(axis=-1).any()
    for stop in (RESIDUAL_STOPS[0], RESIDUAL_STOPS[-1]):
        assert (below == stop).all(axis=-1).any()
    words = " ".join(text for row in legend_words(loaded, last, options, shot) for _, text in row)
    assert "range measured minus model, mm" in words and "returns drawn" in words


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
    assert loaded.run.has_estimate[shown_frame(loaded, Opening.LAST)]
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
