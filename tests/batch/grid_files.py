"""Grid files that tests write."""

from pathlib import Path

from pcnav.batch.grid import GridPlan, read_grid

BATCH = '[batch]\nname = "small"\nruns = 3\nseed = 5\nframes = 8\n'
CROSS = """
[base]
satellite = "boxsat"
[[grid]]
cross = { range_m = [15, 20.5], tumble_deg_s = [1, 2, 3], estimator = ["pcnav", "kiss_icp"] }
"""


def written(folder: Path, text: str, name: str = "grid.toml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def grid(folder: Path, text: str) -> GridPlan:
    return read_grid(written(folder, BATCH + text))
