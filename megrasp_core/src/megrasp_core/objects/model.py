"""An object to grasp: what the camera sees of it, what touches, and how heavy it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import ObjectError
from megrasp_core.meshes import Mesh

FloatArray = NDArray[np.float64]
FaceArray = NDArray[np.int32]

DEFAULT_FRICTION = (0.8, 0.01)
DEFAULT_COLOUR = (0.6, 0.6, 0.6)


class ConvexPiece(NamedTuple):
    """One convex part of the collision model: vertices (V, 3) in metres, faces (F, 3)."""

    vertices: FloatArray
    faces: FaceArray


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """A rigid object in its own frame, whose origin is its centre of mass. Metres, kilograms.

    name: relative path in its object set. vertices (V, 3) and faces (F, 3): the visual surface.
    pieces: convex parts whose union is the collision model. mass (kg); inertia (3, 3) about the
    centre of mass (kg m2); colour (3,) red, green, blue in 0..1; friction: sliding and torsional
    coefficient; category: the kind or set.

    Raises ObjectError when a shape is wrong, an index is out of range or mass and inertia are not
    physical.
    """

    name: str
    vertices: FloatArray
    faces: FaceArray
    pieces: tuple[ConvexPiece, ...]
    mass: float
    inertia: FloatArray
    colour: tuple[float, float, float] = DEFAULT_COLOUR
    friction: tuple[float, float] = DEFAULT_FRICTION
    category: str = ""

    def __post_init__(self) -> None:
        """Bring the arrays to their types and check them."""
        vertices, faces = _mesh(self.name, "visual mesh", self.vertices, self.faces)
        if not self.pieces:
            raise ObjectError(f"object {self.name!r} has no convex piece; expected at least one.")
        pieces = tuple(
            ConvexPiece(*_mesh(self.name, f"piece {i}", piece[0], piece[1]))
            for i, piece in enumerate(self.pieces)
        )
        inertia = np.asarray(self.inertia, dtype=np.float64)
        if not np.isfinite(self.mass) or self.mass <= 0:
            raise ObjectError(
                f"object {self.name!r} has the mass {self.mass}; expected kilograms over 0."
            )
        if (
            inertia.shape != (3, 3)
            or not np.isfinite(inertia).all()
            or (np.linalg.eigvalsh(inertia) <= 0).any()
        ):
            raise ObjectError(
                f"object {self.name!r} has the inertia {inertia.tolist()}; expected a positive "
                "definite (3, 3) matrix in kg m2."
            )
        for field, value in (
            ("vertices", vertices),
            ("faces", faces),
            ("pieces", pieces),
            ("inertia", inertia),
        ):
            object.__setattr__(self, field, value)

    @property
    def mesh(self) -> Mesh:
        """The visual surface."""
        return Mesh(self.vertices, self.faces)

    @property
    def bounds(self) -> FloatArray:
        """(2, 3) least and greatest coordinates of the visual mesh."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    @property
    def extents(self) -> FloatArray:
        """(3,) edges of the visual mesh's axis-aligned box."""
        low, high = self.bounds
        return high - low

    @property
    def radius(self) -> float:
        """Greatest distance of a vertex from the centre of mass (m)."""
        return float(np.linalg.norm(self.vertices, axis=1).max())


def _mesh(name: str, what: str, vertices: Any, faces: Any) -> tuple[FloatArray, FaceArray]:
    points = np.asarray(vertices, dtype=np.float64)
    corners = np.asarray(faces)
    if (
        points.ndim != 2
        or points.shape[1] != 3
        or len(points) < 4
        or not np.isfinite(points).all()
    ):
        raise ObjectError(
            f"object {name!r}: the vertices of its {what} have the shape {points.shape} or are "
            "not finite; expected at least four rows of x, y, z in metres."
        )
    if corners.ndim != 2 or corners.shape[1] != 3 or len(corners) < 4:
        raise ObjectError(
            f"object {name!r}: the faces of its {what} have the shape {corners.shape}; expected "
            "at least four triangles (F, 3)."
        )
    if corners.min() < 0 or corners.max() >= len(points):
        raise ObjectError(
            f"object {name!r}: a face of its {what} names vertex {int(corners.max())} of "
            f"{len(points)}; expected indices from 0."
        )
    return points, corners.astype(np.int32)
