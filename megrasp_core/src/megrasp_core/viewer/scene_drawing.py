"""What the page of a scene shows in 3D: the cloud, the gripper at a grasp, other grasps, space."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from megrasp_core.drawing.splat import height_colours
from megrasp_core.grippers import Gripper
from megrasp_core.meshes import joined
from megrasp_core.pointcloud import Cloud, OrientedBox
from megrasp_core.synthesizer import RankedGrasp

from .figure import GripperFigure, fork
from .known_space import KnownSpace
from .poses import move, position_and_wxyz

if TYPE_CHECKING:
    from viser import ViserServer

__all__ = ["SPACES", "SceneDrawing", "extent"]

MOST_POINTS = 300_000
"""Of a cloud, that are sent to the browser."""
NEARNESS = 1.0
"""Distance of the first look in extents of the cloud."""
PATHS = {"approach": (70, 110, 200), "retreat": (150, 90, 190)}
SPACES = {
    "seen": ("Seen surface", (60, 60, 60)),
    "unknown": ("Unknown space", (150, 90, 190)),
    "inside": ("Taken for the inside of objects", (220, 140, 40)),
    "solid": ("Walls and below the floor", (90, 130, 90)),
}
"""Part of the known space -> what the page calls it, and its colour."""


class SceneDrawing:
    """Nodes of the page's scene; each call replaces what the same one drew before."""

    def __init__(self, server: ViserServer, gravity: ArrayLike | None, gripper: Gripper) -> None:
        """Draw into the scene of a server.

        Args:
            server: see `open_server`.
            gravity: (3,) down in the frame of the clouds; None: +z.
            gripper: see `mount`.
        """
        self._server = server
        self._down = np.asarray((0.0, 0.0, 1.0) if gravity is None else gravity, np.float64)
        self.mount(gripper)

    def look_at(self, box: OrientedBox) -> None:
        """Where pages that open look from: obliquely from above, at a box."""
        down = self._down
        self._server.scene.set_up_direction((-down[0], -down[1], -down[2]))
        # From a side that does not depend on the frame's axes.
        axis = np.eye(3)[int(np.argmin(np.abs(down)))]
        aside = np.asarray(np.cross(down, np.cross(axis, down)), np.float64)
        direction = 0.9 * aside / np.linalg.norm(aside) - down
        direction *= NEARNESS * np.linalg.norm(box.size) / np.linalg.norm(direction)
        camera = self._server.initial_camera
        camera.up = -down
        camera.position = box.centre + direction
        camera.look_at = box.centre

    def cloud(self, cloud: Cloud) -> None:
        """A cloud, in its own colours or by height."""
        cloud = cloud.finite()
        if len(cloud) > MOST_POINTS:
            chosen = np.random.default_rng(0).choice(len(cloud), MOST_POINTS, replace=False)
            cloud = cloud.select(np.sort(chosen))
        height = -cloud.points @ self._down
        low, high = np.percentile(height, [1, 99]) if len(cloud) else (0.0, 1.0)
        colours = cloud.colors
        if colours is None:
            colours = height_colours((height - low) / max(high - low, 1e-6))
        self._server.scene.add_point_cloud(
            "/cloud",
            cloud.points.astype(np.float32),
            (255 * np.clip(colours, 0, 1)).astype(np.uint8),
            point_size=_spacing(cloud.points),
            point_shape="rounded",
            point_shading="flat",
            precision="float32",
        )

    def mount(self, gripper: Gripper) -> None:
        """The gripper of all grasps from now on, out of sight until there is one."""
        if hasattr(self, "_figure"):
            self._figure.remove()
        self._gripper = gripper
        self._figure = GripperFigure(self._server.scene, "/gripper", gripper, visible=False)
        self._axes = [
            self._server.scene.add_frame(f"/gripper/{name}", axes_length=size, axes_radius=0.0012)
            for name, size in (("frame", 0.05), ("tcp", 0.03))
        ]
        move(self._axes[1], gripper.gripper_from_tcp)

    def grasp(self, grasp: RankedGrasp | None, *, frames: bool, paths: bool) -> None:
        """The gripper at a grasp, or out of sight.

        Args:
            grasp: None: there is none.
            frames: with axes at its frame and TCP.
            paths: with its ways there and off.
        """
        for name in PATHS:
            self._remove(f"/path/{name}")
        self._figure.visible = grasp is not None
        if grasp is None:
            return
        self._figure.place(grasp.world_from_gripper)
        for axes in self._axes:
            axes.visible = frames
        if not paths:
            return
        ends = {
            "approach": grasp.world_from_gripper_approach,
            "retreat": grasp.world_from_gripper_retreat,
        }
        here = grasp.world_from_tcp[:3, 3]
        for name, pose in ends.items():
            if pose is None:
                continue
            there = (pose @ self._gripper.gripper_from_tcp)[:3, 3]
            way = np.array([[here, there]], np.float32)
            lines = np.concatenate([way, fork(self._gripper, [pose])]).astype(np.float32)
            self._server.scene.add_line_segments(
                f"/path/{name}", lines, PATHS[name], thickness=0.0015
            )

    def close(self, share: float) -> None:
        """The fingers, a share (0 to 1) of the way from open to closed."""
        self._figure.close(share)

    def others(
        self,
        grasps: Sequence[RankedGrasp],
        colours: np.ndarray,
        *,
        forks: bool,
        grippers: bool,
    ) -> None:
        """Grasps beside the one that is looked at.

        Args:
            grasps: N of them.
            colours: (N, 3), 0 to 255.
            forks: as lines.
            grippers: as meshes.
        """
        self._remove("/others/forks")
        self._remove("/others/grippers")
        poses = [grasp.world_from_gripper for grasp in grasps]
        if poses and forks:
            self._server.scene.add_line_segments(
                "/others/forks",
                fork(self._gripper, poses),
                np.repeat(colours, 8, axis=0).reshape(-1, 2, 3).astype(np.uint8),
                thickness=0.002,
            )
        if poses and grippers:
            vertices, faces = joined(self._gripper.meshes("open"))
            nodes = [position_and_wxyz(pose) for pose in poses]
            self._server.scene.add_batched_meshes_simple(
                "/others/grippers",
                np.asarray(vertices, np.float32),
                np.asarray(faces, np.uint32),
                batched_wxyzs=np.array([node[1] for node in nodes], np.float32),
                batched_positions=np.array([node[0] for node in nodes], np.float32),
                batched_colors=colours.astype(np.uint8),
                opacity=0.5,
                flat_shading=True,
                side="double",
            )

    def space(self, known: KnownSpace | None, wanted: set[str]) -> None:
        """The parts of the known space, by their keys in `SPACES`, that are wanted."""
        for key, (_, colour) in SPACES.items():
            self._remove(f"/space/{key}")
            if known is None or key not in wanted:
                continue
            self._server.scene.add_point_cloud(
                f"/space/{key}",
                getattr(known, key).astype(np.float32),
                colour,
                point_size=0.002 if key == "seen" else 0.35 * known.pitch,
                point_shape="circle",
                precision="float32",
            )

    def _remove(self, name: str) -> None:
        node = self._server.scene.get_handle_by_name(name)
        if node is not None:
            node.remove()


def extent(cloud: Cloud) -> OrientedBox:
    """A box with a margin around most of a cloud."""
    low, high = np.percentile(cloud.finite().points, [2, 98], axis=0)
    return OrientedBox.around((low + high) / 2, np.maximum(high - low, 0.05) + 0.02)


def _spacing(points: np.ndarray) -> float:
    """About how far neighbours are apart (m), 1 to 6 mm."""
    if len(points) < 100:
        return 0.004
    span = np.percentile(points, 95, axis=0) - np.percentile(points, 5, axis=0)
    area = float(np.prod(np.sort(span)[1:]))
    return float(np.clip(1.1 * np.sqrt(area / len(points)), 0.001, 0.006))
