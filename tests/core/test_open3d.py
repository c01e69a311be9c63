"""Open3D is imported without what it plots in a browser with, which stays within reach."""

import subprocess
import sys

_CODE = """
import sys
from pcnav.core._open3d import open3d
module = open3d()
assert not {"dash", "plotly"} & sys.modules.keys(), "imported after all"
sphere = module.geometry.TriangleMesh.create_sphere()
figure = module.visualization.get_plotly_fig([sphere.sample_points_uniformly(10)])
assert "dash" in sys.modules
print(type(figure).__name__)
"""


def test_plots_are_imported_when_they_are_asked_for() -> None:
    run = subprocess.run(
        [sys.executable, "-c", _CODE], capture_output=True, text=True, check=False, timeout=120
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout.split() == ["Figure"]
