"""Depth cameras by name: the noise that their makers or others have published, where they have."""

from __future__ import annotations

from megrasp_core.errors import InvalidRequestError

from .depth_noise import DepthNoise

STRUCTURED_LIGHT = DepthNoise(
    axial_base=0.0,
    axial_square=0.001425,
    step_square=0.00285,
    disparity=True,
    baseline=0.075,
    max_range=5.0,
    edge_loss=0.6,
    edge_mix=0.02,
    shiny_share=0.2,
    far_wall=0.3,
)
"""A camera with a projected pattern, like the first Kinect.

From K. Khoshelham and S. Oude Elberink, Accuracy and Resolution of Kinect Depth Data for Indoor
Mapping Applications, Sensors 12 (2012) 1437: one step of disparity is 2.85e-3 z^2 m of depth, the
standard deviation half of it, the range 5 m; projector and camera are 7.5 cm apart. Edges, shiny
surfaces, far wall, and how far noise is correlated, are our choice.
"""

_D435_PIXEL = 1.0 / (424.0 * 0.050)
"""Depth over z^2 of one pixel of disparity: focal length 424 pixels (848 over 90 degrees), eyes
50 mm apart."""

STEREO = DepthNoise(
    axial_base=0.0,
    axial_square=0.08 * _D435_PIXEL,
    step_square=_D435_PIXEL / 32.0,
    disparity=True,
    correlated=0.8,
    correlation=3.0,
    baseline=0.050,
    max_range=3.0,
    edge_loss=0.3,
    edge_mix=0.25,
    shiny_share=0.06,
    far_wall=0.15,
)
"""A camera with two eyes, like the RealSense D435.

From A. Grunnet-Jepsen and others, Tuning depth cameras for best performance (Intel RealSense): the
error grows as z^2 / (focal length * baseline) times the error of the disparity, about 0.08 pixels
on ordinary surfaces; and from their Subpixel linearity improvement: disparity comes in 1/32 pixel.
Range as in the data sheet. Noise is correlated over the matching window and edges mix more than
with a pattern; these numbers, shiny surfaces and far wall are our choice.
"""

NOISES: dict[str, DepthNoise | None] = {
    "default": DepthNoise(),
    "structured_light": STRUCTURED_LIGHT,
    "stereo": STEREO,
    "none": None,
}


def noise_named(name: str) -> DepthNoise | None:
    """The noise of a camera by its name in NOISES; None is a camera without noise.

    Raises:
        InvalidRequestError: another name.
    """
    if name not in NOISES:
        raise InvalidRequestError(f"unknown noise {name!r}; expected one of {', '.join(NOISES)}.")
    return NOISES[name]
