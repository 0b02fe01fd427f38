"""The one verdict on a grasp, used for labels, evaluation and the robot cell
(docs/architecture.md, "Verdict").

(a) The open gripper at the pre-grasp, and on ten poses of the approach if there is one, penetrates
    nothing by more than 1 mm. (b) It closes for 0.6 s within the description's force limits. (c)
    It lifts 20 cm in 0.7 s against gravity, holds 0.5 s and shakes +-2 cm at 2 Hz for 1 s. (d)
    Success: a graspable object has been in contact since closing ended (gaps up to 50 ms) and its
    centre rose by more than 12 cm; no obstacle rose, and the bin was not pulled up.

The shake runs along both horizontal axes, a quarter period apart (a circle of radius 2 cm). Its
phase starts along the horizontal part of the closing axis, so that turning scene and grasp
together about gravity changes nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from enum import StrEnum

import mujoco
import numpy as np
from numpy.typing import NDArray

from .motion import (
    WATCH_PERIOD,
    ContactWatch,
    Motion,
    Shake,
    Watch,
    advance,
    closing,
    smooth,
    step_times,
)
from .start_collision import START_DEPTH, approach_path, start_depths
from .world import GRIPPER, SCENERY, World

OnPhase = Callable[[str], None]
"""(name of the phase that begins)."""


class Reason(StrEnum):
    """Why a grasp succeeded or failed."""

    SUCCESS = "success"
    START_COLLISION = "start_collision"  # open gripper over 1 mm deep at the pre-grasp
    APPROACH_COLLISION = "approach_collision"  # the same on the way there
    NO_CONTACT = "no_contact"  # closed on nothing graspable
    SLIPPED = "slipped"  # held when closing ended, lost later
    NOT_LIFTED = "not_lifted"  # in contact to the end, but rose too little
    OBSTACLE = "obstacle"  # closed on, or lifted, an obstacle
    BIN = "bin"  # pulled the bin up
    UNSTABLE = "unstable"  # the simulation diverged


@dataclass(frozen=True)
class TrialSettings:
    """Numbers of the verdict; the defaults stay for every reported figure.

    Attributes:
        max_depth: deepest penetration (m) of the open gripper that still counts as free.
        approach_poses: tested on the way to the pre-grasp.
        close_time: for closing (s).
        close_ramp: the finger command goes from open to closed in this time (s) and stays there
            till close_time.
        lift_height: (m).
        lift_time: (s).
        hold_time: held still after lifting (s).
        shake: after that.
        min_rise: an object counts as lifted when its centre rose by more (m).
        bin_weight: upward pull (N) on table or bin that, over 50 ms altogether, counts as lifting
            the bin.
    """

    max_depth: float = START_DEPTH
    approach_poses: int = 10
    close_time: float = 0.6
    close_ramp: float = 0.4
    lift_height: float = 0.20
    lift_time: float = 0.7
    hold_time: float = 0.5
    shake: Shake = field(default_factory=lambda: Shake(0.02))
    min_rise: float = 0.12
    bin_weight: float = 12.0


@dataclass(frozen=True)
class Verdict:
    """Outcome of one trial.

    lifted: every object whose centre rose by more than 12 cm. target: the graspable one that was
        held, or None.
    depth: deepest penetration (m) at the pre-grasp or on the approach. extra: objects lifted
        besides the target.
    """

    success: bool
    reason: Reason
    lifted: tuple[int, ...] = ()
    target: int | None = None
    depth: float = 0.0
    extra: int = 0


def judge(
    world: World,
    world_from_gripper: NDArray[np.float64],
    *,
    graspable: Collection[int] | None = None,
    approach: NDArray[np.float64] | None = None,
    opening: float = 0.0,
    settings: TrialSettings | None = None,
    on_phase: OnPhase | None = None,
) -> Verdict:
    """Try one grasp in the world as it is now and leave the world as the attempt leaves it.

    world_from_gripper: pre-grasp (4, 4). approach: approach pose (4, 4), or None for no test of
        the way there.
    opening: share of the way from open to closed at which the fingers start.
    graspable: objects that count; None means all that are present and no obstacles.
    on_phase: called at the beginning of `approach`, `close` and `lift`; may raise, which leaves
        the world as it is then.
    Ends as soon as the outcome is decided. After a rejected start or an instability the world is
    as before.
    """
    settings = settings or TrialSettings()
    tell = on_phase or _nobody
    before = world.save()
    tell("approach")
    depth = float(start_depths(world, world_from_gripper[None], posture=opening)[0])
    if depth > settings.max_depth:
        return Verdict(False, Reason.START_COLLISION, depth=depth)
    if approach is not None:
        path = approach_path(approach, world_from_gripper, settings.approach_poses)
        on_the_way = float(start_depths(world, path, posture=opening).max())
        if on_the_way > settings.max_depth:
            return Verdict(False, Reason.APPROACH_COLLISION, depth=on_the_way)
        depth = max(depth, on_the_way)
    goals = set(world.present) - world.obstacles
    if graspable is not None:
        goals &= set(graspable)
    verdict = _attempt(world, world_from_gripper, goals, depth, opening, settings, tell)
    if verdict.reason is Reason.UNSTABLE:
        world.restore(before)
    return verdict


def _attempt(
    world: World,
    pose: NDArray[np.float64],
    goals: set[int],
    depth: float,
    opening: float,
    settings: TrialSettings,
    tell: OnPhase,
) -> Verdict:
    tell("close")
    height = world.object_poses()[:, 2, 3]
    world.clear_warnings()
    world.place_gripper(pose, opening)
    advance(world, closing(world, settings.close_time, settings.close_ramp, opening))
    touched, _ = world.touched()
    watch = ContactWatch(world, touched & goals)
    pull = _BinPull(world, settings.bin_weight)
    at_closing = bool(watch.held)
    if at_closing and not world.unstable():
        tell("lift")
        _lift(world, pose, settings, lambda: watch() and pull())
    if world.unstable():
        return Verdict(False, Reason.UNSTABLE, depth=depth)
    rise = world.object_poses()[:, 2, 3] - height
    lifted = tuple(i for i in world.present if rise[i] > settings.min_rise)
    target = max((i for i in lifted if i in watch.held), key=lambda i: rise[i], default=None)
    if pull.lifted:
        reason = Reason.BIN
    elif world.obstacles.intersection(lifted):
        reason = Reason.OBSTACLE
    elif target is not None:
        reason = Reason.SUCCESS
    elif watch.held:
        reason = Reason.NOT_LIFTED
    elif at_closing:
        reason = Reason.SLIPPED
    else:
        reason = Reason.OBSTACLE if touched & world.obstacles else Reason.NO_CONTACT
    return Verdict(
        success=reason is Reason.SUCCESS,
        reason=reason,
        lifted=lifted,
        target=target,
        depth=depth,
        extra=len(lifted) - (target is not None),
    )


def _nobody(phase: str) -> None:
    """Stand in for a listener."""


def _lift(world: World, pose: NDArray[np.float64], settings: TrialSettings, watch: Watch) -> None:
    """Lift, hold and shake; stops where `watch` says so."""
    start = pose[:3, 3]
    rise = np.array([0.0, 0.0, settings.lift_height])
    times = step_times(world, settings.lift_time)
    lift = start + smooth(times / settings.lift_time)[:, None] * rise
    offsets = settings.shake.offsets(step_times(world, settings.shake.duration))
    shake = start + rise + offsets @ np.stack(shake_axes(pose))
    for motion in (
        Motion(len(lift), lift),
        Motion(len(step_times(world, settings.hold_time))),
        Motion(len(shake), shake),
    ):
        if not advance(world, motion, watch):
            return


def shake_axes(
    world_from_gripper: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Two horizontal unit vectors (3,), the first along the closing axis as far as it can be.

    A vertical closing axis gives way to the gripper's Y axis.
    """
    for column in (0, 1):
        along = world_from_gripper[:3, column] * [1.0, 1.0, 0.0]
        length = np.linalg.norm(along)
        if length > 0.1:
            break
    along = along / length
    return along, np.array([-along[1], along[0], 0.0])


