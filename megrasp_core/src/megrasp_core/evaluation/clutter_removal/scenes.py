"""How the objects come to lie on the table: packed, upright side by side, or dropped in a pile."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from megrasp_core.errors import InvalidRequestError, SimulationError
from megrasp_core.objects import ObjectModel

from .world import EDGE, FENCE, ClutterWorld, come_to_rest, take_out_lost

SceneName = Literal["packed", "pile"]

PACKED_REACH = 0.07
"""Packed objects stand up to this far from the middle, in x and in y (m)."""
GAP = 0.004
"""Between packed objects, at least (m)."""
PILE_REACH = 0.04
"""Objects of a pile are dropped up to this far from the middle, in x and in y (m)."""
DROP = 0.02
"""From so far above the pile (m)."""
LEAN = np.cos(np.deg2rad(15.0))
"""A packed object stands as long as its z axis points up within 15 degrees."""
FOOT_BAND, FOOT_MARGIN = 0.002, 0.004
"""Of an upright object what is this low (m) is its foot; its centre of mass must be over it by
this much (m)."""

DRAWS = 300
"""Of large objects few fit side by side, so that many draws end before anything is simulated."""

Rng = np.random.Generator
MakeWorld = Callable[[Sequence[ObjectModel]], ClutterWorld]


def make_scene(
    name: SceneName, pool: Sequence[ObjectModel], count: int, make: MakeWorld, seed: Sequence[int]
) -> ClutterWorld:
    """Draw `count` objects and lay them on the table; the same arguments give the same scene on
    one machine.

    A draw in which objects fall over, get lost or do not come to rest is replaced by the next.

    Args:
        name: packed or pile.
        pool: what objects are drawn from, without repetition.
        count: of objects.
        make: makes the world of some objects.
        seed: of everything drawn.

    Raises:
        InvalidRequestError: there are too few objects.
        SimulationError: no draw of many succeeds.
    """
    usable = [model for model in pool if name == "pile" or stands(model)]
    if len(usable) < count:
        what = "that stand upright " if name == "packed" else ""
        raise InvalidRequestError(
            f"{len(usable)} objects {what}were given; expected at least {count}. Give another "
            "--objects folder."
        )
    for attempt in range(DRAWS):
        rng = np.random.default_rng([*seed, attempt])
        models = [usable[i] for i in rng.choice(len(usable), count, replace=False)]
        places = packed_poses(models, rng) if name == "packed" else [None] * count
        if places is None:
            continue
        world = make(models)
        if _laid_out(world, places, rng):
            return world
        world.close()
    raise SimulationError(
        f"no {name} scene of {count} of the {len(usable)} objects came to rest in {DRAWS} draws "
        f"of seed {list(seed)}. Give smaller objects."
    )


def _laid_out(world: ClutterWorld, places: Sequence[NDArray[np.float64] | None], rng: Rng) -> bool:
    """Put the objects in; those without a place are dropped, one after another."""
    dropped = places[0] is None
    world.fence(dropped)
    for index, place in enumerate(places):
        world.place(index, _drop_pose(world, index, rng) if place is None else place)
        if place is None:
            world.run(1.0)
    if dropped:
        come_to_rest(world)
        world.fence(False)
    at_rest = come_to_rest(world)
    if not at_rest or take_out_lost(world):
        return False
    return dropped or bool((world.poses()[:, 2, 2] > LEAN).all())


def packed_poses(models: Sequence[ObjectModel], rng: Rng) -> list[NDArray[np.float64]] | None:
    """Upright poses world_from_object (4, 4), turned about z at random, whose bounding boxes do
    not meet; None where no place is found for an object in 100 draws.
    """
    poses: list[NDArray[np.float64]] = []
    outlines: list[NDArray[np.float64]] = []
    for model in models:
        low, high = model.bounds
        corners = np.array(
            [[x, y] for x, y in ((low[0], low[1]), (high[0], low[1]), high[:2], (low[0], high[1]))]
        )
        for _ in range(100):
            turn = Rotation.from_euler("z", rng.uniform(0.0, 2.0 * np.pi)).as_matrix()
            place = rng.uniform(-PACKED_REACH, PACKED_REACH, 2)
            outline = corners @ turn[:2, :2].T
            outline += place - outline.mean(axis=0)
            inside = (np.abs(outline) < EDGE / 2).all()
            if inside and all(_apart(outline, other, GAP) for other in outlines):
                break
        else:
            return None
        pose = np.eye(4)
        pose[:3, :3] = turn
        pose[:2, 3] = place - turn[:2, :2] @ ((low[:2] + high[:2]) / 2)
        pose[2, 3] = 0.0005 - low[2]
        poses.append(pose)
        outlines.append(outline)
    return poses


def stands(model: ObjectModel) -> bool:
    """Whether an object with its z axis up has a foot under its centre of mass."""
    vertices = np.concatenate([points for points, _ in model.pieces])
    foot = vertices[vertices[:, 2] < vertices[:, 2].min() + FOOT_BAND, :2]
    try:
        hull = ConvexHull(foot)
    except (QhullError, ValueError):
        # A point or a line.
        return False
    # Offsets of the outward lines: the distance of the origin to each, below 0 inside.
    return bool((hull.equations[:, 2] < -FOOT_MARGIN).all())


def _apart(one: NDArray[np.float64], other: NDArray[np.float64], gap: float) -> bool:
    """Whether two rectangles, corners (4, 2) in order, have a line between them."""
    for box in (one, other):
        for edge in (box[1] - box[0], box[2] - box[1]):
            axis = edge / np.linalg.norm(edge)
            a, b = one @ axis, other @ axis
            if a.max() + gap < b.min() or b.max() + gap < a.min():
                return True
    return False


def _drop_pose(world: ClutterWorld, index: int, rng: Rng) -> NDArray[np.float64]:
    """Any orientation, near the middle, above all that lies there."""
    poses, top = world.poses(), 0.0
    for other in world.present:
        top = max(top, float((poses[other] @ _homogeneous(world.objects[other]))[2].max()))
    pose = np.eye(4)
    for _ in range(20):
        pose[:3, :3] = Rotation.from_quat(rng.standard_normal(4)).as_matrix()
        turned = (pose @ _homogeneous(world.objects[index]))[:3]
        low, high = turned.min(axis=1), turned.max(axis=1)
        room = FENCE / 2 - 0.005 - np.maximum(high, -low)[:2]
        if (room > 0).all():
            break
    pose[:2, 3] = rng.uniform(-1.0, 1.0, 2) * np.clip(room, 0.0, PILE_REACH)
    pose[2, 3] = top + DROP - low[2]
    return pose


def _homogeneous(model: ObjectModel) -> NDArray[np.float64]:
    vertices = np.concatenate([points for points, _ in model.pieces])
    return np.column_stack([vertices, np.ones(len(vertices))]).T
