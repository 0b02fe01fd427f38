"""From a cloud to what the model and the check see of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from megrasp_core.pointcloud import (
    Cloud,
    SceneNodes,
    SceneSettings,
    SurfaceCloud,
    check_not_upside_down,
    only_support_left,
    scene_nodes,
    surface_cloud,
    unseen_structure,
)

from .objects import LabelledObjects
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
        surface: what the nodes were chosen from.
        empty: nothing but the support surface is left.
        notes: what was taken for granted, for who reads the answer.
        objects: where the cloud tells them apart.
    """

    nodes: SceneNodes
    judge: SceneJudge
    surface: SurfaceCloud
    empty: bool
    notes: tuple[str, ...] = ()
    objects: LabelledObjects | None = None


def perceive(
    cloud: Cloud,
    request: SynthesisRequest,
    scene: SceneSettings | None = None,
    ranking: RankingSettings | None = None,
    threads: int = 1,
) -> Perceived:
    """Preprocess a cloud, with so many threads; they change no result.

    Raises:
        CloudError, EmptyRegionError: nothing of it is of use.
        InvalidRequestError: the target is not in it, or the floor is not where it was said to be.
    """

    def seen(of: Cloud) -> SurfaceCloud:
        return surface_cloud(
            of,
            sensor=None if of is not cloud else request.sensor,
            gravity=request.gravity,
            region=request.region,
            settings=scene,
            threads=threads,
        )

    assert not isinstance(request.floor, (int, float))  # a plane since it was checked
    surface = seen(cloud)
    doubt = "" if request.region is None else request.region.doubt(surface.points)
    structure = unseen_structure(
        surface,
        floor=request.floor,
        walls=request.walls,
        assume_empty=request.assume_empty,
    )
    if len(structure.points):
        found = Cloud(structure.points, viewpoint=structure.seen_from)
        origin = cloud.viewpoint if request.sensor is None else request.sensor
        surface = seen(replace(cloud, viewpoint=origin).joined(found))
    objects = LabelledObjects.of(surface, request.target)
    # Under a floor that is only thought to be there, a flat object may be all that is seen.
    empty = not structure.estimated and only_support_left(
        surface.points, request.region, surface.gravity, surface.normals
    )
    if empty and request.region is None:
        check_not_upside_down(surface.points, surface.gravity)
    return Perceived(
        scene_nodes(surface, scene),
        SceneJudge(surface, request, ranking, objects),
        surface,
        empty,
        tuple(f"{note.rstrip('.')}." for note in (doubt, structure.note) if note),
        objects,
    )
