"""How the parts of the target lie in the frames, against its mesh."""

import numpy as np

from pcnav.files.text_table import MISSING, TextTable, number
from pcnav.perception.part_fit import PartFit
from pcnav.report.content import ReportContent
from pcnav.report.page import Piece

_NOTE = (
    "Pixels of a part that the mesh predicts and nothing hides, over up to 24 frames at the run's "
    "own poses. Turn: of the part's largest flat face against the plane of most returns about it."
)


def mesh_against_frames(content: ReportContent) -> list[Piece]:
    """A row per part; nothing of a target without a claim."""
    if not content.parts:
        return []
    header = ("part", "verdict", "pixels", "explained", "seen through", "turn, deg", "sd, deg")
    rows = tuple(_row(part) for part in content.parts)
    return [TextTable("mesh_fit", "Parts of the target", header, rows, _NOTE, text_columns=2)]


def _row(part: PartFit) -> tuple[str, ...]:
    shares = (part.explained_share, part.seen_through_share)
    return (
        *(part.name, str(part.verdict), str(part.pixels)),
        *(MISSING if np.isnan(share) else f"{share:.1%}" for share in shares),
        *(MISSING if np.isnan(x) else number(x) for x in (part.turn_deg, part.turn_sd_deg)),
    )
