"""Robust labels: grasps tried again under other conditions (docs/architecture.md, "Data").

One simulation at one friction and one exact pose flatters. A grasp is tried ROBUST_TRIALS times
more, each time with its pose, the friction, the mass and the force drawn anew, and the share that
held is what a confidence should say. Near misses are tried just as often, whatever the plain
verdict said of them: were those that failed once left at 0, the share would be too low there.

Poses vary in the TCP frame, about the TCP, by normal noise with a standard deviation of 2 mm along
each of the three axes and of 2 degrees about each of them; lengths and angles are then 3.2 mm and
3.2 degrees in the mean. The factors are even over their ranges. In bins the last 10 cm of the
approach must be free, as for the labels of the scene.
"""

from __future__ import annotations

import time
import zlib
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from megrasp_core.errors import InvalidRequestError
from megrasp_core.grippers import Gripper
from megrasp_core.lie import matrix_from_pose7
from megrasp_core.objects import ObjectSet
from megrasp_core.ranges import COUNT, LENGTH, Range, check_ranges
from megrasp_core.simulation import Reason, Variation, Verdict, build_world, judge, varied
from megrasp_core.storage import NOT_TRIED, ROBUST_TRIALS, GripperLabels, Kind, SceneRecord

from .layout import ROBUST, stream
from .scene_labels import balanced, near_moves

Factor = Literal["pose", "friction", "mass", "force"]
FACTORS: tuple[Factor, ...] = get_args(Factor)
COLLISIONS = (Reason.START_COLLISION.value, Reason.APPROACH_COLLISION.value)

_SELECT = len(FACTORS)
"""Stream of the choice of grasps; those before are the factors'."""


@dataclass(frozen=True)
class RobustSettings:
    """How many grasps are tried again, and what varies; lengths in m, angles in rad.

    Attributes:
        successes: grasps that held in the heap, a gripper and scene; the objects take turns.
        near_misses: successes moved by `near_moves`, besides.
        failures: grasps that failed in the heap, without those that collide.
        vary: what differs from the plain trial; the others stay as they are, and the draws of
            those that differ are the same whichever they are.
        metres: standard deviation of the position along each axis.
        radians: of the turn about each axis.
        friction: least and largest sliding friction of the gripper's contacts.
        mass: of the factor on the objects' mass.
        force: of the factor on the drives' force.
        approach: length of the approach path that must be free in bins.
    """

    successes: int = 3
    near_misses: int = 2
    failures: int = 1
    vary: tuple[Factor, ...] = FACTORS
    metres: float = 0.002
    radians: float = field(default=float(np.deg2rad(2.0)))
    friction: tuple[float, float] = (0.4, 1.0)
    mass: tuple[float, float] = (0.7, 1.5)
    force: tuple[float, float] = (0.7, 1.1)
    approach: float = 0.10

    def __post_init__(self) -> None:
        check_ranges(
            self,
            successes=COUNT,
            near_misses=COUNT,
            failures=COUNT,
            metres=LENGTH,
            radians=LENGTH,
            friction=Range(above=0, several=True),
            mass=Range(above=0, several=True),
            force=Range(above=0, several=True),
            approach=LENGTH,
        )
        if not self.vary or not set(self.vary) <= set(FACTORS):
            raise InvalidRequestError(
                f"vary is {self.vary}; expected at least one of {', '.join(FACTORS)}."
            )


@dataclass(frozen=True)
class RobustTrials:
    """Labels of one gripper in one scene, and what they took.

    Attributes:
        labels: of the grasps that were chosen; their `robust` is known throughout.
        trials: simulated, those that ended in a collision at the start included.
        failed: why trials under other conditions failed, and how many for each reason.
        cpu_seconds: in all.
    """

    labels: GripperLabels
    trials: int
    failed: Counter[str]
    cpu_seconds: float


