"""Colours of the view: one meaning each, all readable on its dark background.

What means different things and is seen together differs by 20 in CIE L*a*b* at least, to eyes that
lack the receptors for green, too.
"""

import numpy as np
import numpy.typing as npt

from pcnav.runs.status import Status

Rgb = tuple[int, int, int]

PLAIN: Rgb = (120, 180, 255)
UNEXPLAINED: Rgb = (255, 60, 200)
"""A return that the model does not explain."""
BESIDE: Rgb = (95, 100, 112)
"""A return that is too far from the target to be its own."""
ACCEPTED_COLOUR: Rgb = (64, 224, 170)
REJECTED_COLOUR: Rgb = (235, 80, 50)
AMBIGUOUS: Rgb = (255, 214, 70)
COASTING: Rgb = (200, 160, 255)
ACQUIRING: Rgb = (80, 130, 255)
STATUS: dict[str, Rgb] = {
    Status.LOCKED: ACCEPTED_COLOUR,
    Status.AMBIGUOUS: AMBIGUOUS,
    Status.COASTING: COASTING,
    Status.ACQUIRING: ACQUIRING,
    Status.LOST: REJECTED_COLOUR,
}
TRUTH: Rgb = (235, 235, 245)
SENSOR: Rgb = (150, 160, 180)
RATE: Rgb = (240, 110, 20)
MOMENTUM: Rgb = (150, 100, 255)
MASS_CENTRE: Rgb = (255, 235, 80)
POSITION: Rgb = (60, 200, 230)
ATTITUDE: Rgb = (230, 120, 160)
RUNS: tuple[Rgb, ...] = ((255, 196, 60), (80, 200, 255))
"""Of the first run and of the one it is compared with: mesh, trail and curves."""
RESIDUAL_STOPS: tuple[Rgb, ...] = ((40, 110, 255), (235, 235, 235), (255, 80, 40))
"""Nearer than the model, as the model, behind it."""

LABELS: npt.NDArray[np.uint8] = np.array(
    [
        *((153, 153, 255), (255, 255, 0), (187, 51, 0), (51, 51, 255), (102, 238, 85)),
        *((255, 51, 119), (187, 255, 255), (85, 68, 204), (255, 255, 204)),
    ],
    dtype=np.uint8,
)
"""Of the largest faces, a colour each; all smaller ones share the last."""


def hex_of(colour: Rgb) -> str:
    """As HTML and plots write it."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def rgba_of(colour: Rgb, opacity: float) -> str:
    """As HTML and plots write it, with an opacity from 0 to 1."""
    return "rgba({}, {}, {}, {:g})".format(*colour, opacity)


def coloured(text: str, colour: Rgb) -> str:
    """HTML of a text, which is not escaped."""
    return f"<span style='color:{hex_of(colour)}'>{text}</span>"
