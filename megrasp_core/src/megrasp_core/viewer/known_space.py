"""What is known of the space of a cloud, as points to draw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from megrasp_core.pointcloud import Cloud
from megrasp_core.ranking import PointState
from megrasp_core.synthesizer import GraspSynthesizer, SynthesisRequest, perceive

__all__ = ["KnownSpace", "known_space"]

PITCH = 0.006
"""Distance (m) of the places that are asked about, in a scene that is not large."""
MOST = 120_000
"""Places; in a larger scene they lie farther apart."""
ABOVE = 0.02
"""Of the space over what was seen (m): free of course."""


@dataclass(frozen=True)
class KnownSpace:
    """Points (N, 3) by what the check takes them for, in the frame of the cloud.

    Attributes:
        seen: the surface.
        unknown: where nothing is known.
        inside: in a body behind its seen surface.
        solid: in a wall or below the floor.
        pitch: distance of the points of the last three (m).
    """

    seen: NDArray[np.float64]
    unknown: NDArray[np.float64]
    inside: NDArray[np.float64]
    solid: NDArray[np.float64]
    pitch: float


def known_space(
    cloud: Cloud, request: SynthesisRequest, synthesizer: GraspSynthesizer
) -> KnownSpace:
    """Ask the check of a synthesis about a grid of places.

    Raises:
        CloudError, EmptyRegionError: nothing of the cloud is of use.
    """
    seen = perceive(
        cloud, request, synthesizer.scene_settings, synthesizer.settings.ranking
    ).judge.observation
    surface = np.asarray(seen.surface_points, np.float64)
    box = np.array([surface.min(axis=0), surface.max(axis=0)])
    if request.region is not None:
        corners = request.region.grown(PITCH).corners()
        box = np.array([corners.min(axis=0), corners.max(axis=0)])
    box += [[-PITCH], [ABOVE]]
    pitch = max(PITCH, float(np.cbrt(np.prod(box[1] - box[0]) / MOST)))
    axes = [np.arange(low, high, pitch) for low, high in box.T]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    if request.region is not None:
        grid = grid[request.region.grown(2 * pitch).contains(grid)]
    state = seen.classify(grid)
    solid = np.isin(state, (PointState.WALL, PointState.FLOOR))
    return KnownSpace(
        surface,
        grid[state == PointState.UNSEEN],
        grid[state == PointState.INSIDE],
        grid[solid],
        pitch,
    )
