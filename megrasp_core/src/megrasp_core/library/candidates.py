"""Antipodal grasp candidates on an object: the paper's single sampling strategy.

Two surface points with opposing normals give the closing axis; the approach is drawn around it and
the depth along it. Jaws and three-finger grippers bring their TCP between the points. The fingers
of a hand seldom meet at its TCP or along +X: the middle and the axis of its opposing finger groups
at the width of the pair (finger_span.py) come to lie on the pair's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from megrasp_core.meshes import SurfaceScene, sample_uniform

from .finger_span import FingerSpan, hand_span

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper
    from megrasp_core.objects import ObjectModel

_HAND_WIDTH = 0.10
"""Widest pair taken for a hand (m), though its fingers may open further."""


@dataclass(frozen=True)
class CandidateSettings:
    """How candidates are drawn.

    Attributes:
        friction_cone: largest angle between the closing axis and either normal (rad).
        axis_noise: standard deviation of the axis about the first point's normal (rad).
        width_margin: free width left between open fingers and pair (m).
        least_width: a pair must be this much wider than `min_width` (m).
        depth: range of the TCP's position past the pair along the approach (m); positive is
            deeper.
        shift: largest offset of the TCP from the pair's middle along the closing axis (m).
        hand_depth: as `depth` for hands, from where their fingers meet.
        finger_span: whether hands are brought to the pair where their fingers meet, instead of
            with TCP and +X as jaws are.
    """

    friction_cone: float = np.deg2rad(25.0)
    axis_noise: float = np.deg2rad(8.0)
    width_margin: float = 0.003
    least_width: float = 0.002
    depth: tuple[float, float] = (-0.008, 0.022)
    shift: float = 0.004
    hand_depth: tuple[float, float] = (-0.006, 0.020)
    finger_span: bool = True


@dataclass(frozen=True)
class Candidates:
    """Grasps to try on an object.

    Attributes:
        object_from_gripper: (n, 4, 4) gripper frame at the pre-grasp, in the object frame.
        width: (n,) distance of the two points (m).
    """

    object_from_gripper: NDArray[np.float64]
    width: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.width)


@dataclass(frozen=True)
class Pairs:
    """Opposing surface points: `first`, `second` (n, 3), object frame."""

    first: NDArray[np.float64]
    second: NDArray[np.float64]


class ObjectSurface:
    """Even points and through-rays on an object's visual mesh; build it once per object."""

    def __init__(self, model: ObjectModel) -> None:
        self.mesh = model.mesh
        cross = self.mesh.crosses()
        self.normals = cross / np.maximum(np.linalg.norm(cross, axis=1), 1e-15)[:, None]
        self._scene = SurfaceScene([self.mesh])

    def sample(
        self, count: int, rng: np.random.Generator
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Points (count, 3), uniform over the area, and their face normals (count, 3)."""
        points, triangle = sample_uniform(self.mesh, count, rng)
        return points, self.normals[triangle]

    def crossings(
        self, origins: NDArray[np.float64], directions: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """Every crossing of the rays with the mesh: ray index (k,), distance (k,), face normal (k,
        3).
        """
        ray, distance, triangle = self._scene.crossings(np.hstack([origins, directions]))
        return ray, distance, self.normals[triangle]


def opposing_pairs(
    surface: ObjectSurface,
    tries: int,
    widths: tuple[float, float],
    settings: CandidateSettings,
    rng: np.random.Generator,
) -> Pairs:
    """Point pairs whose normals oppose each other within the friction cone.

    Args:
        surface: the object.
        tries: rays cast; at most one pair each.
        widths: smallest and largest distance of a pair (m).
        settings: cone and noise.
        rng: source of randomness.
    """
    first, normals = surface.sample(tries, rng)
    noise = rng.normal(scale=settings.axis_noise, size=(tries, 3))
    directions = -normals + np.tan(np.clip(noise, -1.0, 1.0))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    cosine = np.cos(settings.friction_cone)
    ray, distance, exit_normal = surface.crossings(first, directions)
    # A through-ray leaves through a face that looks along it; several walls give several such
    # faces.
    good = (
        (np.einsum("ij,ij->i", exit_normal, directions[ray]) >= cosine)
        & (distance >= widths[0])
        & (distance <= widths[1])
        & (-np.einsum("ij,ij->i", normals[ray], directions[ray]) >= cosine)
    )
    ray, distance = ray[good], distance[good]
    order = np.lexsort((distance, ray))
    ray, distance = ray[order], distance[order]
    if len(ray) == 0:
        return Pairs(np.zeros((0, 3)), np.zeros((0, 3)))
    start = np.flatnonzero(np.r_[True, ray[1:] != ray[:-1]])
    hits = np.diff(np.r_[start, len(ray)])
    chosen = start + (rng.random(len(start)) * hits).astype(np.int64)
    origin = first[ray[chosen]]
    return Pairs(origin, origin + directions[ray[chosen]] * distance[chosen, None])


def width_range(gripper: Gripper, settings: CandidateSettings) -> tuple[float, float]:
    """Distances between opposing points that the open gripper takes (m)."""
    description, span = gripper.description, hand_span(gripper)
    widest = description.max_width
    if widest is None:
        widest = _HAND_WIDTH if span is None else min(_HAND_WIDTH, span.widest)
    narrowest = 0.0 if description.min_width is None else description.min_width
    return narrowest + settings.least_width, widest - settings.width_margin


def antipodal(
    model: ObjectModel,
    gripper: Gripper,
    count: int,
    rng: np.random.Generator,
    *,
    settings: CandidateSettings | None = None,
    surface: ObjectSurface | None = None,
    approach_towards: tuple[NDArray[np.float64], float] | None = None,
) -> Candidates:
    """Draws up to `count` grasp candidates; fewer where the object offers too few pairs.

    Args:
        model: the object, visual mesh in the object frame.
        gripper: its width range and TCP are used.
        count: candidates wanted.
        rng: source of randomness.
        settings: cone, depth and margins.
        surface: the object's `ObjectSurface`, where one exists already.
        approach_towards: (unit vector (3,) in the object frame, largest angle): keeps approaches
            within that angle of the vector, for example of gravity; None draws evenly around the
            closing axis.

    Returns:
        Candidates with `object_from_gripper`; both senses of every closing axis occur.
    """
    settings = settings or CandidateSettings()
    surface = surface or ObjectSurface(model)
    span = hand_span(gripper) if settings.finger_span else None
    widths = width_range(gripper, settings)
    found: list[Candidates] = []
    for _ in range(8):
        pairs = opposing_pairs(surface, max(3 * count, 64), widths, settings, rng)
        swap = rng.random(len(pairs.first)) < 0.5
        first = np.where(swap[:, None], pairs.second, pairs.first)
        second = np.where(swap[:, None], pairs.first, pairs.second)
        approach, keep = _approaches(second - first, approach_towards, rng)
        grasps = _poses(
            first[keep], second[keep], approach[keep], gripper, span, widths[1], settings, rng
        )
        if approach_towards is not None:
            direction, limit = approach_towards
            steep = grasps.object_from_gripper[:, :3, 2] @ direction >= np.cos(limit)
            grasps = Candidates(grasps.object_from_gripper[steep], grasps.width[steep])
        found.append(grasps)
        if sum(map(len, found)) >= count:
            break
    return Candidates(
        np.concatenate([part.object_from_gripper for part in found])[:count],
        np.concatenate([part.width for part in found])[:count],
    )


def _approaches(
    closing: NDArray[np.float64],
    towards: tuple[NDArray[np.float64], float] | None,
    rng: np.random.Generator,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Unit approach vectors (n, 3) square to the closing axes, and which of them are allowed."""
    axis = closing / np.maximum(np.linalg.norm(closing, axis=1, keepdims=True), 1e-12)
    drawn = rng.normal(size=axis.shape)
    allowed = np.ones(len(axis), bool)
    if towards is not None:
        direction, limit = np.asarray(towards[0], np.float64), float(towards[1])
        # Tilts are drawn about the direction itself, since even draws around the axis would mostly
        # be refused.
        spread = np.tan(min(limit, 1.4)) * rng.random((len(axis), 1))
        drawn /= np.maximum(np.linalg.norm(drawn, axis=1, keepdims=True), 1e-12)
        drawn = direction + spread * drawn
    approach = drawn - np.einsum("ij,ij->i", drawn, axis)[:, None] * axis
    length = np.linalg.norm(approach, axis=1)
    allowed &= length > 1e-6
    approach /= np.maximum(length, 1e-12)[:, None]
    if towards is not None:
        allowed &= approach @ np.asarray(towards[0], np.float64) >= np.cos(float(towards[1]))
    return approach, allowed


def _poses(
    first: NDArray[np.float64],
    second: NDArray[np.float64],
    approach: NDArray[np.float64],
    gripper: Gripper,
    span: FingerSpan | None,
    widest: float,
    settings: CandidateSettings,
    rng: np.random.Generator,
) -> Candidates:
    count = len(first)
    closing = second - first
    width = np.linalg.norm(closing, axis=1)
    axis = closing / np.maximum(width, 1e-12)[:, None]
    depth = rng.uniform(*(settings.depth if span is None else settings.hand_depth), size=count)
    slack = np.minimum(settings.shift, 0.4 * np.maximum(widest - width, 0.0))
    shift = rng.uniform(-1.0, 1.0, size=count) * slack
    object_from_pinch = np.tile(np.eye(4), (count, 1, 1))
    object_from_pinch[:, :3, :3] = _frames(axis, approach)
    object_from_pinch[:, :3, 3] = (
        0.5 * (first + second) + depth[:, None] * approach + shift[:, None] * axis
    )
    gripper_from_pinch = np.tile(gripper.gripper_from_tcp, (count, 1, 1))
    if span is not None:
        middle, across = span.at(width)
        forward = np.array([0.0, 0.0, 1.0]) - across[:, 2:] * across
        forward /= np.linalg.norm(forward, axis=1, keepdims=True)
        gripper_from_pinch[:, :3, :3] = _frames(across, forward)
        gripper_from_pinch[:, :3, 3] = middle
    return Candidates(object_from_pinch @ np.linalg.inv(gripper_from_pinch), width)


def _frames(x: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotations (n, 3, 3) with columns x (n, 3), z cross x, z (n, 3), which are square to each
    other.
    """
    return np.stack([x, np.cross(z, x), z], axis=2)
