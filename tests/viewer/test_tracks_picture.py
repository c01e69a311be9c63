"""Tracks are drawn where they were seen, in the colour of what became of them."""

import numpy as np

from pcnav.recordings.tracks import TrackFrame
from pcnav.runs.run import FeatureTable
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
