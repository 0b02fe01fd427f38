"""Start collisions: how deep the open gripper is in the scene at a pre-grasp or before."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from .assembly import GRIPPER_CONTYPE
from .hand import HandPosture
from .world import GRIPPER, World

START_DEPTH = 0.001
"""Deepest penetration (m) of the open gripper that still counts as free."""


def start_depths(
    world: World, world_from_gripper: NDArray[np.float64], *, posture: HandPosture = "open"
) -> NDArray[np.float64]:
    """Deepest penetration (m) of the open gripper with anything at each pose (n, 4, 4): (n,).

    The world is left as it was. Contacts among the objects are switched off meanwhile, which is
    what makes thousands of poses a second possible in a heap.
    """
    saved = world.save()
    depths = np.zeros(len(world_from_gripper))
    with _gripper_contacts_only(world):
        for index, pose in enumerate(world_from_gripper):
            world.place_gripper(pose, posture)
            depths[index] = world.gripper_depth()
    world.restore(saved)
    return depths


def start_contacts(
    world: World, world_from_gripper: NDArray[np.float64]
) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Penetrations (k,) (m) and places (k, 3) (m, world) of the open gripper's contacts at each
    pose (n, 4, 4); otherwise as `start_depths`.
    """
    saved = world.save()
    found = []
    with _gripper_contacts_only(world):
        for pose in world_from_gripper:
            world.place_gripper(pose, "open")
            world.detect_contacts()
            found.append(world.gripper_contacts())
    world.restore(saved)
    return found


@contextmanager
def _gripper_contacts_only(world: World) -> Iterator[None]:
    """Let objects and support touch nothing but the gripper."""
    model = world.model
    geoms = np.flatnonzero(world.owner != GRIPPER)
    bodies = np.unique(model.geom_bodyid[geoms])
    fields = (
        (model.geom_contype, geoms, 0),
        (model.body_contype, bodies, 0),
        (model.geom_conaffinity, geoms, GRIPPER_CONTYPE),
        (model.body_conaffinity, bodies, GRIPPER_CONTYPE),
    )
    kept = [array[index].copy() for array, index, _ in fields]
    try:
        for array, index, mask in fields:
            array[index] &= mask
        yield
    finally:
        for (array, index, _), values in zip(fields, kept):
            array[index] = values


def approach_path(
    approach: NDArray[np.float64], world_from_gripper: NDArray[np.float64], count: int = 10
) -> NDArray[np.float64]:
    """`count` poses from the approach pose towards the pre-grasp, which itself is left out;
    (count, 4, 4).
    """
    shares = np.arange(count) / count
    path = np.tile(np.eye(4), (count, 1, 1))
    ends = Rotation.from_matrix(np.stack([approach[:3, :3], world_from_gripper[:3, :3]]))
    path[:, :3, :3] = Slerp([0.0, 1.0], ends)(shares).as_matrix()
    path[:, :3, 3] = approach[:3, 3] + shares[:, None] * (
        world_from_gripper[:3, 3] - approach[:3, 3]
    )
    return path
