"""The point cloud that goes into grasp synthesis."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from megrasp_core.errors import CloudError

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points that depth sensors saw, in one frame, in metres.

    points: (N, 3) float64; rows may be NaN (a depth image's holes), see `finite`. colors: (N, 3)
    float64 in 0..1, or None. viewpoint: (3,) where the sensor was, or (N, 3) where each point was
    seen from (several views fused), or None when nobody knows. labels: (N,) int32, which object a
    point belongs to, 0 for none, or None where objects were not told apart.

    Raises CloudError when a shape is wrong.
    """

    points: FloatArray
    colors: FloatArray | None = None
    viewpoint: FloatArray | None = None
    labels: NDArray[np.int32] | None = None

    def __post_init__(self) -> None:
        """Bring the arrays to float64 and check their shapes."""
        points = _numbers(self.points, "points")
        if points.ndim != 2 or points.shape[1] != 3:
            raise CloudError(
                f"points have the shape {points.shape}; expected (N, 3): one row of x, y, z in "
                "metres for each point. Reshape the array."
            )
        object.__setattr__(self, "points", points)
        if self.colors is not None:
            colors = _numbers(self.colors, "colors")
            if colors.shape != points.shape:
                raise CloudError(
                    f"colors have the shape {colors.shape}; expected that of the points, "
                    f"{points.shape}. Give one row of red, green, blue (0 to 1) for each point, "
                    "or none."
                )
            object.__setattr__(self, "colors", colors)
        if self.viewpoint is not None:
            viewpoint = _numbers(self.viewpoint, "viewpoint")
            if viewpoint.shape not in ((3,), points.shape):
                raise CloudError(
                    f"viewpoint has the shape {viewpoint.shape}; expected (3,), the place of the "
                    f"sensor, or {points.shape}, the place from which each point was seen."
                )
            object.__setattr__(self, "viewpoint", viewpoint)
        if self.labels is not None:
            labels = np.asarray(self.labels)
            if labels.shape != points.shape[:1] or labels.dtype.kind not in "iub":
                raise CloudError(
                    f"labels are {labels.dtype} of shape {labels.shape}; expected one whole "
                    f"number for each of the {len(points)} points, 0 where it is no object."
                )
            object.__setattr__(self, "labels", _whole(labels))

    def __len__(self) -> int:
        """Count the points, NaN rows included."""
        return len(self.points)

    def select(self, rows: Any) -> Cloud:
        """Return the cloud of these rows; `rows` is a mask (N,) or an array of indices."""
        per_point = self.viewpoint is not None and self.viewpoint.ndim == 2
        return Cloud(
            self.points[rows],
            None if self.colors is None else self.colors[rows],
            self.viewpoint[rows] if per_point and self.viewpoint is not None else self.viewpoint,
            None if self.labels is None else self.labels[rows],
        )

    def finite(self) -> Cloud:
        """Return the cloud without rows that hold NaN or infinity."""
        good = np.isfinite(self.points).all(axis=1)
        return self if bool(good.all()) else self.select(good)

    def joined(self, other: Cloud) -> Cloud:
        """Return the cloud with the points of another view, or of none; each keeps its sensor.

        Colours and labels stay where both have them; a cloud without labels has 0.
        """
        both = (self, other)
        colors = viewpoint = labels = None
        if all(cloud.colors is not None for cloud in both):
            colors = np.concatenate([np.asarray(cloud.colors) for cloud in both])
        if all(cloud.viewpoint is not None for cloud in both):
            viewpoint = np.concatenate(
                [np.broadcast_to(np.asarray(c.viewpoint), c.points.shape) for c in both]
            )
        if any(cloud.labels is not None for cloud in both):
            labels = np.concatenate(
                [np.zeros(len(c), np.int32) if c.labels is None else c.labels for c in both]
            )
        return Cloud(np.concatenate([c.points for c in both]), colors, viewpoint, labels)

    def moved(self, offset: ArrayLike) -> Cloud:
        """Return the cloud moved by `offset` (3,) metres."""
        by = np.asarray(offset, dtype=np.float64)
        viewpoint = None if self.viewpoint is None else self.viewpoint + by
        return Cloud(self.points + by, self.colors, viewpoint, self.labels)

    def scaled(self, factor: float) -> Cloud:
        """Return the cloud with all lengths times `factor`: 0.001 makes metres of millimetres."""
        viewpoint = None if self.viewpoint is None else factor * self.viewpoint
        return Cloud(factor * self.points, self.colors, viewpoint, self.labels)

    def transformed(self, target_from_cloud: ArrayLike) -> Cloud:
        """Return the same cloud in another frame; `target_from_cloud` is (4, 4) and rigid."""
        matrix = np.asarray(target_from_cloud, dtype=np.float64)
        rotation, translation = matrix[:3, :3], matrix[:3, 3]
        viewpoint = None if self.viewpoint is None else self.viewpoint @ rotation.T + translation
        return Cloud(self.points @ rotation.T + translation, self.colors, viewpoint, self.labels)


def _whole(labels: NDArray) -> NDArray[np.int32]:
    largest = np.iinfo(np.int32).max
    if labels.size and (int(labels.max()) > largest or int(labels.min()) < -largest):
        raise CloudError(
            f"labels go from {labels.min()} to {labels.max()}; expected numbers of objects within "
            f"+-{largest}. Number the objects from 1."
        )
    return labels.astype(np.int32)


def _numbers(values: ArrayLike, what: str) -> FloatArray:
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise CloudError(
            f"{what} are not numbers ({error}); expected an array of floats, metres for points."
        ) from None
