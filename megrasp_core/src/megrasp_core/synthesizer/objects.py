"""Which object a grasp takes, where the cloud tells objects apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from megrasp_core.errors import InvalidRequestError
from megrasp_core.pointcloud import SurfaceCloud
from megrasp_core.ranking import GripperProbe

__all__ = ["LabelledObjects"]

REACH = 0.03
"""Objects further from the TCP than this are not grasped (m)."""
LOOKED_AT = 64
"""Nearest points that tell which object it is."""


class LabelledObjects:
    """The points of a cloud that belong to objects, and of which object a place is part."""

    def __init__(self, points: NDArray[np.float64], labels: NDArray[np.int32]) -> None:
        """Take points (P, 3) and their labels (P,); 0 is no object."""
        known = labels != 0
        self._labels = labels[known]
        self._tree = KDTree(points[known]) if known.any() else None

    @classmethod
    def of(cls, surface: SurfaceCloud, target: int | None) -> LabelledObjects | None:
        """Those of a surface; None where its cloud has no labels.

        Raises:
            InvalidRequestError: no point has the label `target`; the message lists those there
                are.
        """
        labels = surface.labels
        if target is not None and (labels is None or not (labels == target).any()):
            known = [] if labels is None else np.unique(labels[labels != 0]).tolist()
            there = ", ".join(map(str, known)) or "none"
            raise InvalidRequestError(
                f"target {target} was given, and no point of the cloud in the region has this "
                f"label; expected one of the labels of the mask: {there}."
            )
        return None if labels is None else cls(surface.crop, labels)

    def at(self, places: NDArray[np.float64], reach: float = np.inf) -> NDArray[np.int32]:
        """Label (N,) of the object point nearest to places (N, 3); 0 with none in reach (m)."""
        if self._tree is None:
            return np.zeros(len(places), dtype=np.int32)
        _, index = self._tree.query(places, distance_upper_bound=reach)
        return np.append(self._labels, np.int32(0))[index]

    def grasped(
        self, world_from_gripper: NDArray[np.float64], probe: GripperProbe
    ) -> NDArray[np.int32]:
        """Label (N,) of what most of the points next to the TCP, between the fingers where they
        close along X, belong to; 0 where there are none.

        Args:
            world_from_gripper: (N, 4, 4).
            probe: of the gripper.
        """
        found = np.zeros(len(world_from_gripper), dtype=np.int32)
        if self._tree is None:
            return found
        points = np.asarray(self._tree.data)
        for row, pose in enumerate(world_from_gripper):
            tcp = pose[:3, :3] @ probe.tcp + pose[:3, 3]
            index = np.array(self._tree.query_ball_point(tcp, self._reach(probe)), dtype=np.intp)
            if probe.volume is not None and len(index):
                local = (points[index] - pose[:3, 3]) @ pose[:3, :3]
                between = (local >= probe.volume.low) & (local <= probe.volume.high)
                index = index[between.all(axis=1)]
            if len(index) > LOOKED_AT:
                distance = np.linalg.norm(points[index] - tcp, axis=1)
                index = index[np.argpartition(distance, LOOKED_AT)[:LOOKED_AT]]
            if len(index):
                labels, counts = np.unique(self._labels[index], return_counts=True)
                found[row] = labels[counts.argmax()]
        return found

    @staticmethod
    def _reach(probe: GripperProbe) -> float:
        return max(REACH, 0.0 if probe.volume is None else 0.6 * (probe.max_width or 0.0))