@dataclass(frozen=True)
class _Choice:
    """Rows of a gripper's labels, n of them: what is tried again.

    Attributes:
        row: (n,) row in the labels of the scene.
        move: (n,) 0 for the grasp of the row, k for the k-th near miss moved from it.
    """

    row: NDArray[np.int64]
    move: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.row)


def robust_count(record: SceneRecord, settings: RobustSettings, seed: int) -> int:
    """How many grasps of a record `robust_labels` labels, all its grippers together."""
    return sum(
        len(_chosen(record.seed, name, labels, settings, seed))
        for name, labels in record.labels.items()
    )


def robust_labels(
    record: SceneRecord,
    gripper: Gripper,
    objects: ObjectSet,
    settings: RobustSettings | None = None,
    seed: int = 0,
) -> RobustTrials:
    """Tries some of a gripper's grasps in a scene again.

    The same record, settings and seed give the same labels, and a grasp that is chosen gets the
    same ones whichever others are.

    Args:
        record: the scene with the gripper's labels; its cloud is not used.
        gripper: the gripper.
        objects: models by name.
        settings: amounts and ranges.
        seed: of the choice and of all draws.

    Returns:
        Labels in this order: successes, failures, near misses. `label` and `reason` are the plain
        verdict's.
    """
    settings = settings or RobustSettings()
    start = time.process_time()
    known = record.labels.get(gripper.name, GripperLabels.empty())
    choice = _chosen(record.seed, gripper.name, known, settings, seed)
    if not len(choice):
        return RobustTrials(GripperLabels.empty(), 0, Counter(), time.process_time() - start)
    trier = _Trier(record, gripper, objects, settings)
    streams = _Streams(seed, record.seed, gripper.name)
    parts: list[GripperLabels] = []
    trials, failed = 0, Counter[str]()
    for row, move in zip(choice.row.tolist(), choice.move.tolist()):
        plain = known.part(np.array([row]))
        pose = np.asarray(matrix_from_pose7(plain.world_from_tcp[0].astype(np.float64)))
        if move:
            pose = pose @ near_moves(1, streams.of(row, move, _SELECT))[0]
            plain = _plain(pose, int(plain.object[0]), trier.tried(pose))
            trials += 1
        held = 0
        if plain.reason[0] not in COLLISIONS:
            for offset, variation in _draws(settings, streams, row, move):
                verdict = trier.tried(pose @ offset, variation)
                held += verdict.success
                if not verdict.success:
                    failed[verdict.reason.value] += 1
            trials += ROBUST_TRIALS
        parts.append(_with_robust(plain, held))
    return RobustTrials(GripperLabels.joined(parts), trials, failed, time.process_time() - start)


class _Streams:
    """Generators of one gripper in one scene."""

    def __init__(self, seed: int, scene: int, gripper: str) -> None:
        self._key = (seed, zlib.crc32(gripper.encode()))
        self._scene = scene

    def of(self, row: int, move: int, which: int) -> np.random.Generator:
        """That of one factor of one grasp, so that no grasp and no factor changes another's."""
        return stream(self._scene, ROBUST, *self._key, which, row, move)

    def choice(self) -> np.random.Generator:
        """That of the choice of grasps."""
        return stream(self._scene, ROBUST, *self._key, _SELECT)


def _chosen(
    scene: int, gripper: str, labels: GripperLabels, settings: RobustSettings, seed: int
) -> _Choice:
    rng = _Streams(seed, scene, gripper).choice()
    # Older scenes have labels from the free-space trial, which nobody has tried in the heap.
    in_heap = ~np.isin(labels.kind, (Kind.LIBRARY, Kind.COLLISION))
    held = _in_turn(np.flatnonzero(in_heap & (labels.label == 1)), labels, rng)
    lost = in_heap & (labels.label == 0) & ~np.isin(labels.reason, COLLISIONS)
    lost = _in_turn(np.flatnonzero(lost), labels, rng)
    again = np.concatenate([held[: settings.successes], lost[: settings.failures]])
    count = settings.near_misses if len(held) else 0
    turn, _ = np.divmod(np.arange(count), max(1, len(held)))
    # Those that come next: few successes are both tried and moved.
    which = (settings.successes + np.arange(count)) % max(1, len(held))
    return _Choice(
        np.concatenate([again, held[which]]),
        np.concatenate([np.zeros(len(again), np.int64), turn + 1]),
    )


