"""Depth images of a world by ray casting, on any machine, without OpenGL.

Rays go through an Embree scene, built from the same visual meshes and bin boxes as the
MuJoCo model: `mj_multiRay` gives the same distances within 2 micrometres but takes about ten times
as long (0.6 s against 0.05 s CPU for 640 x 480 and 12 scans of 2000 faces).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import InvalidRequestError
from megrasp_core.meshes import Mesh, RayScene
from megrasp_core.pointcloud import Cloud

from .camera import Camera, depth_to_points
from .depth_noise import DepthNoise
from .light import Light
from .support import SCENERY_COLOUR
from .view import View
from .world import SCENERY, World

TABLE_HALF = 2.0
"""Half edge of the table that rays can hit, m."""

_BOX_FACES = np.array(
    [[0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
     [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5]], dtype=np.uint32
)  # fmt: skip
_CORNERS = np.array(
    [[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], dtype=np.float64
)


class Snapshot:
    """The visible geometry of a world as it is now: objects, table, bin; never the gripper."""

    def __init__(self, world: World) -> None:
        meshes: list[Mesh] = []
        owners: list[int] = []
        inward: list[NDArray[np.float64]] = []
        poses = world.object_poses()
        for index in world.present:
            model, pose = world.objects[index], poses[index]
            meshes.append(model.mesh.moved(pose))
            owners.append(index)
        if world.has_table:
            square = _CORNERS[:4] * [TABLE_HALF, TABLE_HALF, 0.0]
            meshes.append(Mesh(square, np.array([[0, 1, 2], [1, 3, 2]])))
            owners.append(SCENERY)
        self._first_wall = len(owners)
        if world.bin is not None:
            pose, walls = world.bin.world_from_bin, world.bin.wall_boxes()
            for centre, half in [*walls, *world.bin.floor_boxes()]:
                corners = _CORNERS * half + centre
                meshes.append(Mesh(corners, _BOX_FACES).moved(pose))
                owners.append(SCENERY)
            for centre, _ in walls:
                across = -centre * [1.0, 1.0, 0.0] / np.linalg.norm(centre[:2])
                inward.append(pose[:3, :3] @ across)
        self._inward = np.array(inward, dtype=np.float32).reshape(-1, 3)
        self._owners = np.array([*owners, SCENERY], dtype=np.int32)
        self._scene = RayScene(meshes, apart=True)

    def view(self, camera: Camera) -> View:
        """Cast one ray a pixel."""
        pose = camera.world_from_camera
        directions = camera.rays() @ pose[:3, :3].T
        rays = np.empty((camera.height, camera.width, 6), dtype=np.float32)
        rays[..., :3] = pose[:3, 3]
        rays[..., 3:] = directions
        hits = self._scene.cast(rays)
        # Directions have z = 1 in the optical frame, so the ray parameter is the depth.
        depth, normals = hits.distance, hits.normals
        missed = ~np.isfinite(depth) | (depth > camera.far)
        depth = np.where(missed, np.float32(0.0), depth)
        geometry = np.minimum(hits.mesh, len(self._owners) - 1)
        owner = self._owners[geometry]
        owner[missed] = SCENERY
        along = np.einsum("hwk,hwk->hw", normals, rays[..., 3:])
        cosine = np.abs(along)
        cosine /= np.linalg.norm(rays[..., 3:], axis=-1)
        incidence = np.where(missed, np.float32(1.0), cosine)
        normals = np.where(along[..., None] > 0, -normals, normals)
        wall = self._walls_inside(np.where(missed, 0, geometry), normals)
        return View(depth, owner, incidence, normals, wall, camera.focal)

    def _walls_inside(
        self, geometry: NDArray[np.integer], normals: NDArray[np.float32]
    ) -> NDArray[np.int32]:
        wall = geometry.astype(np.int32) - self._first_wall
        wall[(wall < 0) | (wall >= len(self._inward))] = -1
        rows, columns = np.nonzero(wall >= 0)
        index = wall[rows, columns]
        # Rim and outside of a wall look another way.
        facing = np.einsum("nk,nk->n", normals[rows, columns], self._inward[index])
        wall[rows, columns] = np.where(facing > 0.5, index, -1)
        return wall


def render_view(world: World, camera: Camera) -> View:
    """Depth, owner and incidence of every pixel, without noise."""
    return Snapshot(world).view(camera)


def render_depth(world: World, camera: Camera) -> NDArray[np.float32]:
    """Depth image (h, w) in m without noise, 0 where nothing is within the camera's range."""
    return render_view(world, camera).depth


def observe(
    world: World,
    camera: Camera | Sequence[Camera],
    noise: DepthNoise | None = None,
    rng: np.random.Generator | None = None,
    light: Light | None = None,
) -> Cloud:
    """Cloud in the world frame of what one or several cameras see; the gripper is never in it.

    rng is needed with noise (InvalidRequestError without). The cloud's viewpoint is the camera's
    position (3,), for several cameras that of the one that saw each point (N, 3). Colours are the
    mean colours of objects and bin; with `light`, as they look in it.
    """
    cameras = [camera] if isinstance(camera, Camera) else list(camera)
    snapshot = Snapshot(world)
    scenery = SCENERY_COLOUR if world.bin is None else world.bin.colour
    palette = np.array([*(model.colour for model in world.objects), scenery])
    if light is not None:
        palette = light.painted(palette)
    points, colors, origins = [], [], []
    for one in cameras:
        view = snapshot.view(one)
        depth = view.depth
        if noise is not None:
            if rng is None:
                raise InvalidRequestError("noise was given without rng; pass a seeded generator")
            depth = noise.apply(view, rng)
        points.append(depth_to_points(depth, one))
        seen = depth > 0
        color = palette[view.owner[seen]]
        if light is not None and view.normals is not None:
            color = light.shaded(color, view.normals[seen])
        colors.append(color)
        origins.append(np.broadcast_to(one.position, points[-1].shape))
    viewpoint = cameras[0].position if len(cameras) == 1 else np.concatenate(origins)
    return Cloud(np.concatenate(points), np.concatenate(colors), viewpoint)
