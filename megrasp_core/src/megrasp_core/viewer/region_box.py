"""The region of a scene: a box to drag and to size."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from megrasp_core.lie import pose7_from_matrix
from megrasp_core.pointcloud import OrientedBox

from .poses import matrix_of, move

if TYPE_CHECKING:
    from viser import ViserServer

__all__ = ["RegionBox"]

EDGES = np.array([[0, 1], [2, 3], [4, 5], [6, 7], [0, 2], [1, 3], [4, 6], [5, 7],
                  [0, 4], [1, 5], [2, 6], [3, 7]])  # fmt: skip
"""Of the corners of an `OrientedBox`."""
COLOUR = (210, 120, 20)
NAME, HANDLES = "/region", "/region_handles"


class RegionBox:
    """A box with handles; its sizes and switches are in the panel that is open when it is made."""

    def __init__(
        self,
        server: ViserServer,
        box: OrientedBox,
        *,
        used: bool,
        walls: bool,
        changed: Callable[[], None],
    ) -> None:
        """Draw the box.

        Args:
            server: where it is drawn.
            box: to begin with.
            used: whether it counts.
            walls: whether it is the inside of a bin.
            changed: called after each change.
        """
        self._scene = server.scene
        self._changed = changed
        self.used = server.gui.add_checkbox("Only what is in the box", used)
        self.walls = server.gui.add_checkbox("It is the inside of a bin", walls)
        size = (float(box.size[0]), float(box.size[1]), float(box.size[2]))
        self.size = server.gui.add_vector3("Edges (m)", size, min=(0.01, 0.01, 0.01), step=0.005)
        self.drag = server.gui.add_checkbox("Handles to drag it", False)
        self._frame = server.scene.add_frame(NAME, show_axes=False, visible=used)
        self._handles = server.scene.add_transform_controls(
            HANDLES, scale=0.4 * float(box.size.max()), depth_test=False, visible=False
        )
        self._place(box)
        self._draw()
        self._handles.on_update(lambda _: self._dragged())
        self.size.on_update(lambda _: self._update())
        self.walls.on_update(lambda _: self._changed())
        for switch in (self.used, self.drag):
            switch.on_update(lambda _: self._update())

    @property
    def box(self) -> OrientedBox | None:
        """The box as it is now, in the frame of the cloud; None where it does not count."""
        return self.shape if self.used.value else None

    @property
    def shape(self) -> OrientedBox:
        """The box, whether or not it counts."""
        return OrientedBox(matrix_of(self._frame), np.asarray(self.size.value))

    def move_to(self, box: OrientedBox) -> None:
        """Put it somewhere else."""
        self._place(box)
        self.size.value = (float(box.size[0]), float(box.size[1]), float(box.size[2]))
        self._update()

    def to_json(self) -> str:
        """Content of a region file, as `megrasp synthesize --region` reads it."""
        shape = self.shape
        content = {
            "pose": [round(float(v), 6) for v in pose7_from_matrix(shape.world_from_box)],
            "size": [round(float(v), 6) for v in shape.size],
            "walls": bool(self.walls.value),
        }
        return json.dumps(content, indent=1) + "\n"

    def _place(self, box: OrientedBox) -> None:
        for node in (self._frame, self._handles):
            move(node, box.world_from_box)

    def _dragged(self) -> None:
        move(self._frame, matrix_of(self._handles))
        self._changed()

    def _update(self) -> None:
        used = bool(self.used.value)
        self._frame.visible, self._handles.visible = used, used and bool(self.drag.value)
        self._draw()
        self._changed()

    def _draw(self) -> None:
        corners = OrientedBox(np.eye(4), np.asarray(self.size.value)).corners()
        self._scene.add_line_segments(
            f"{NAME}/edges", corners[EDGES].astype(np.float32), COLOUR, thickness=0.002
        )
