"""Fewer triangles for a surface that stays where it is: quadric decimation, open3d's."""

from __future__ import annotations

import numpy as np

from .mesh import Mesh


def simplified(mesh: Mesh, count: int) -> Mesh:
    """Return the mesh with about `count` triangles at most, itself where it has no more.

    Edges are collapsed where the surface moves least. A closed mesh may come back with a hole or
    an edge of four triangles: whoever needs it closed looks.
    """
    if len(mesh.faces) <= count:
        return mesh
    # Importing open3d takes seconds.
    import open3d

    whole = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(np.ascontiguousarray(mesh.vertices, np.float64)),
        open3d.utility.Vector3iVector(np.ascontiguousarray(mesh.faces, np.int32)),
    )
    fewer = whole.simplify_quadric_decimation(count)
    return Mesh(np.asarray(fewer.vertices), np.asarray(fewer.triangles).astype(np.int64))