def _in_turn(
    rows: NDArray[np.int64], labels: GripperLabels, rng: np.random.Generator
) -> NDArray[np.int64]:
    """The rows in an order in which objects take turns; of the symmetric copies of a grasp, which
    have their TCP in the same place, one.
    """
    rows = rng.permutation(rows)
    _, first = np.unique(labels.world_from_tcp[rows, :3], axis=0, return_index=True)
    rows = rows[np.sort(first)]
    return rows[balanced(labels.object[rows], rng)]


def _draws(
    settings: RobustSettings, streams: _Streams, row: int, move: int
) -> list[tuple[NDArray[np.float64], Variation]]:
    """What each trial of a grasp differs by: offset (4, 4) in the TCP frame, and physics."""
    rng = {name: streams.of(row, move, place) for place, name in enumerate(FACTORS)}
    offset = np.tile(np.eye(4), (ROBUST_TRIALS, 1, 1))
    if "pose" in settings.vary:
        noise = rng["pose"].normal(size=(ROBUST_TRIALS, 6))
        offset[:, :3, 3] = settings.metres * noise[:, :3]
        turn = Rotation.from_rotvec(settings.radians * noise[:, 3:])
        offset[:, :3, :3] = turn.as_matrix()
    values: dict[str, list[float | None]] = {
        name: rng[name].uniform(*limits, size=ROBUST_TRIALS).tolist()
        if name in settings.vary
        else [None] * ROBUST_TRIALS
        for name, limits in (
            ("friction", settings.friction),
            ("mass", settings.mass),
            ("force", settings.force),
        )
    }
    return [
        (offset[index], Variation(**{name: drawn[index] for name, drawn in values.items()}))
        for index in range(ROBUST_TRIALS)
    ]


class _Trier:
    """Tries grasps of one gripper in one scene, each from the scene at rest."""

    def __init__(
        self,
        record: SceneRecord,
        gripper: Gripper,
        objects: ObjectSet,
        settings: RobustSettings,
    ) -> None:
        obstacles = set(np.flatnonzero(record.obstacle).tolist())
        self._world = build_world(
            [objects[name] for name in record.object_names],
            gripper=gripper,
            bin=record.bin,
            obstacles=obstacles,
            object_poses=np.asarray(matrix_from_pose7(record.object_poses.astype(np.float64))),
        )
        # Objects at rest sleep until touched: half the time, the same verdicts.
        self._world.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_SLEEP
        self._start = self._world.save()
        self._tcp_from_gripper = gripper.tcp_from_gripper
        self._back = np.eye(4)
        self._back[2, 3] = -settings.approach

    def tried(
        self, world_from_tcp: NDArray[np.float64], variation: Variation | None = None
    ) -> Verdict:
        """The verdict on a grasp; the world does not remember it."""
        world = self._world
        mujoco.mj_resetData(world.model, world.data)
        world.restore(self._start)
        pose = world_from_tcp @ self._tcp_from_gripper
        approach = None if world.bin is None else pose @ self._back
        with varied(world, variation or Variation()):
            return judge(world, pose, approach=approach)


def _plain(pose: NDArray[np.float64], owner: int, verdict: Verdict) -> GripperLabels:
    """The label of a near miss; `owner` is what it was made for."""
    tried = verdict.reason.value not in COLLISIONS
    return GripperLabels.of(
        pose[None],
        object=owner if verdict.target is None else verdict.target,
        label=verdict.success,
        kind=Kind.PERTURBED,
        reason="" if verdict.success else verdict.reason.value,
        extra=verdict.extra if tried else NOT_TRIED,
    )


def _with_robust(one: GripperLabels, held: int) -> GripperLabels:
    return replace(one, robust=np.array([held], np.int8))
