"""A gripper in the scene: its links, moved between the open and the closed posture; its fork."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from megrasp_core.grippers import Gripper, body_poses
from megrasp_core.meshes import joined

from .poses import move

if TYPE_CHECKING:
    from viser import SceneApi

__all__ = ["GripperFigure", "fork"]

Colour = tuple[int, int, int]

STEM, DEPTH = 0.035, 0.045
"""Of a fork: its stem, and from its bar to the TCP (m)."""


class GripperFigure:
    """A gripper's meshes under a frame, the gripper frame, which is put anywhere."""

    def __init__(
        self,
        scene: SceneApi,
        name: str,
        gripper: Gripper,
        colour: Colour = (140, 160, 199),
        *,
        which: str = "visual",
        opacity: float | None = None,
        visible: bool = True,
    ) -> None:
        """Draw it open at the origin.

        Args:
            scene: viser's.
            name: of the frame, `/a/b`; what has this name is replaced.
            gripper: whose links are drawn.
            colour: 0..255.
            which: "visual" or "collision" geometry.
            opacity: 0..1; None: solid.
            visible: at once.
        """
        self.gripper = gripper
        self._start, self._end = gripper.qpos("open"), gripper.qpos("closed")
        self.frame = scene.add_frame(name, show_axes=False, visible=visible)
        bodies: dict[int, list] = {}
        for mesh in gripper.body_meshes(which):
            bodies.setdefault(mesh.body, []).append(mesh.mesh)
        self._links = {}
        for body, meshes in bodies.items():
            vertices, faces = joined(meshes)
            self._links[body] = scene.add_mesh_simple(
                f"{name}/link_{body}",
                np.asarray(vertices, np.float32),
                np.asarray(faces, np.uint32),
                color=colour,
                opacity=opacity,
                flat_shading=True,
                side="double",
            )
        self.close(0.0)

    def close(self, share: float) -> None:
        """Bring the fingers to this share, 0..1, of their way from open to closed."""
        qpos = self._start + share * (self._end - self._start)
        poses = body_poses(self.gripper.model, qpos)
        for body, link in self._links.items():
            move(link, poses[body])

    def place(self, world_from_gripper: NDArray[np.float64]) -> None:
        """Put the gripper frame at a pose (4, 4)."""
        move(self.frame, world_from_gripper)

    @property
    def visible(self) -> bool:
        """Whether it is shown."""
        return self.frame.visible

    @visible.setter
    def visible(self, value: bool) -> None:
        self.frame.visible = value

    def remove(self) -> None:
        """Take it out of the scene."""
        self.frame.remove()


def fork(gripper: Gripper, poses: Iterable[NDArray[np.float64]]) -> NDArray[np.float32]:
    """Line segments (N, 2, 3) that stand for a gripper at world_from_gripper poses: a stem along
    the approach, a bar along the closing axis, two prongs that end beside the TCP; four a pose.
    """
    tcp = np.asarray(gripper.tcp)
    root = tcp - [0.0, 0.0, DEPTH]
    side = np.array([(gripper.description.max_width or 0.08) / 2, 0.0, 0.0])
    lines = np.array(
        [
            [root - [0.0, 0.0, STEM], root],
            [root - side, root + side],
            [root - side, tcp - side],
            [root + side, tcp + side],
        ]
    )
    placed = [lines @ pose[:3, :3].T + pose[:3, 3] for pose in poses]
    return np.asarray(placed, np.float32).reshape(-1, 2, 3)
