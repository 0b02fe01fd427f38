"""One scene of a device pack: a thinned surface in small integers, and its labels."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import DataError
from megrasp_core.pointcloud import SceneNodes, SceneSettings, SurfaceCloud, choose_nodes, nodes_at
from megrasp_core.simulation import Bin

from .records import GripperLabels


@dataclass(frozen=True, eq=False)
class PackedScene:
    """One scene of a pack: a part of its surface, and its labels.

    Attributes:
        name: of the scene in its data set.
        seed: that makes the scene again.
        object_names: names in the object set.
        bin: None for a table.
        gravity: (3,) float32 unit vector in the world frame.
        origin: (3,) float64 world position (m) of the lattice's zero.
        step: of the lattice (m).
        lattice: (K, 3) int16; world position = origin + step * lattice.
        octahedral: (K, 2) int8 unit normals, see `octahedral_normals`.
        on_plane: (K,) bool, points of the support plane.
        inference: the first so many points are the nodes of inference, in their order.
        choice: by which settings the nodes of inference were chosen, see `node_choice`.
        labels: gripper name -> labels.
    """

    name: str
    seed: int
    object_names: tuple[str, ...]
    bin: Bin | None
    gravity: NDArray[np.float32]
    origin: NDArray[np.float64]
    step: float
    lattice: NDArray[np.int16]
    octahedral: NDArray[np.int8]
    on_plane: NDArray[np.bool_]
    inference: int
    choice: dict[str, float]
    labels: dict[str, GripperLabels] = field(default_factory=dict)

    @property
    def points(self) -> NDArray[np.float64]:
        """(K, 3) in the world frame (m)."""
        return self.origin + self.step * self.lattice.astype(np.float64)

    def without_labels(self) -> PackedScene:
        """The scene with its surface alone."""
        return replace(self, labels={})

    def surface_cloud(self) -> SurfaceCloud:
        """The part of the surface that the pack keeps."""
        points = self.points
        return SurfaceCloud(
            points=points,
            normals=octahedral_normals(self.octahedral),
            on_plane=self.on_plane,
            sensor=np.zeros(3),
            gravity=self.gravity.astype(np.float64),
            crop=points,
            region=None,
        )

    def chosen(self, settings: SceneSettings, seed: int = 0) -> NDArray[np.intp]:
        """Which of the K points are nodes: seed 0 gives those of inference, another one as many
        in the same shares, drawn from all.

        Raises:
            DataError: `settings` choose nodes otherwise than those of the pack.
        """
        if node_choice(settings) != self.choice:
            raise DataError(
                f"{self.name} was packed for nodes chosen by {self.choice}; expected "
                f"{node_choice(settings)}. Pack the data set again."
            )
        if not seed:
            return np.arange(self.inference)
        of_plane = int(np.count_nonzero(self.on_plane[: self.inference]))
        counts = (self.inference - of_plane, of_plane)
        return choose_nodes(self.points, self.on_plane, counts, seed)

    def nodes(self, settings: SceneSettings, seed: int = 0) -> SceneNodes:
        """Nodes for the network, see `chosen`."""
        return nodes_at(self.surface_cloud(), self.chosen(settings, seed))


def pack_octahedral(normals: NDArray[np.float64]) -> NDArray[np.int8]:
    """Unit normals (K, 3) -> (K, 2) int8, read by `octahedral_normals`."""
    unfolded = normals / np.maximum(np.abs(normals).sum(axis=1, keepdims=True), 1e-9)
    xy = unfolded[:, :2]
    folded = np.copysign(1.0 - np.abs(xy[:, ::-1]), xy)
    return np.rint(127.0 * np.where(unfolded[:, 2:] < 0, folded, xy)).astype(np.int8)


def octahedral_normals(packed: NDArray[np.int8]) -> NDArray[np.float64]:
    """(K, 2) int8 -> (K, 3) unit normals: [-127, 127]^2 is the octahedron |x| + |y| + |z| = 1
    unfolded, its lower half turned outwards over the edges.
    """
    xy = packed.astype(np.float64) / 127.0
    z = 1.0 - np.abs(xy).sum(axis=1, keepdims=True)
    xy -= np.copysign(np.maximum(-z, 0.0), xy)
    normals = np.hstack([xy, z])
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def node_choice(settings: SceneSettings) -> dict[str, float]:
    """Those of the settings that decide which points of a surface become nodes."""
    return {
        "max_nodes": settings.max_nodes,
        "plane_keep": settings.plane_keep,
        "plane_share": settings.plane_share,
    }
