"""A box in space: the region of interest, a bin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from megrasp_core.errors import InvalidRequestError
from megrasp_core.limits import MAX_EDGE

FloatArray = NDArray[np.float64]

LARGEST = 1e6
"""Longest edge (m)."""
ROOMY = 20.0
"""A region that is so many times as wide as what lies in it may be in other units."""


@dataclass(frozen=True, eq=False)
class OrientedBox:
    """A box: the pose of its centre, world_from_box (4, 4), and its full edges (3,) in metres.

    Raises InvalidRequestError when an edge is not positive or the pose is not a rigid motion.
    """

    world_from_box: FloatArray
    size: FloatArray

    def __post_init__(self) -> None:
        """Bring the fields to float64 and check them."""
        pose = np.asarray(self.world_from_box, dtype=np.float64)
        size = np.asarray(self.size, dtype=np.float64)
        if size.shape != (3,) or not ((size > 0) & (size <= LARGEST)).all():
            raise InvalidRequestError(
                f"box size {size.tolist()} is not usable; expected three full edges over 0, in "
                f"metres, and up to {LARGEST:.0f}."
            )
        rigid = pose.shape == (4, 4) and np.isfinite(pose).all()
        if not rigid or not np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-5):
            raise InvalidRequestError(
                "the box pose is not a rigid motion; expected a (4, 4) matrix world_from_box "
                f"with an orthonormal rotation, got shape {pose.shape}. Normalise the quaternion."
            )
        object.__setattr__(self, "world_from_box", pose)
        object.__setattr__(self, "size", size)

    @staticmethod
    def around(centre: ArrayLike, size: ArrayLike) -> OrientedBox:
        """Return the axis-aligned box with this centre (3,) and these full edges (3,)."""
        pose = np.eye(4)
        pose[:3, 3] = np.asarray(centre, dtype=np.float64)
        return OrientedBox(pose, np.asarray(size, dtype=np.float64))

    @property
    def centre(self) -> FloatArray:
        """(3,) centre in the world."""
        return self.world_from_box[:3, 3]

    @property
    def rotation(self) -> FloatArray:
        """(3, 3) rotation world_from_box; its columns are the directions of the edges."""
        return self.world_from_box[:3, :3]

    def check_units(self) -> None:
        """Refuse a box that nobody can mean in metres; for one that a person gives.

        Raises:
            InvalidRequestError: an edge is longer than `MAX_EDGE`.
        """
        if self.size.max() > MAX_EDGE:
            raise InvalidRequestError(
                f"the region has the size {_shown(self.size)}; expected metres, up to "
                f"{MAX_EDGE:g}. It looks like millimetres: divide size and place by 1000."
            )

    def doubt(self, points: FloatArray) -> str:
        """What seems wrong with the box as a region of these points (N, 3), "" where nothing does:
        it is far wider than those in it.
        """
        inside = points[self.contains(points)]
        if len(inside) < 2:
            return ""
        low, high = np.percentile(self.local(inside), (1, 99), axis=0)
        width = float((high - low).max())
        if self.size.max() <= ROOMY * width:
            return ""
        return (
            f"the region is {_shown(self.size)} m and the points in it are {width:.2g} m wide; "
            "check that it is in metres, and in the frame of the grasps"
        )

    def local(self, points: FloatArray) -> FloatArray:
        """Return world points (N, 3) in the frame of the box, whose origin is its centre."""
        return points @ self.rotation - self.centre @ self.rotation

    def contains(self, points: FloatArray) -> NDArray[np.bool_]:
        """Return (N,), true for points (N, 3) in the box or on its faces; never for NaN."""
        # Infinity times zero gives NaN, which no comparison accepts: what is wanted, without the
        # warning.
        with np.errstate(invalid="ignore"):
            inside = np.abs(self.local(points)) <= self.size / 2
        return inside[:, 0] & inside[:, 1] & inside[:, 2]

    def corners(self) -> FloatArray:
        """Return the eight corners (8, 3) in the world."""
        signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        return signs * (self.size / 2) @ self.rotation.T + self.centre

    def grown(self, margin: float) -> OrientedBox:
        """Return the box with every face moved outwards by `margin` metres."""
        return OrientedBox(self.world_from_box, self.size + 2 * margin)

    def face_towards(self, direction: ArrayLike) -> tuple[int, int]:
        """Return (axis 0..2, sign +-1) of the face that looks most along `direction` (3,)."""
        along = self.rotation.T @ np.asarray(direction, dtype=np.float64)
        axis = int(np.argmax(np.abs(along)))
        return axis, 1 if along[axis] >= 0 else -1

    def extended(self, direction: ArrayLike, by: float) -> OrientedBox:
        """Return the box with the face towards `direction` (3,) moved outwards by `by` metres."""
        axis, sign = self.face_towards(direction)
        size = self.size.copy()
        size[axis] += by
        pose = self.world_from_box.copy()
        pose[:3, 3] += self.rotation[:, axis] * (sign * by / 2)
        return OrientedBox(pose, size)

    def upright(self, up: ArrayLike) -> OrientedBox:
        """Return the same box with its axes in an order and with signs so that the third is the
        one that looks most along `up` (3,).
        """
        axis, sign = self.face_towards(up)
        order = [(axis + 1) % 3, (axis + 2) % 3, axis]
        pose = self.world_from_box.copy()
        pose[:3, :3] = self.rotation[:, order]
        if sign < 0:
            pose[:3, [0, 2]] *= -1.0
        return OrientedBox(pose, self.size[order])

    def transformed(self, target_from_world: ArrayLike) -> OrientedBox:
        """Return the same box in another frame; `target_from_world` is (4, 4) and rigid."""
        return OrientedBox(
            np.asarray(target_from_world, dtype=np.float64) @ self.world_from_box, self.size
        )


def _shown(numbers: FloatArray) -> str:
    return " x ".join(f"{value:.4g}" for value in numbers)
