"""Colours of the view: one meaning each, all readable on its dark background.

What means different things and is seen together differs by 20 at least (CIEDE2000), to eyes that
lack the receptors for green, too.
"""

import numpy as np
import numpy.typing as npt

from pcnav.runs.status import Status

Rgb = tuple[int, int, int]

PLAIN: Rgb = (120, 180, 255)
UNEXPLAINED: Rgb = (253, 65, 165)
"""A return that the model does not explain."""
BESIDE: Rgb = (94, 99, 111)
"""A return that is too far from the target to be its own."""
ACCEPTED_COLOUR: Rgb = (10, 218, 157)
REJECTED_COLOUR: Rgb = (229, 71, 41)
AMBIGUOUS: Rgb = (255, 212, 15)
COASTING: Rgb = (203, 167, 255)
ACQUIRING: Rgb = (47, 120, 255)
STATUS: dict[str, Rgb] = {
    Status.LOCKED: ACCEPTED_COLOUR,
    Status.AMBIGUOUS: AMBIGUOUS,
    Status.COASTING: COASTING,
    Status.ACQUIRING: ACQUIRING,
    Status.LOST: REJECTED_COLOUR,
}
TRUTH: Rgb = (242, 242, 254)
SENSOR: Rgb = (150, 160, 180)
RATE: Rgb = (233, 104, 7)
MOMENTUM: Rgb = (145, 99, 255)
MASS_CENTRE: Rgb = (255, 235, 68)
POSITION: Rgb = (72, 208, 236)
ATTITUDE: Rgb = (235, 119, 162)
RUNS: tuple[Rgb, ...] = ((255, 198, 65), (72, 200, 255))
"""Of the first run and of the one it is compared with: mesh, trail and curves."""
RESIDUAL_STOPS: tuple[Rgb, ...] = ((4, 111, 253), (235, 235, 235), (254, 77, 30))
"""Nearer than the model, as the model, behind it."""

LABELS: npt.NDArray[np.uint8] = np.array(
    [
        *((155, 168, 254), (254, 254, 11), (97, 28, 4), (6, 30, 158), (121, 189, 85)),
        *((186, 57, 80), (172, 252, 255), (148, 0, 255), (250, 247, 213)),
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
