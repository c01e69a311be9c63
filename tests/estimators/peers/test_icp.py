"""Alignment of the model: how far off it may be and still be found."""

from types import SimpleNamespace

import numpy as np
import pytest

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import make_transform
from pcnav.estimators.interface import Given
from pcnav.estimators.peers.icp import ModelAlignment, Open3dIcp, SmallGicp
from pcnav.recordings.sequence import Frame
from pcnav.target.rendering import DepthRenderer
from pcnav.target.satellite import Target


@pytest.mark.parametrize("peer", [Open3dIcp, SmallGicp])
def test_a_jump_by_a_sixtieth_of_the_target_is_followed(
    peer: type[ModelAlignment], boxsat: Target, camera: PinholeCamera
) -> None:
    """Partners are looked for within 2 % of the diameter, as the documentation of peers says."""
    if peer is SmallGicp:
        pytest.importorskip("small_gicp", reason="the peers are installed with the extra `bench`")
    D, renderer = boxsat.diameter_m, DepthRenderer(boxsat.mesh, camera)
    at = make_transform(np.eye(3), np.array([0.1, -0.2, 2.5 * D]))

    def frame(T: FloatArray, k: int) -> Frame:
        return Frame(k, 0.5 * k, renderer.render(T).depth_m, camera, np.eye(4))

    aligned = peer(Given(Pipeline(), SimpleNamespace(range_sigma_m=0.01), boxsat, at))
    aligned.pose(frame(at, 0))
    ahead = at.copy()
    # Along the normal of what is seen: no point has a partner that is nearer than the jump.
    ahead[2, 3] += 0.016 * D
    found = aligned.pose(frame(ahead, 1))
    assert found is not None
    assert np.linalg.norm(found[:3, 3] - ahead[:3, 3]) < 0.002 * D
