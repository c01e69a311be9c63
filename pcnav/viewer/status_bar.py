"""What the bar above the scene says of a frame: is the lock right?"""

from typing import Any

import numpy as np

from pcnav.dynamics.blocks import POSITION
from pcnav.runs.doubts import COLUMN, TOLD, doubts_in
from pcnav.runs.status import CLAIMED
from pcnav.viewer.assessment import SIGMA_BOUND, error_over_sigma, inlier_ratio, nis_over_bound
from pcnav.viewer.loaded_run import LoadedRun
from pcnav.viewer.palette import PLAIN, REJECTED_COLOUR, RUNS, STATUS, hex_of

Item = dict[str, Any]


def status_of_frame(runs: tuple[LoadedRun, ...], frame: int) -> dict[str, Any]:
    """Frame, time and items of the bar, a row a run, for the page."""
    first = runs[0]
    time_s = float(first.run.time_s[frame])
    rows = []
    for k, (loaded, colour) in enumerate(zip(runs, RUNS, strict=False)):
        at = frame if k == 0 else loaded.nearest_frame(time_s)
        items: list[Item] = [{"value": loaded.name, "colour": hex_of(colour)}]
        items += [{"value": "no frame then"}] if at is None else items_of(loaded, at)
        if loaded.target is not None:
            items.append({"label": "symmetry", "value": loaded.target.symmetry_name})
        rows.append(items)
    return {"frame": frame, "last": len(first) - 1, "time": round(time_s, 6), "rows": rows}


def items_of(loaded: LoadedRun, frame: int) -> list[Item]:
    """Status, inlier ratio, NIS and error of a frame; what contradicts the status is marked."""
    status = loaded.run.status[frame]
    colour = hex_of(STATUS.get(status, PLAIN))
    items: list[Item] = [{"value": status, "chip": True, "colour": colour}]
    inliers = inlier_ratio(loaded)
    if inliers is not None:
        told = "none" if np.isnan(inliers[frame]) else f"{100.0 * inliers[frame]:.0f} %"
        title = "share of the features compared that agree"
        if loaded.target is not None:
            title = "share of the returns on the target's outline that the estimate explains"
        items.append({"label": "inliers", "value": told, "title": title})
    nis = nis_over_bound(loaded)
    if np.isfinite(nis).any():
        told = "none" if np.isnan(nis[frame]) else f"{nis[frame]:.2f} × 95 % bound"
        items.append({"label": "NIS", "value": told, "bad": bool(nis[frame] > 1.0)})
    return [*items, *_doubts(loaded, frame), *_error(loaded, frame, claimed=status in CLAIMED)]


def _doubts(loaded: LoadedRun, frame: int) -> list[Item]:
    """What speaks against the estimate, by the run itself."""
    fields = loaded.run.words.get(COLUMN, ())
    raised = doubts_in(fields[frame]) if frame < len(fields) else ()
    if not raised:
        return []
    title = "; ".join(TOLD[doubt] for doubt in raised)
    return [{"label": "doubts", "value": ", ".join(raised), "title": title, "bad": True}]


def _error(loaded: LoadedRun, frame: int, *, claimed: bool) -> list[Item]:
    """Of the pose where the truth is known, with how many stated deviations that is."""
    if loaded.errors is None:
        return []
    parts = []
    for placed in (loaded.errors.p_cam_m, loaded.error(POSITION)):
        if placed is not None and np.isfinite(placed[frame]).all():
            parts.append(f"{1e3 * np.linalg.norm(placed[frame]):.3g} mm")
            break
    turned = loaded.attitude_error_rad
    if turned is not None and np.isfinite(turned[frame]).all():
        parts.append(f"{np.rad2deg(np.linalg.norm(turned[frame])):.3g} deg")
    if not parts:
        return []
    told, ratio = ", ".join(parts), error_over_sigma(loaded)
    item: Item = {"label": "error", "value": told, "title": "true minus estimated pose"}
    if ratio is not None and np.isfinite(ratio[frame]):
        item["value"] = f"{told} = {ratio[frame]:.2g} σ"
        if ratio[frame] > SIGMA_BOUND:
            item |= {"bad": claimed, "colour": hex_of(REJECTED_COLOUR)}
    return [item]
