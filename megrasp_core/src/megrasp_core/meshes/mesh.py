"""Triangle meshes."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Mesh(NamedTuple):
    """Triangles.

    Attributes:
        vertices: (V, 3) m.
        faces: (F, 3) indices of vertices, counter-clockwise seen from outside.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.integer]

    @property
    def area(self) -> float:
        """Of all triangles (m2)."""
        return float(np.linalg.norm(self.crosses(), axis=1).sum()) / 2.0

    def crosses(self) -> NDArray[np.float64]:
        """(F, 3) cross products of two edges: outward, twice the area long."""
        corner = self.vertices[self.faces]
        return np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])

    def moved(self, pose: NDArray[np.float64]) -> Mesh:
        """The mesh taken along by a pose (4, 4)."""
        return Mesh(self.vertices @ pose[:3, :3].T + pose[:3, 3], self.faces)


def joined(meshes: Iterable[Mesh]) -> Mesh:
    """All meshes as one."""
    vertices, faces, start = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)], 0
    for mesh in meshes:
        vertices.append(mesh.vertices)
        faces.append(mesh.faces.astype(np.int64) + start)
        start += len(mesh.vertices)
    return Mesh(np.concatenate(vertices), np.concatenate(faces))
