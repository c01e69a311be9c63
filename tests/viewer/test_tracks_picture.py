"""Tracks are drawn where they were seen, in the colour of what became of them."""

import numpy as np
import pytest

from pcnav.recordings.tracks import TrackFrame
from pcnav.runs.feature_outcomes import GATED, TRACKED, FeatureOutcomes
from pcnav.runs.records import ACCEPTED
from pcnav.runs.run import FeatureTable
from pcnav.viewer.features_told import feature_card, features_html
from pcnav.viewer.palette import ACCEPTED_COLOUR, MASS_CENTRE, REJECTED_COLOUR, SENSOR
from pcnav.viewer.tracks_picture import TrackedImages


def centre_of(picture: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    rows, columns = np.nonzero((picture == colour).all(axis=-1))
    assert len(rows) > 20
    return np.array([columns.mean(), rows.mean()])


def test_tracks_stand_where_they_were_seen_and_say_what_became_of_them() -> None:
    # Half the size of the picture, and as wide for its height.
    pixels = {1: (100.0, 50.0), 2: (300.0, 50.0), 3: (100.0, 180.0)}
    frame = TrackFrame(2.0, np.eye(3), np.array(list(pixels)), np.array(list(pixels.values())))
    # Not so few of the pixels that they are enlarged.
    seen = TrackedImages((400, 228), (400.0, 400.0), (200.0, 114.0), (frame,))
    p_body = np.array([[np.nan] * 3, [0.5, 0.25, 0.0], [0.0, 0.0, -40.0]])
    features = FeatureTable(
        np.array([1, 2, 9]), p_body, np.ones((3, 3)), np.array([9, 9, 9]), np.array([1, 8, 0])
    )
    T_cam_body = np.eye(4)
    T_cam_body[2, 3] = 2.0
    picture = seen.picture(2.0, features, T_cam_body)
    for colour, number in ((ACCEPTED_COLOUR, 1), (REJECTED_COLOUR, 2), (SENSOR, 3)):
        np.testing.assert_allclose(
            centre_of(picture, colour), 2.0 * np.array(pixels[number]), atol=1
        )
    # The second point is 100 pixels right of and 50 below the optical axis; the last lies behind.
    np.testing.assert_allclose(centre_of(picture, MASS_CENTRE), (600.0, 328.0), atol=1)
    assert (seen.picture(3.0, None, None) == seen.picture(4.0, None, None)).all()


def test_tracks_of_a_far_target_are_enlarged_and_stay_where_they_are() -> None:
    """Six pixels of a thousand: by a power of two, about their middle, and that is said."""
    pixels = np.array([[500.0, 700.0], [506.0, 703.0]])
    frame = TrackFrame(0.0, np.eye(3), np.array([4, 7]), pixels)
    features = FeatureTable(
        np.array([4, 7]),
        np.full((2, 3), np.nan),
        np.ones((2, 3)),
        np.array([9, 9]),
        np.zeros(2, dtype=int),
    )
    seen = TrackedImages((1024, 1024), (1000.0, 1000.0), (512.0, 512.0), (frame,))
    picture = seen.picture(0.0, features, None)
    height, width = picture.shape[:2]
    rows, columns = np.nonzero((picture == ACCEPTED_COLOUR).all(axis=-1))
    left = np.array([columns[columns < width / 2].mean(), rows[columns < width / 2].mean()])
    right = np.array([columns[columns > width / 2].mean(), rows[columns > width / 2].mean()])
    scale = (right - left) / (pixels[1] - pixels[0])
    np.testing.assert_allclose(scale[0], scale[1], rtol=0.05)
    assert np.log2(scale[0] * 1024 / height) == pytest.approx(
        round(np.log2(scale[0] * 1024 / height)), abs=0.1
    )
    np.testing.assert_allclose(0.5 * (left + right), [width / 2, height / 2], atol=2.0)
    # The size of the part, as text in the corner.
    assert (picture[:40, :300] == SENSOR).all(axis=-1).any()
    # Without tracks all of the image is shown, and nothing is said of it.
    assert not (seen.picture(1.0, None, None)[:40, :300] == SENSOR).all(axis=-1).any()


def test_an_enlarged_image_lies_below_its_tracks() -> None:
    """A bright pixel in a dark image, and a track on it."""
    grey = np.zeros((240, 320), dtype=np.uint8)
    grey[100:104, 200:204] = 255
    seen = TrackedImages((320, 240), (300.0, 300.0), (160.0, 120.0))
    scale, corner = seen._window(np.array([[198.0, 98.0], [206.0, 106.0]]))
    assert scale > 4.0 * 457 / 240
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(TrackedImages, "_image", lambda self, time_s: grey)
        picture = np.asarray(seen._background(0.0, scale, corner))
    rows, columns = np.nonzero(picture[..., 0] > 128)
    # Pixel centres are whole numbers: pixels 200 to 203 reach from 199.5 to 203.5.
    np.testing.assert_allclose(columns.mean(), corner[0] + scale * 202.0, atol=1.0 * scale)
    np.testing.assert_allclose(rows.mean(), corner[1] + scale * 102.0, atol=1.0 * scale)
    np.testing.assert_allclose(len(rows), 16 * scale**2, rtol=0.3)


def test_tracks_of_a_frame_have_the_colour_of_what_became_of_them_there() -> None:
    """Whatever became of them in most frames; a click finds them, and says why."""
    pixels = {1: (100.0, 50.0), 2: (300.0, 50.0), 3: (100.0, 180.0)}
    frame = TrackFrame(2.0, np.eye(3), np.array(list(pixels)), np.array(list(pixels.values())))
    seen = TrackedImages((400, 228), (400.0, 400.0), (200.0, 114.0), (frame,))
    always_used = FeatureTable(
        np.array([1, 2, 3]),
        np.full((3, 3), np.nan),
        np.ones((3, 3)),
        np.full(3, 9),
        np.zeros(3, int),
    )
    told = FeatureOutcomes(
        *(np.array([1, 2, 3]), (GATED, ACCEPTED, TRACKED), np.array([31.4, 0.5, np.nan]), 9.0)
    )
    picture = seen.picture(2.0, always_used, None, told)
    for colour, number in ((REJECTED_COLOUR, 1), (ACCEPTED_COLOUR, 2), (SENSOR, 3)):
        place = centre_of(picture, colour)
        np.testing.assert_allclose(place, 2.0 * np.array(pixels[number]), atol=1)
        share = (place + np.array([5.0, -4.0])) / [picture.shape[1], picture.shape[0]]
        assert seen.feature_at(share, 2.0, always_used, None) == number
    assert seen.feature_at(np.array([0.5, 0.5]), 2.0, always_used, None) is None
    assert seen.feature_at(np.array([0.25, 0.2]), 3.0, always_used, None) is None
    card = feature_card(told, 1, "measured")
    assert card.title == "feature 1 (rejected)"
    assert ["squared distance", "31.4, beyond the gate of 9"] in card.rows
    assert ["frame", "measured"] in card.rows
    assert ["squared distance", "it was not compared"] in feature_card(told, 3, "").rows


def test_the_list_of_features_begins_with_those_rejected_and_the_farthest_of_them() -> None:
    outcome = (ACCEPTED, GATED, TRACKED, GATED, ACCEPTED)
    squared = np.array([1.25, 31.5, np.nan, 77.5, 2.5])
    told = FeatureOutcomes(np.array([1, 2, 3, 4, 5]), outcome, squared, 9.0)
    html = features_html(told, "measured")
    assert "frame: measured; 2 used, 2 rejected, 1 seen only" in html
    places = [html.index(text) for text in ("77.5 / 9", "31.5 / 9", "2.5 / 9", "1.25 / 9")]
    assert places == sorted(places)
    assert html.rindex(TRACKED) > places[-1]
