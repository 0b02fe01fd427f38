"""The moving parts of a model: palm, branches that hang from it, joints above it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import DescriptionError
from megrasp_core.grippers import BodyMesh, body_meshes
from megrasp_core.meshes import sample_stratified

SPACING = 0.0018
"""Mean distance of surface points (m): well below the cells that pads are measured in."""

FEWEST, MOST = 200, 6000
"""Points of one link."""


@dataclass(frozen=True)
class Branch:
    """What hangs from the palm by one joint or more.

    `bodies`: all of it. `chain`: joints from the palm to its tip, in this order. `tip`: bodies of
    the rigid part that reaches farthest. `reach`: how far (m) it gets from the palm's middle.
    """

    root: int
    bodies: tuple[int, ...]
    chain: tuple[int, ...]
    tip: tuple[int, ...]
    reach: float


@dataclass(frozen=True)
class Mechanism:
    """Structure of a compiled model (see `find_mechanism`).

    `palm`: bodies of the rigid part that the fingers hang from. `above`: joints between the
    model's root and the palm. `branches`: longest first. `points` (N, 3): surface points in the
    frames of their bodies `owner` (N,).
    """

    model: mujoco.MjModel
    palm: tuple[int, ...]
    above: tuple[int, ...]
    branches: tuple[Branch, ...]
    points: NDArray[np.float64]
    owner: NDArray[np.int64]

    def surface(
        self, poses: NDArray[np.float64], bodies: tuple[int, ...] | list[int]
    ) -> NDArray[np.float64]:
        """Return the surface points (M, 3) of some bodies in the model frame."""
        chosen = np.isin(self.owner, bodies)
        pose = poses[self.owner[chosen]]
        return np.einsum("nij,nj->ni", pose[:, :3, :3], self.points[chosen]) + pose[:, :3, 3]


def rigid_parts(model: mujoco.MjModel) -> dict[int, list[int]]:
    """Return rigid part (its topmost body's id, 0 for what does not move) -> its bodies."""
    parts: dict[int, list[int]] = {0: []}
    for body in range(model.nbody):
        parts.setdefault(int(model.body_weldid[body]), []).append(body)
    return parts


def shared_link(model: mujoco.MjModel, roots: Sequence[int], part: Sequence[int]) -> str:
    """Return the lowest body of a rigid part that all of the bodies `roots` hang from."""
    lines = []
    for root in roots:
        line, body = [], int(model.body_parentid[root])
        while body in part and body not in line:
            line.append(body)
            body = int(model.body_parentid[body])
        lines.append(line)
    shared = [body for body in lines[0] if all(body in line for line in lines)]
    return model.body(shared[0] if shared else part[0]).name


def find_mechanism(model: mujoco.MjModel, poses: list[NDArray[np.float64]]) -> Mechanism:
    """Find palm and branches.

    Args:
        model: compiled model with at least one joint.
        poses: model_from_body (nbody, 4, 4) of a few postures all over the joints' ranges.

    Raises:
        DescriptionError: nothing that moves has a surface.
    """
    points, owner = sample_surface(model)
    parts = rigid_parts(model)
    solid = set(owner.tolist())
    children = _children(model, parts, solid)
    palm = 0
    above: list[int] = []
    while len(children[palm]) == 1 and children[children[palm][0]]:
        palm = children[palm][0]
        above += _joints_of(model, palm)
    if not children[palm]:
        raise DescriptionError(
            f"none of the {model.njnt} moving joints carries a link with a shape; expected "
            "fingers with visual or collision geometry"
        )
    palm_bodies = tuple(parts[palm])
    mechanism = Mechanism(model, palm_bodies, tuple(above), (), points, owner)
    with_shape = [b for b in palm_bodies if b in solid] or [palm_bodies[0]]
    centres = [_centre(mechanism, pose, with_shape) for pose in poses]
    branches = [_branch(mechanism, parts, child, poses, centres) for child in children[palm]]
    branches.sort(key=lambda branch: -branch.reach)
    return Mechanism(model, palm_bodies, tuple(above), tuple(branches), points, owner)


def palm_centre(mechanism: Mechanism, poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the middle (3,) of the palm's bounding box in the model frame."""
    return _centre(mechanism, poses, list(mechanism.palm))


def sample_surface(model: mujoco.MjModel) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return points (N, 3) in body frames and bodies (N,), evenly over each body's surface.

    Collision geometry where a body has it (that is what touches), else the visual one.
    """
    solid = body_meshes(model, "collision")
    owners = {mesh.body for mesh in solid}
    shown = [mesh for mesh in body_meshes(model, "visual") if mesh.body not in owners]
    points, owner = [np.zeros((0, 3))], [np.zeros(0, np.int64)]
    by_body: dict[int, list[BodyMesh]] = {}
    for mesh in [*solid, *shown]:
        by_body.setdefault(mesh.body, []).append(mesh)
    for body, meshes in by_body.items():
        area = sum(one.mesh.area for one in meshes)
        count = int(np.clip(area / SPACING**2, FEWEST, MOST))
        sample = sample_stratified([one.mesh for one in meshes], count, seed=body)
        corners = np.concatenate([one.mesh.vertices for one in meshes])
        # Corners too: an area draw never reaches the very end of a link.
        corners = corners[:: max(1, len(corners) // 200)]
        points.append(np.concatenate([sample.points, corners]))
        owner.append(np.full(len(points[-1]), body, np.int64))
    return np.concatenate(points), np.concatenate(owner)


def _children(
    model: mujoco.MjModel, parts: dict[int, list[int]], solid: set[int]
) -> dict[int, list[int]]:
    """Return rigid part -> the parts that hang from it and have a shape somewhere below."""
    shaped = {part for part, bodies in parts.items() if solid & set(bodies)}
    for part in sorted(parts, reverse=True):
        if part in shaped and part != 0:
            shaped.add(_parent(model, part))
    out: dict[int, list[int]] = {part: [] for part in parts}
    for part in sorted(parts):
        if part != 0 and part in shaped:
            out[_parent(model, part)].append(part)
    return out


def _parent(model: mujoco.MjModel, part: int) -> int:
    return int(model.body_weldid[model.body_parentid[part]])


def _joints_of(model: mujoco.MjModel, body: int) -> list[int]:
    first = int(model.body_jntadr[body])
    return list(range(first, first + int(model.body_jntnum[body]))) if first >= 0 else []


def _branch(
    mechanism: Mechanism,
    parts: dict[int, list[int]],
    root: int,
    poses: list[NDArray[np.float64]],
    centres: list[NDArray[np.float64]],
) -> Branch:
    model = mechanism.model
    below = [root]
    for body in range(root + 1, model.nbody):
        if int(model.body_parentid[body]) in below:
            below.append(body)
    own = {part: bodies for part, bodies in parts.items() if part in below}
    reaches = {}
    for part, bodies in own.items():
        if not np.isin(mechanism.owner, bodies).any():
            continue
        reaches[part] = max(
            float(np.linalg.norm(mechanism.surface(pose, bodies) - centre, axis=1).max())
            for pose, centre in zip(poses, centres, strict=True)
        )
    tip = max(reaches, key=lambda part: reaches[part])
    chain: list[int] = []
    part = tip
    while part != root:
        chain = _joints_of(model, part) + chain
        part = _parent(model, part)
    chain = _joints_of(model, root) + chain
    return Branch(root, tuple(below), tuple(chain), tuple(own[tip]), reaches[tip])


def _centre(
    mechanism: Mechanism, poses: NDArray[np.float64], bodies: list[int]
) -> NDArray[np.float64]:
    points = mechanism.surface(poses, bodies)
    if not len(points):
        return poses[bodies[0], :3, 3]
    return (points.min(axis=0) + points.max(axis=0)) / 2.0
