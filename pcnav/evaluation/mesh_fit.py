"""Where the target is not as its mesh says, as a table and in sentences."""

import csv
import io

import numpy as np

from pcnav.perception.part_fit import PartFit, PartVerdict


def mesh_fit_csv(parts: tuple[PartFit, ...]) -> str:
    """The content of mesh_fit.csv, a row per part."""
    stream = io.StringIO()
    rows = csv.writer(stream, lineterminator="\n")
    rows.writerow(
        (
            *("part", "verdict", "pixels", "explained_share", "seen_through_share"),
            *("turn_deg", "turn_sd_deg", "axis_x", "axis_y", "axis_z"),
        )
    )
    for each in parts:
        axis = each.axis_model or (np.nan,) * 3
        shares = (each.explained_share, each.seen_through_share)
        turn = (each.turn_deg, each.turn_sd_deg)
        rows.writerow((each.name, each.verdict, each.pixels, *shares, *turn, *axis))
    return stream.getvalue()


def sentences(parts: tuple[PartFit, ...]) -> tuple[str, ...]:
    """What differs from the mesh, a sentence a part."""
    found = []
    for each in parts:
        if each.verdict is PartVerdict.TURNED:
            assert each.axis_model is not None, "it is turned about something"
            axis = ", ".join(f"{x:.2f}" for x in each.axis_model)
            found.append(
                f"{each.name} is not as in the mesh: turned by {each.turn_deg:.1f} deg "
                f"(sd {each.turn_sd_deg:.2g}) about ({axis}) of the model"
            )
        elif each.verdict is PartVerdict.MISSING:
            share = f"{each.seen_through_share:.0%}"
            found.append(f"{each.name} is not where the mesh has it: {share} of it is seen through")
        elif each.verdict is PartVerdict.DIFFERS:
            share = f"{each.explained_share:.0%}"
            found.append(f"{each.name} differs from the mesh: {share} of its pixels are explained")
    return tuple(found)
