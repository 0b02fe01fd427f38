"""Points of a gripper that the check moves through the scene, and the space that its fingers
sweep.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .distance_field import DistanceField

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper

__all__ = ["ClosingVolume", "GripperProbe", "ProbeSettings", "closing_volume", "gripper_probe"]


CLOUD_SIZES = (1024, 4096)


@dataclass(frozen=True)
class ProbeSettings:
    """How densely a gripper is probed.

    Attributes:
        spacing: spacing of the points on the open gripper's collision surface (m).
        near: points nearer to the TCP than this are kept at full density (m), the others thinned
            to a grid of `far_spacing`.
        far_spacing: grid further away (m).
        approach_spacing: grid of the points that are moved along the approach (m).
        clearance_range: clearances are measured up to here (m).
        seed: of the gripper's clouds.
    """

    spacing: float = 0.005
    near: float = 0.06
    far_spacing: float = 0.010
    approach_spacing: float = 0.012
    clearance_range: float = 0.02
    seed: int = 0


@dataclass(frozen=True)
class ClosingVolume:
    """Box between the open fingers, in the gripper frame: what lies in it gets between them when
    they close.

    Attributes:
        low: (3,) lower corner. x: inner face of the finger group on -X; y: width of the pads; z:
            from the palm.
        high: (3,) upper corner; z is where the fingertips pass half way through closing.
        tip: z of the open fingertips (m).
    """

    low: np.ndarray
    high: np.ndarray
    tip: float

    @property
    def centre(self) -> float:
        """Middle between the fingers along X (m)."""
        return float(self.low[0] + self.high[0]) / 2


@dataclass(frozen=True)
class GripperProbe:
    """What the check needs of a gripper; made once per gripper (`gripper_probe`), all in the
    gripper frame.

    Attributes:
        points: (M, 3) float32, open posture.
        approach_points: (m, 3) float32, coarse subset for the approach path.
        field: distance to the open gripper, up to the clearance range.
        tcp: (3,) tool centre point.
        volume: space between the open fingers, None where the fingers do not close towards each
            other.
        max_width: opening (m), None for hands.
        symmetry: n-fold about +Z through the TCP.
        name: of the gripper.
    """

    points: np.ndarray
    approach_points: np.ndarray
    field: DistanceField
    tcp: np.ndarray
    volume: ClosingVolume | None
    max_width: float | None
    symmetry: int
    name: str


def gripper_probe(gripper: Gripper, settings: ProbeSettings | None = None) -> GripperProbe:
    """Sample the open gripper and find the volume between its fingers.

    Args:
        gripper: a loaded gripper.
        settings: see `ProbeSettings`.
    """
    s = settings or ProbeSettings()
    tcp = np.asarray(gripper.tcp, dtype=np.float64)
    points, _ = gripper.collision_points(spacing=s.spacing)
    points = np.asarray(points, dtype=np.float32)
    near = np.linalg.norm(points - tcp, axis=1) < s.near
    points = np.concatenate([points[near], thinned(points[~near], s.far_spacing)])
    dense, _ = gripper.collision_points(spacing=0.003)
    return GripperProbe(
        points=points,
        approach_points=thinned(points, s.approach_spacing),
        field=DistanceField.around(dense, s.clearance_range),
        tcp=tcp,
        volume=_volume_of(gripper, s.seed),
        max_width=gripper.description.max_width,
        symmetry=int(gripper.description.symmetry),
        name=gripper.name,
    )


def _volume_of(gripper: Gripper, seed: int) -> ClosingVolume | None:
    """Closing volume of a gripper, from a denser cloud where the first has too few points of a
    finger: a forearm takes most of them.
    """
    for count in CLOUD_SIZES:
        clouds = gripper.clouds(count=count, seed=seed)
        volume = closing_volume(
            clouds.open_points, clouds.open_normals, clouds.displacement, gripper.tcp
        )
        if volume is not None:
            return volume
    return None


def thinned(points: np.ndarray, spacing: float) -> np.ndarray:
    """One point per occupied cell of a cubic grid of this spacing, the one nearest to its
    middle.
    """
    if len(points) == 0:
        return points
    scaled = (points - points.min(axis=0)) / spacing
    cell = scaled.astype(np.int64)
    size = cell.max(axis=0) + 1
    key = (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]
    order = np.argsort(((scaled - cell - 0.5) ** 2).sum(axis=1))
    _, first = np.unique(key[order], return_index=True)
    return points[np.sort(order[first])]


def closing_volume(
    points: np.ndarray, normals: np.ndarray, displacement: np.ndarray, tcp: np.ndarray
) -> ClosingVolume | None:
    """Box between the finger surfaces that face each other along X and move towards each other;
    one of the two sides may stand still.

    Args:
        points: (C, 3) open surface in the gripper frame.
        normals: (C, 3) outward normals.
        displacement: (C, 3) from the open point to the same surface point when closed.
        tcp: (3,) tool centre point.

    Returns:
        The box, or None where one of the two sides has no such surface.
    """
    reach = np.abs(displacement[:, 0]).max(initial=0.0)
    if reach < 1e-3:
        return None
    side = np.sign(tcp[0] - points[:, 0])  # +1: on -X, has to move and to face +X
    facing = side * normals[:, 0] > 0.5
    inward = (side * displacement[:, 0] > 0.25 * reach) & facing
    for own in (side > 0, side < 0):
        if not (inward & own).any():
            # A fixed jaw: what faces the moving one across the TCP.
            inward |= own & facing & _opposite(points, inward, tcp)
    left, right = points[inward & (side > 0)], points[inward & (side < 0)]
    if len(left) < 3 or len(right) < 3:
        return None
    tip = float(np.percentile(np.concatenate([left, right])[:, 2], 99))
    moved = displacement[inward][:, 2]
    # Only the faces beside the TCP bound the opening: links further up may be closer or wider.
    left, right = _beside(left, tcp), _beside(right, tcp)
    faces = np.concatenate([left, right])
    inner_left, inner_right = np.median(left[:, 0]), np.median(right[:, 0])
    if inner_right - inner_left < 2e-3:
        return None
    y_low = max(np.percentile(left[:, 1], 2), np.percentile(right[:, 1], 2))
    y_high = min(np.percentile(left[:, 1], 98), np.percentile(right[:, 1], 98))
    if y_high - y_low < 4e-3:  # opposing groups beside each other (three fingers): take the union
        y_low, y_high = np.percentile(faces[:, 1], [2, 98])
    deepest = max(tip, tip + 0.5 * float(np.median(moved)), float(tcp[2]))
    return ClosingVolume(
        low=np.array([inner_left, y_low, float(tcp[2]) - 0.08]),
        high=np.array([inner_right, y_high, deepest]),
        tip=tip,
    )


def _opposite(points: np.ndarray, moving: np.ndarray, tcp: np.ndarray) -> np.ndarray:
    """Which points lie at the TCP's height, within the width of the moving faces."""
    if not moving.any():
        return np.zeros(len(points), bool)
    low, high = np.percentile(points[moving][:, 1], [2, 98])
    across = (points[:, 1] >= low - 0.005) & (points[:, 1] <= high + 0.005)
    return across & (np.abs(points[:, 2] - tcp[2]) < 0.02)


def _beside(points: np.ndarray, tcp: np.ndarray) -> np.ndarray:
    near = np.abs(points[:, 2] - tcp[2]) < 0.02
    return points[near] if near.sum() >= 3 else points
