"""Fewer triangles for a surface that stays where it is: quadric decimation, open3d's."""

from __future__ import annotations

import numpy as np

from megrasp_core.errors import MissingPackageError

from .mesh import Mesh


def simplified(mesh: Mesh, count: int) -> Mesh:
    """Return the mesh with about `count` triangles at most, itself where it has no more.

    Edges are collapsed where the surface moves least. A closed mesh may come back with a hole or
    an edge of four triangles: whoever needs it closed looks.

    Raises:
        MissingPackageError: open3d is not installed.
    """
    if len(mesh.faces) <= count:
        return mesh
    # Importing open3d takes seconds, and few meshes have so many triangles.
    try:
        import open3d
    except ModuleNotFoundError as error:
        raise MissingPackageError("open3d", "data", "fewer triangles") from error

    whole = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(np.ascontiguousarray(mesh.vertices, np.float64)),
        open3d.utility.Vector3iVector(np.ascontiguousarray(mesh.faces, np.int32)),
    )
    fewer = whole.simplify_quadric_decimation(count)
    return Mesh(np.asarray(fewer.vertices), np.asarray(fewer.triangles).astype(np.int64))
