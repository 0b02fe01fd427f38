"""Settles objects one after another into a bin or onto a table.

Dropping many at once leaves deep contacts and interlocked bodies; releasing each just above the
pile does not.
A scene counts only when it rests and nothing is pressed into anything: see `ClutterSettings`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from .assembly import Guard
from .support import Bin
from .world import World, build_world

if TYPE_CHECKING:
    from megrasp_core.objects import ObjectModel


@dataclass(frozen=True)
class ClutterSettings:
    """How objects are released and when a scene is accepted.

    interval: time between two releases, s. drop: gap between the pile and the next object, m.
    heap_radius: on a table, objects are released within this distance of the origin, m.
    table_edge: half edge of the square that a heap on the table must stay in, m.
    calm_speed, calm_turn: fastest object (m/s, rad/s) at which the rest check begins, after
        calm_time s at most.
    rest_time: the check runs this long, and no object may move more than rest_shift (m) and
        rest_angle (rad); it is repeated up to rest_rounds times.
    max_depth: deepest contact allowed, m.
    attempts: whole new draws before a scene that is not ok is returned.
    timestep: s; 4 ms settle twice as fast as the verdict's 2 ms and rest as well there.
    damping: drag (1/s) on speed and, four times as strong, on rotation while objects come to rest,
        so that balls do not roll for ever; it is off during the rest check.
    """

    interval: float = 0.35
    drop: float = 0.005
    heap_radius: float = 0.07
    table_edge: float = 0.30
    calm_speed: float = 0.02
    calm_turn: float = 0.3
    calm_time: float = 3.0
    rest_time: float = 1.5
    rest_shift: float = 0.0015
    rest_angle: float = float(np.deg2rad(4.0))
    rest_rounds: int = 3
    max_depth: float = 0.003
    attempts: int = 3
    timestep: float = 0.004
    damping: float = 1.5


@dataclass(frozen=True, eq=False)
class SettledScene:
    """Objects at rest.

    objects, object_poses (k, 4, 4): the objects that stayed, world frame. kept: their indices in
        what was given.
    ok: at rest, no deep contact, at least one object. depth: deepest contact, m. shift (m), angle
        (rad): largest motion in the last rest check. attempts: draws used.
    """

    objects: tuple[ObjectModel, ...]
    object_poses: NDArray[np.float64]
    kept: tuple[int, ...]
    bin: Bin | None
    ok: bool
    depth: float
    shift: float
    angle: float
    attempts: int

    def world(self, **arguments: Any) -> World:
        """Build a world of this scene; arguments as of `build_world`."""
        return build_world(self.objects, bin=self.bin, object_poses=self.object_poses, **arguments)


def settle(
    objects: Sequence[ObjectModel],
    *,
    bin: Bin | None = None,
    rng: np.random.Generator,
    settings: ClutterSettings | None = None,
    friction: float | None = None,
) -> SettledScene:
    """Release the objects in the order given into the bin, or onto the table without one.

    Objects that leave the bin (centre outside its inner edges) or the table square are dropped
    from the scene. In a tilted bin they settle in its frame, with gravity tilted instead. The same
    objects, generator state and settings give the same scene on one machine; on another processor
    contacts amplify the last bit, to millimetres at times. A scene that fails the checks is drawn
    anew up to `settings.attempts` times; the last one is returned with ok False.
    """
    settings = settings or ClutterSettings()
    area = bin.inner[:2] if bin is not None else (2 * settings.table_edge,) * 2
    guard = Guard((area[0], area[1]), bottom=bin.inner[2] if bin is not None else 0.0)
    world = build_world(
        objects,
        bin=None if bin is None else replace(bin, tilt=(0.0, 0.0)),
        guard=guard,
        friction=friction,
        timestep=settings.timestep,
    )
    world_from_bin = np.eye(4) if bin is None else bin.world_from_bin
    world.model.opt.gravity[:] = world_from_bin[:3, :3].T @ world.model.opt.gravity
    start = world.save()
    scene = None
    for attempt in range(1, max(1, settings.attempts) + 1):
        world.restore(start)
        world.clear_warnings()
        world.set_guard(True)
        scene = _settle_once(world, (area[0], area[1]), rng, settings, attempt)
        if scene.ok:
            break
    assert scene is not None
    return replace(scene, object_poses=world_from_bin @ scene.object_poses, bin=bin)


def _settle_once(
    world: World,
    area: tuple[float, float],
    rng: np.random.Generator,
    settings: ClutterSettings,
    attempt: int,
) -> SettledScene:
    for index in range(len(world.objects)):
        world.place_object(index, _release_pose(world, index, area, rng, settings))
        _step(world, settings.interval)
        park_escaped(world, area)
    world.set_drag(settings.damping)
    _calm(world, settings)
    # Nothing may lean on a wall that will not be there.
    world.set_guard(False)
    _calm(world, settings)
    world.set_drag(0.0)
    shift = angle = np.inf
    for _ in range(settings.rest_rounds):
        park_escaped(world, area)
        shift, angle = rest_check(world, settings.rest_time)
        if shift <= settings.rest_shift and angle <= settings.rest_angle:
            break
        world.set_drag(settings.damping)
        _step(world, settings.rest_time)
        world.set_drag(0.0)
    escaped = park_escaped(world, area)
    depth = deepest_contact(world)
    resting = shift <= settings.rest_shift and angle <= settings.rest_angle and not escaped
    kept = tuple(world.present)
    ok = bool(kept) and resting and depth <= settings.max_depth and not world.unstable()
    return SettledScene(
        objects=tuple(world.objects[i] for i in kept),
        object_poses=world.object_poses()[list(kept)],
        kept=kept,
        bin=world.bin,
        ok=ok,
        depth=depth,
        shift=float(shift),
        angle=float(angle),
        attempts=attempt,
    )


def _release_pose(
    world: World,
    index: int,
    area: tuple[float, float],
    rng: np.random.Generator,
    settings: ClutterSettings,
) -> NDArray[np.float64]:
    """Random orientation and place, just above what lies there already."""
    points = np.concatenate([vertices for vertices, _ in world.objects[index].pieces])
    half = np.asarray(area) / 2.0 - 0.005
    for _ in range(20):
        rotation = Rotation.from_quat(rng.standard_normal(4)).as_matrix()
        turned = points @ rotation.T
        low, high = turned.min(axis=0), turned.max(axis=0)
        if ((high - low)[:2] < 2 * half).all():
            break
    if world.bin is None:
        angle, radius = rng.uniform(0, 2 * np.pi), settings.heap_radius * np.sqrt(rng.random())
        xy = radius * np.array([np.cos(angle), np.sin(angle)])
    else:
        # Sorted, because an object wider than the bin turns the range around.
        xy = rng.uniform(*np.sort(np.stack([-half - low[:2], half - high[:2]]), axis=0))
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:2, 3] = xy
    pose[2, 3] = _pile_height(world, xy + low[:2], xy + high[:2]) + settings.drop - low[2]
    return pose


def _pile_height(world: World, low: NDArray[np.float64], high: NDArray[np.float64]) -> float:
    """Highest point (m) of the objects whose bounds overlap a rectangle of the support."""
    height, poses = 0.0, world.object_poses()
    for other in world.present:
        corners = np.concatenate([vertices for vertices, _ in world.objects[other].pieces])
        placed = corners @ poses[other, :3, :3].T + poses[other, :3, 3]
        if (placed[:, :2].max(axis=0) > low).all() and (placed[:, :2].min(axis=0) < high).all():
            height = max(height, float(placed[:, 2].max()))
    return height


def _step(world: World, duration: float) -> None:
    mujoco.mj_step(world.model, world.data, nstep=round(duration / world.model.opt.timestep))


def _calm(world: World, settings: ClutterSettings) -> None:
    """Run until the objects are slow, at most `calm_time`."""
    for _ in range(round(settings.calm_time / 0.05)):
        _step(world, 0.05)
        speed = world.object_speeds()
        if (speed < [settings.calm_speed, settings.calm_turn]).all():
            return


def rest_check(world: World, duration: float) -> tuple[float, float]:
    """Run for `duration` s; largest shift (m) and turn (rad) of an object in the scene."""
    before = world.object_poses()[world.present]
    _step(world, duration)
    after = world.object_poses()[world.present]
    if len(before) == 0:
        return 0.0, 0.0
    shift = np.linalg.norm(after[:, :3, 3] - before[:, :3, 3], axis=1)
    trace = np.einsum("nij,nij->n", after[:, :3, :3], before[:, :3, :3])
    angle = np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))
    return float(shift.max()), float(angle.max())


def park_escaped(world: World, area: tuple[float, float]) -> int:
    """Park the objects whose centre is outside the area; how many they were."""
    poses = world.object_poses()
    half = np.asarray(area) / 2.0
    escaped = [
        i
        for i in world.present
        if (np.abs(poses[i, :2, 3]) > half).any() or poses[i, 2, 3] < 0 or poses[i, 2, 3] > 1.5
    ]
    for index in escaped:
        world.park_object(index)
    return len(escaped)


def deepest_contact(world: World) -> float:
    """Deepest penetration (m) among everything in the world."""
    world.detect_contacts()
    distance = world.data.contact.dist
    return float(max(0.0, -distance.min(initial=0.0)))
