"""Points of a gripper that the check moves through the scene, and the space that its fingers
sweep.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from megrasp_core.ranges import COUNT, LENGTH, POSITIVE, Range, check_ranges

from .distance_field import DistanceField

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper, Stroke

__all__ = [
    "ClosingPath",
    "ClosingVolume",
    "GripperProbe",
    "ProbeSettings",
    "gripper_probe",
]

CLOUD_SIZES = (1024, 4096)
NEARLY_CLOSED = 0.9
"""No grasp starts from this share of the stroke or later."""


@dataclass(frozen=True)
class ProbeSettings:
    """How densely a gripper is probed.

    Attributes:
        spacing: spacing of the points on the open gripper's collision surface (m).
        near: points nearer to the TCP than this are kept at full density (m), the others thinned
            to a grid of `far_spacing`.
        far_spacing: grid further away (m).
        approach_spacing: grid of the points that are moved along the approach (m).
        finger_spacing: grid of the points that are moved along while the fingers close (m).
        clearance_range: clearances are measured up to here (m).
        seed: of the gripper's clouds.
        narrower: openings that a grasp may start from besides the full one, as shares of it.
        narrower_grid: of the distances to a gripper that is less than fully open (m).
    """

    spacing: float = 0.005
    near: float = 0.06
    far_spacing: float = 0.010
    approach_spacing: float = 0.012
    finger_spacing: float = 0.008
    clearance_range: float = 0.02
    seed: int = 0
    narrower: tuple[float, ...] = (0.7, 0.45, 0.25)
    narrower_grid: float = 0.006

    def __post_init__(self) -> None:
        check_ranges(
            self,
            spacing=POSITIVE,
            near=LENGTH,
            far_spacing=POSITIVE,
            approach_spacing=POSITIVE,
            finger_spacing=POSITIVE,
            clearance_range=POSITIVE,
            seed=COUNT,
            narrower=Range(above=0, below=1, several=True),
            narrower_grid=POSITIVE,
        )


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
class ClosingPath:
    """Where the fingers go when they close on nothing: S postures from open to closed.

    Attributes:
        shares: (S,) of the way of the command, 0 open to 1 closed.
        widths: (S,) between the pads (m), falling.
        points: (S, P, 3) float32, surface of the fingers, gripper frame.
    """

    shares: np.ndarray
    widths: np.ndarray
    points: np.ndarray

    def share_at(self, width: np.ndarray) -> np.ndarray:
        """Share of the way at which the pads are `width` (...) (m) apart."""
        return np.interp(-np.asarray(width), -self.widths, self.shares)

    def points_at(self, share: np.ndarray) -> np.ndarray:
        """Points (..., P, 3) at shares (...) of the way, linear between the known postures."""
        place = np.interp(share, self.shares, np.arange(len(self.shares)))
        first = np.minimum(place.astype(np.int64), len(self.shares) - 2)
        part = (place - first).astype(np.float32)[..., None, None]
        return (1 - part) * self.points[first] + part * self.points[first + 1]


@dataclass(frozen=True)
class GripperProbe:
    """What the check needs of a gripper; made once per gripper (`gripper_probe`), all in the
    gripper frame.

    Attributes:
        points: (M, 3) float32, open posture, or that of `share`.
        approach_points: (m, 3) float32, coarse subset for the approach path.
        field: distance to the open gripper, up to the clearance range.
        tcp: (3,) tool centre point.
        volume: space between the open fingers, None where the fingers do not close towards each
            other.
        max_width: opening (m), None for hands.
        symmetry: n-fold about +Z through the TCP.
        name: of the gripper.
        opening: between the pads before closing (m); NaN for hands.
        share: of the way from open to closed at which it starts.
        narrower: the same gripper less open, widest first; none for hands.
        closing: the way of the fingers; None for hands.
    """

    points: np.ndarray
    approach_points: np.ndarray
    field: DistanceField
    tcp: np.ndarray
    volume: ClosingVolume | None
    max_width: float | None
    symmetry: int
    name: str
    opening: float = float("nan")
    share: float = 0.0
    narrower: tuple[GripperProbe, ...] = ()
    closing: ClosingPath | None = None


def gripper_probe(gripper: Gripper, settings: ProbeSettings | None = None) -> GripperProbe:
    """Sample the gripper, open and on its way to closed, and find the volume between its fingers.

    Args:
        gripper: a loaded gripper.
        settings: see `ProbeSettings`.
    """
    s = settings or ProbeSettings()
    tcp = np.asarray(gripper.tcp, dtype=np.float64)
    points, groups = gripper.collision_points(spacing=s.spacing)
    bodies = gripper.collision_bodies(spacing=s.spacing)
    near = np.linalg.norm(points - tcp, axis=1) < s.near
    dense, _ = gripper.collision_points(spacing=0.003)
    pads = _pads_of(gripper, s.seed)
    whole = _thinner_far_away(points, near, s)
    probe = GripperProbe(
        points=whole,
        approach_points=one_per_cell(whole, s.approach_spacing),
        field=DistanceField.around(dense, s.clearance_range),
        tcp=tcp,
        volume=None if pads is None else pads.volume(tcp),
        max_width=gripper.description.max_width,
        symmetry=int(gripper.description.symmetry),
        name=gripper.name,
    )
    if pads is None or gripper.description.max_width is None:
        return probe
    stroke = gripper.stroke
    on_the_way = [pads.at(stroke, index) for index in range(len(stroke.shares))]
    widths = np.minimum.accumulate([max(one.gap, 0.0) for one in on_the_way])
    moved = stroke.moved(points, bodies)
    fingers = np.flatnonzero(groups >= 0)
    fingers = fingers[_thin_rows(points[fingers], s.finger_spacing)]
    narrower = []
    for index in dict.fromkeys(int(np.argmin(np.abs(widths - w * widths[0]))) for w in s.narrower):
        volume = on_the_way[index].volume(tcp)
        if index == 0 or stroke.shares[index] > NEARLY_CLOSED or volume is None:
            continue
        whole = _thinner_far_away(moved[index], near, s)
        dense_there = stroke.moved(dense, gripper.collision_bodies(spacing=0.003))[index]
        narrower.append(
            replace(
                probe,
                points=whole,
                approach_points=one_per_cell(whole, s.approach_spacing),
                field=DistanceField.around(dense_there, s.clearance_range, s.narrower_grid),
                volume=volume,
                opening=float(widths[index]),
                share=float(stroke.shares[index]),
            )
        )
    return replace(
        probe,
        opening=float(widths[0]),
        narrower=tuple(narrower),
        closing=ClosingPath(stroke.shares, widths, moved[:, fingers].astype(np.float32)),
    )


def _thinner_far_away(points: np.ndarray, near: np.ndarray, s: ProbeSettings) -> np.ndarray:
    points = np.asarray(points, dtype=np.float32)
    return np.concatenate([points[near], one_per_cell(points[~near], s.far_spacing)])


@dataclass(frozen=True)
class _Pads:
    """The faces that close towards each other, in one posture: points (P, 3), the bodies (P,) that
    they are on, how far each still goes when the fingers close on nothing (P, 3), the indices of
    all inward faces, and of those beside the TCP on -X and +X.
    """

    points: np.ndarray
    bodies: np.ndarray
    displacement: np.ndarray
    inward: np.ndarray
    left: np.ndarray
    right: np.ndarray

    @property
    def gap(self) -> float:
        """Between the pads along X (m)."""
        x = self.points[:, 0]
        return float(np.median(x[self.right]) - np.median(x[self.left]))

    def at(self, stroke: Stroke, index: int) -> _Pads:
        """The same faces further on the stroke."""
        moved = stroke.moved(self.points, self.bodies)[index]
        return replace(self, points=moved, displacement=self.points + self.displacement - moved)

    def volume(self, tcp: np.ndarray) -> ClosingVolume | None:
        """The box between the pads; None where they touch."""
        left, right = self.points[self.left], self.points[self.right]
        inner_left, inner_right = np.median(left[:, 0]), np.median(right[:, 0])
        if inner_right - inner_left < 2e-3:
            return None
        tip = float(np.percentile(self.points[self.inward, 2], 99))
        y_low = max(np.percentile(left[:, 1], 2), np.percentile(right[:, 1], 2))
        y_high = min(np.percentile(left[:, 1], 98), np.percentile(right[:, 1], 98))
        if y_high - y_low < 4e-3:  # opposing groups beside each other (three fingers): the union
            y_low, y_high = np.percentile(np.concatenate([left, right])[:, 1], [2, 98])
        ahead = 0.5 * float(np.median(self.displacement[self.inward, 2]))
        deepest = max(tip, tip + ahead, float(tcp[2]))
        return ClosingVolume(
            low=np.array([inner_left, y_low, float(tcp[2]) - 0.08]),
            high=np.array([inner_right, y_high, deepest]),
            tip=tip,
        )


def _pads_of(gripper: Gripper, seed: int) -> _Pads | None:
    """Pads of a gripper, from a denser cloud where the first has too few points of a finger: a
    forearm takes most of them.
    """
    tcp = np.asarray(gripper.tcp, dtype=np.float64)
    for count in CLOUD_SIZES:
        clouds = gripper.clouds(count=count, seed=seed)
        pads = _find_pads(
            clouds.open_points, clouds.open_normals, clouds.displacement, tcp, clouds.open_bodies
        )
        if pads is not None and pads.volume(tcp) is not None:
            return pads
    return None


def one_per_cell(points: np.ndarray, spacing: float) -> np.ndarray:
    """One point per occupied cell of a cubic grid of this spacing, the one nearest to its
    middle.
    """
    return points[_thin_rows(points, spacing)]


def _thin_rows(points: np.ndarray, spacing: float) -> np.ndarray:
    if len(points) == 0:
        return np.zeros(0, dtype=np.intp)
    scaled = (points - points.min(axis=0)) / spacing
    cell = scaled.astype(np.int64)
    size = cell.max(axis=0) + 1
    key = (cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]
    order = np.argsort(((scaled - cell - 0.5) ** 2).sum(axis=1))
    _, first = np.unique(key[order], return_index=True)
    return np.sort(order[first])


def _find_pads(
    points: np.ndarray,
    normals: np.ndarray,
    displacement: np.ndarray,
    tcp: np.ndarray,
    bodies: np.ndarray | None = None,
) -> _Pads | None:
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
    left, right = np.flatnonzero(inward & (side > 0)), np.flatnonzero(inward & (side < 0))
    if len(left) < 3 or len(right) < 3:
        return None
    # Only the faces beside the TCP bound the opening: links further up may be closer or wider.
    return _Pads(
        points=points,
        bodies=np.zeros(len(points), dtype=np.int64) if bodies is None else bodies,
        displacement=displacement,
        inward=np.concatenate([left, right]),
        left=_beside(points, left, tcp),
        right=_beside(points, right, tcp),
    )


def _opposite(points: np.ndarray, moving: np.ndarray, tcp: np.ndarray) -> np.ndarray:
    """Which points lie at the TCP's height, within the width of the moving faces."""
    if not moving.any():
        return np.zeros(len(points), bool)
    low, high = np.percentile(points[moving][:, 1], [2, 98])
    across = (points[:, 1] >= low - 0.005) & (points[:, 1] <= high + 0.005)
    return across & (np.abs(points[:, 2] - tcp[2]) < 0.02)


def _beside(points: np.ndarray, rows: np.ndarray, tcp: np.ndarray) -> np.ndarray:
    near = rows[np.abs(points[rows, 2] - tcp[2]) < 0.02]
    return near if len(near) >= 3 else rows
