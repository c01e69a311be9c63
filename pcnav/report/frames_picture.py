"""A picture of the first frames of a recording: what an estimator will be given."""

import io

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from pcnav.recordings.sequence import Frame
from pcnav.report.figures import INK, MUTED

_COLUMNS, _WIDTH_IN, _DPI = 3, 4.2, 100
_PERCENT = (1.0, 99.0)
_HOLE = "#111827"


def frames_picture(frames: list[Frame], name: str) -> bytes:
    """PNG of depth images in the colours of one scale, pixels without a return dark.

    ``frames`` are at least one.
    """
    columns = min(_COLUMNS, len(frames))
    rows = -(-len(frames) // columns)
    camera = frames[0].camera
    height = _WIDTH_IN * camera.height / camera.width + 0.35
    size = (_WIDTH_IN * columns + 1.2, height * rows + 0.5)
    figure = Figure(figsize=size, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    seen = np.concatenate([frame.depth_m[frame.depth_m > 0.0] for frame in frames])
    near, far = np.percentile(seen, _PERCENT) if len(seen) else (0.0, 1.0)
    drawn = None
    places = figure.subplots(rows, columns, squeeze=False)
    for place in places.ravel():
        place.set_axis_off()
    for place, frame in zip(places.ravel(), frames, strict=False):
        place.set_axis_on()
        place.set_facecolor(_HOLE)
        depth = np.ma.masked_equal(frame.depth_m, 0.0)
        drawn = place.imshow(depth, vmin=near, vmax=far, cmap="viridis_r", interpolation="nearest")
        count = int(np.count_nonzero(frame.depth_m))
        title = f"frame {frame.index}, {frame.time_s:.6g} s, {count} returns"
        place.set_title(title, fontsize=8, color=INK)
        place.tick_params(labelsize=6, colors=MUTED)
    figure.suptitle(name, fontsize=10, color=INK)
    if drawn is not None:
        figure.colorbar(drawn, ax=list(places.ravel()), label="z-depth, m", shrink=0.9)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=_DPI, metadata={"Software": None})
    return stream.getvalue()
