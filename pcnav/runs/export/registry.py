"""The formats that a run is exported to, by name."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pcnav.runs.export import aem, bop_csv, csv_poses, kitti, mcap, npz, oem, tum
from pcnav.runs.export.content import Export, Files


@dataclass(frozen=True)
class ExportFormat:
    """One format."""

    suffix: str
    """Of its file."""
    about: str
    """Frame, order of quaternions, units, in words."""
    write: Callable[[Export], Files]
    """Raises `InputError` for a run that lacks what the format tells."""


FORMATS = {
    "tum": ExportFormat(".tum", tum.ABOUT, tum.write_tum),
    "kitti": ExportFormat(".kitti", kitti.ABOUT, kitti.write_kitti),
    "csv": ExportFormat(".csv", csv_poses.ABOUT, csv_poses.write_csv_poses),
    "bop": ExportFormat(".csv", bop_csv.ABOUT, bop_csv.write_bop_csv),
    "oem": ExportFormat(".oem", oem.ABOUT, oem.write_oem),
    "aem": ExportFormat(".aem", aem.ABOUT, aem.write_aem),
    "npz": ExportFormat(".npz", npz.ABOUT, npz.write_npz),
    "mcap": ExportFormat(".mcap", mcap.ABOUT, mcap.write_mcap),
}


def companion(out: Path, word: str) -> Path:
    """The file of a format beside the one asked for; that one for the empty word."""
    return out.with_name(f"{out.stem}.{word}{out.suffix}") if word else out
