"""Edges cut for a lens: they follow the curve, and all of it that the image may show."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from pcnav.core.camera import PinholeCamera, project
from pcnav.core.distortion import Distortion, DistortionModel
from pcnav.perception.bent_edges import edge_segments

CAMERA = PinholeCamera.from_field_of_view(640, 480, np.deg2rad(70.0))
LENSES = [
    Distortion(DistortionModel.OPENCV, (-0.2, 0.05, 0.0, 0.0, 0.0)),
    Distortion(DistortionModel.OPENCV, (-0.55, 0.0, 0.0, 0.0, 0.0)),
    Distortion(DistortionModel.FISHEYE, (0.05, -0.01, 0.002, 0.0)),
]


@pytest.mark.parametrize("lens", LENSES)
def test_segments_lie_on_the_curve_to_a_hundredth_of_a_pixel(lens: Distortion) -> None:
    camera = replace(CAMERA, distortion=lens)
    rng = np.random.default_rng(4)
    start = rng.uniform(-3.0, 3.0, (60, 3)) * [2.0, 1.5, 0.4]
    end = rng.uniform(-3.0, 3.0, (60, 3)) * [2.0, 1.5, 0.4]
    start[:, 2] += 4.0
    end[:, 2] += 4.0
    cut = edge_segments(camera, partial(project, camera), start, end)
    assert len(cut.edge) > 100
    share = np.linspace(0.0, 1.0, 11)[:, None]
    for k in range(0, len(cut.edge), 7):
        # Straight in space, so the points between lie on the edge itself.
        between = cut.start_cam[k] + share * (cut.end_cam[k] - cut.start_cam[k])
        image = project(camera, between)
        chord = image[-1] - image[0]
        if not (np.abs(image - [320.0, 240.0]) < [320.0, 240.0]).all():
            continue
        across = np.array([-chord[1], chord[0]]) / np.linalg.norm(chord)
        off = (image - image[0]) @ across
        assert np.abs(off).max() < 0.01
    for edge in np.unique(cut.edge):
        own = cut.edge == edge
        first, last = cut.start_cam[own][0], cut.end_cam[own][-1]
        # Segments follow each other, and what is left out at the ends is out of the image.
        np.testing.assert_allclose(cut.start_cam[own][1:], cut.end_cam[own][:-1], atol=1e-9)
        for given, kept in ((start[edge], first), (end[edge], last)):
            if np.linalg.norm(given - kept) > 1e-9:
                u, v = project(camera, kept)
                is_shown = 0.0 <= u <= 639.0 and 0.0 <= v <= 479.0
                at_end = np.hypot(*kept[:2] / kept[2]) > 0.999 * lens.max_radius
                assert at_end or not is_shown


def test_edges_beside_the_image_are_left_out() -> None:
    camera = replace(CAMERA, distortion=LENSES[0])
    start, end = np.array([[-50.0, 40.0, 5.0]]), np.array([[50.0, 40.0, 5.0]])
    assert len(edge_segments(camera, partial(project, camera), start, end).edge) == 0
