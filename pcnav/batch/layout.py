"""Names of the files in a batch's folder, and what tells one such folder from another."""

import json
from pathlib import Path

GRID_FILE = "grid.toml"
BATCH_FILE = "batch.json"
RUNS_FOLDER = "runs"


def read_identity(folder: Path) -> str | None:
    """What was drawn when the folder was made; None where there is no such folder."""
    try:
        about = json.loads((folder / BATCH_FILE).read_text(encoding="utf-8"))
        return str(about["identity"])
    except (OSError, ValueError, TypeError, KeyError):
        return None
