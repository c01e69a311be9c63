"""Every recording of a folder, and one table of what came out. Needs a folder recordings."""

from pathlib import Path

import pandas as pd

import pcnav

rows = []
for recording in sorted(Path("recordings").iterdir()):
    out = Path("results") / recording.name
    try:
        summary = pcnav.run(recording, out, overwrite=True, report=False)
    except pcnav.InputError as error:
        rows.append({"recording": recording.name, "fault": str(error)})
        continue
    status = pcnav.read_run(out).status
    claimed = sum(each in ("locked", "ambiguous") for each in status) / len(status)
    rows.append({"recording": recording.name, "claimed": claimed, "warnings": summary.warnings})
pd.DataFrame(rows).to_csv("results.csv", index=False)
