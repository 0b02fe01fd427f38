"""Shapes of PyBullet bodies."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, HalfspaceIntersection

from megrasp_core.meshes import Mesh
from megrasp_core.objects.solids import convex_piece

MARGIN = 0.001
"""PyBullet puts so much (m) around the hulls of a file."""


def convex_shape(engine: Any, pieces: Sequence[Mesh]) -> int:
    """Collision shape of the convex hulls of some meshes.

    PyBullet takes several only from a file, each of whose groups becomes a hull with a margin, by
    which the hulls are shrunk before.
    """
    lines, first = [], 1
    for number, piece in enumerate(pieces):
        vertices, faces = convex_piece(shrunk(piece.vertices, MARGIN))
        lines.append(f"o piece_{number}")
        lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices]
        lines += [f"f {a} {b} {c}" for a, b, c in np.asarray(faces) + first]
        first += len(vertices)
    # PyBullet remembers files by their names, so that no name may come twice.
    with tempfile.TemporaryDirectory(prefix="megrasp_shape_") as folder:
        path = Path(folder) / "pieces.obj"
        path.write_text("\n".join(lines) + "\n")
        return engine.createCollisionShape(engine.GEOM_MESH, fileName=str(path))


def visible_shape(engine: Any, mesh: Mesh, colour: Sequence[float]) -> int:
    """Visual shape of a mesh in a colour (3,)."""
    # Of its own corners for each triangle: the renderer shades by the normals of vertices.
    corners = mesh.vertices[np.asarray(mesh.faces)]
    cross = mesh.crosses()
    normals = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-12)
    return engine.createVisualShape(
        engine.GEOM_MESH,
        vertices=corners.reshape(-1, 3).tolist(),
        indices=list(range(3 * len(corners))),
        normals=np.repeat(normals, 3, axis=0).tolist(),
        rgbaColor=[*colour, 1.0],
    )


def shrunk(points: NDArray[np.float64], margin: float) -> NDArray[np.float64]:
    """Corners of the convex hull of points (N, 3) with all faces moved inwards by `margin` (m), or
    by 0.8 of the radius of the largest ball in it where that is less.
    """
    equations = np.unique(ConvexHull(points).equations.round(9), axis=0)
    # The middle of that ball, as far as it can be from all faces.
    rows = np.column_stack([equations[:, :3], np.ones(len(equations))])
    ball = linprog(
        [0.0, 0.0, 0.0, -1.0],
        A_ub=rows,
        b_ub=-equations[:, 3],
        bounds=[(None, None)] * 3 + [(0.0, None)],
    )
    equations[:, 3] += min(margin, 0.8 * float(ball.x[3]))
    return HalfspaceIntersection(equations, ball.x[:3]).intersections
