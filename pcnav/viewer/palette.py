"""Colours of the view: one meaning each, all readable on its dark background."""

import numpy as np
import numpy.typing as npt

Rgb = tuple[int, int, int]

PLAIN: Rgb = (120, 180, 255)
UNEXPLAINED: Rgb = (255, 60, 200)
"""A return that the model does not explain."""
BESIDE: Rgb = (95, 100, 112)
"""A return that is too far from the target to be its own."""
ACCEPTED_COLOUR: Rgb = (70, 220, 110)
REJECTED_COLOUR: Rgb = (255, 90, 80)
TRUTH: Rgb = (235, 235, 245)
SENSOR: Rgb = (150, 160, 180)
RATE: Rgb = (255, 150, 40)
MOMENTUM: Rgb = (190, 130, 255)
MASS_CENTRE: Rgb = (255, 230, 90)
POSITION: Rgb = (90, 220, 230)
ATTITUDE: Rgb = (255, 170, 200)
RUNS: tuple[Rgb, ...] = ((255, 196, 60), (80, 200, 255))
"""Of the first run and of the one it is compared with: mesh, trail and curves."""
RESIDUAL_STOPS: tuple[Rgb, ...] = ((40, 110, 255), (235, 235, 235), (255, 80, 40))
"""Nearer than the model, as the model, behind it."""

LABELS: npt.NDArray[np.uint8] = np.array(
    [
        *((86, 180, 233), (230, 159, 0), (0, 190, 140), (240, 228, 66), (90, 130, 255)),
        *((213, 94, 0), (204, 121, 167), (160, 230, 120), (180, 160, 255), (255, 200, 160)),
        *((120, 220, 220), (200, 150, 90)),
    ],
    dtype=np.uint8,
)
"""Neighbouring numbers differ also to the colour-blind."""


def hex_of(colour: Rgb) -> str:
    """As HTML and plots write it."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def rgba_of(colour: Rgb, opacity: float) -> str:
    """As HTML and plots write it, with an opacity from 0 to 1."""
    return "rgba({}, {}, {}, {:g})".format(*colour, opacity)


def coloured(text: str, colour: Rgb) -> str:
    """HTML of a text, which is not escaped."""
    return f"<span style='color:{hex_of(colour)}'>{text}</span>"
