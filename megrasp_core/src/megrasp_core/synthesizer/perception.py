"""From a cloud to what the model and the check see of it."""

from __future__ import annotations

from dataclasses import dataclass

from megrasp_core.pointcloud import (
    Cloud,
    SceneNodes,
    SceneSettings,
    only_support_left,
    scene_nodes,
    surface_cloud,
)

from .request import SynthesisRequest
from .scene_judge import SceneJudge
from .settings import RankingSettings

__all__ = ["Perceived", "perceive"]


@dataclass(frozen=True)
class Perceived:
    """A scene.

    Attributes:
        nodes: what the model sees.
        judge: of poses in it.
        empty: nothing but the support surface is left.
    """

    nodes: SceneNodes
    judge: SceneJudge
    empty: bool


def perceive(
    cloud: Cloud,
    request: SynthesisRequest,
    scene: SceneSettings | None = None,
    ranking: RankingSettings | None = None,
) -> Perceived:
    """Preprocess a cloud.

    Raises:
        CloudError, EmptyRegionError: nothing of it is of use.
    """
    surface = surface_cloud(
        cloud,
        sensor=request.sensor,
        gravity=request.gravity,
        region=request.region,
        settings=scene,
    )
    return Perceived(
        scene_nodes(surface, scene),
        SceneJudge(surface, request, ranking),
        only_support_left(surface.points, request.region, surface.gravity),
    )