class _BinPull:
    """Watches the upward force of the gripper on table and bin while it lifts.

    The bin is fixed in the simulation; a pull above its weight for 50 ms altogether (sliding
    fingers stick and slip) would have taken it along.
    """

    def __init__(self, world: World, weight: float) -> None:
        self.world = world
        self.weight = weight
        self.lifted = False
        self._looks = 0

    def __call__(self) -> bool:
        """Look at the forces; False once the bin counts as lifted."""
        _, touches = self.world.touched()
        if touches and self._upward() >= self.weight:
            self._looks += 1
        self.lifted = self._looks * WATCH_PERIOD >= ContactWatch.GAP - 1e-9
        return not self.lifted

    def _upward(self) -> float:
        model, data, owner = self.world.model, self.world.data, self.world.owner
        force, total = np.zeros(6), 0.0
        for index in range(data.ncon):
            contact = data.contact[index]
            first, second = (int(owner[g]) for g in contact.geom)
            if {first, second} != {GRIPPER, SCENERY}:
                continue
            mujoco.mj_contactForce(model, data, index, force)
            # The contact frame's rows are its axes in the world; the force acts on the second
            # geom.
            vertical = float(contact.frame.reshape(3, 3)[:, 2] @ force[:3])
            total += vertical if second == SCENERY else -vertical
        return total
