"""The fixed protocols: binpick, declutter, single (docs/evaluation.md)."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from megrasp_core.cell.pick_cycle import PickCycle
from megrasp_core.errors import InvalidRequestError, SimulationError
from megrasp_core.grippers import Gripper
from megrasp_core.lie import matrix_from_pose7
from megrasp_core.objects import ObjectModel, procedural_object
from megrasp_core.pointcloud import Cloud, OrientedBox
from megrasp_core.simulation import (
    Bin,
    DepthNoise,
    TopDownCamera,
    World,
    WorldState,
    ring_cameras,
    settle,
)
from megrasp_core.synthesizer import Synthesis

from .failure_pictures import FailurePictures
from .outcome import JudgedGrasp, SceneOutcome
from .planners import Planner
from .search import GraspSearch

ProtocolName = Literal["binpick", "declutter", "single"]
TABLE_REGION = OrientedBox(
    matrix_from_pose7([0, 0, 0.125, 0, 0, 0, 1]), np.array([0.5, 0.4, 0.25])
)
"""Where heaps on a table lie, as in the training scenes; it has no walls."""

SIDE_VIEW = 0.9
"""How steeply a single camera beside a table looks down (rad)."""
CROPPED = 0.008
"""Up to this height over the table (m) a cloud is cut where the table is cut away."""
BESIDE = 0.15
"""So far outside the region (m) objects stay in such a cloud: grippers at its edge reach them."""

CroppedFloor = Literal["known", "estimated"]
PROTOCOLS: tuple[ProtocolName, ...] = ("binpick", "declutter", "single")


@dataclass(frozen=True)
class ProtocolSettings:
    """One evaluation run.

    Attributes:
        protocol: binpick, declutter or single.
        scenes: bins or heaps.
        samples: poses judged one by one per stage, for the unfiltered and filtered rates; 0 leaves
            them out.
        drawn: poses of every synthesis whose first grasp is executed.
        returned: grasps that it returns.
        graspable: objects in a bin.
        obstacles: things besides that must not be lifted.
        friction: of everything.
        max_attempts: in one bin.
        max_failures: in a row, after which a bin is given up.
        exclude_radius: grasps whose TCP lies so near (m) to one that failed are passed over, see
            `FailureMemory`.
        judged: so many of the returned grasps are judged one by one at every stage, best first,
            before the first is executed; for calibration and the AUC of the score.
        possible_only: after a failed attempt in a bin every returned grasp and a search with true
            geometry are tried in the state before it; where nothing lifts anything, the attempts
            that count have ended.
        views: cameras around a table heap; one looks from the side, 52 degrees down.
        crop_floor: the table is cut from the cloud, as for planners that want segmented objects;
            the planner is told region and height of the table (`known`) or neither (`estimated`).
            None: it stays.
        noise: of the depth camera; None: none.
        seed: of scenes, noise and samples.
    """

    protocol: ProtocolName = "binpick"
    scenes: int = 50
    samples: int = 0
    drawn: int = 100
    returned: int = 20
    graspable: int = 10
    obstacles: int = 2
    friction: float = 0.8
    max_attempts: int = 25
    max_failures: int = 3
    exclude_radius: float = 0.05
    judged: int = 0
    possible_only: bool = False
    views: int = 10
    crop_floor: CroppedFloor | None = None
    noise: DepthNoise | None = field(default_factory=DepthNoise)
    seed: int = 1

    def __post_init__(self) -> None:
        if self.protocol not in PROTOCOLS:
            raise InvalidRequestError(
                f"protocol {self.protocol!r} is unknown; expected one of {', '.join(PROTOCOLS)}."
            )
        if self.scenes < 1 or self.samples < 0 or self.drawn < 1 or self.returned < 1:
            raise InvalidRequestError(
                f"scenes {self.scenes}, samples {self.samples}, drawn {self.drawn}, returned "
                f"{self.returned} were given; expected at least 1, 0, 1 and 1."
            )
        if self.views < 1 or (
            self.protocol == "binpick" and (self.views, self.crop_floor) != (10, None)
        ):
            raise InvalidRequestError(
                f"views {self.views} and crop_floor {self.crop_floor} were given with "
                f"{self.protocol}; expected at least one view. A bin is seen by one camera from "
                "above; choose declutter or single."
            )
        if self.possible_only and self.protocol != "binpick":
            raise InvalidRequestError(
                f"possible_only was given with {self.protocol}; expected binpick, where attempts "
                "follow on each other."
            )


def run_scene(
    settings: ProtocolSettings,
    gripper: Gripper,
    planner: Planner,
    pool: Sequence[ObjectModel],
    graspable: Sequence[int],
    index: int,
    search: GraspSearch | None = None,
    pictures: FailurePictures | None = None,
) -> SceneOutcome:
    """Run one scene of a protocol; on one machine the same settings and index give the same
    scene.

    Args:
        settings: the run.
        gripper: used in the simulation.
        planner: answers with grasps.
        pool: objects.
        graspable: indices of those that the gripper can hold.
        index: number of the scene.
        search: of `possible_only`; by default one with usual effort.
        pictures: of the executed grasps that fail and count.
    """
    if settings.possible_only and search is None:
        search = GraspSearch(gripper)
    world, obstacles, models = _scene(settings, gripper, pool, graspable, index)
    cycle = PickCycle(world, obstacles)
    outcome = SceneOutcome(objects=len(cycle.left))
    rng = np.random.default_rng([settings.seed, index, 3])
    # Its own, so that the search changes nothing of what the camera sees and the planner draws.
    search_rng = np.random.default_rng([settings.seed, index, 4])
    binpick = settings.protocol == "binpick"
    while cycle.left:
        if binpick and (
            cycle.failures.in_a_row >= settings.max_failures
            or len(outcome.first) >= settings.max_attempts
        ):
            break
        # A bin is seen from above, a table heap from all around or from one side.
        ring: dict[str, Any] = {}
        if settings.views == 1:
            ring["elevation"] = (SIDE_VIEW, SIDE_VIEW)
        cameras = TopDownCamera() if binpick else ring_cameras(settings.views, **ring)
        cloud = cycle.look(cameras, settings.noise, rng)
        region = TABLE_REGION if world.bin is None else world.bin.region()
        if settings.crop_floor:
            near = region.grown(BESIDE).contains(cloud.points)
            cloud = cloud.select(near & (cloud.points[:, 2] > CROPPED))
        options: dict[str, Any] = {
            "region": None if settings.crop_floor == "estimated" else region,
            "floor": 0.0 if settings.crop_floor == "known" else None,
            "walls": world.bin is not None,
            "seed": int(rng.integers(2**31)),
        }
        outcome.stages += 1
        if settings.samples and (not binpick or outcome.stages == 1):
            _judge_samples(settings, cycle, planner, cloud, options, outcome)
        goals = {place: models[place] for place in cycle.left}
        planner.look_inside(world, goals)
        result = cycle.failures.ask(
            functools.partial(_plan, settings, planner, cloud, options, outcome),
            lambda answer: bool(answer.grasps),
        )
        outcome.evaluations = result.evaluations
        outcome.answered += bool(result.grasps)
        outcome.targets.append(_target(world, models, result))
        if settings.judged:
            outcome.judged.append(
                [
                    JudgedGrasp.of(grasp, cycle.verdict(grasp, approach=binpick))
                    for grasp in result.grasps[: settings.judged]
                ]
            )
        before = world.save()
        if binpick:
            _pick(cycle, result, outcome)
            if search is not None and outcome.counted is None:
                _count(cycle, result, outcome, search, before, goals, search_rng)
        else:
            _try_first(cycle, result, outcome)
        if pictures is not None:
            _show_failure(pictures, cycle, result, outcome, before, index)
        if binpick:
            continue
        if settings.protocol == "single":
            break
        cycle.clear([int(rng.choice(cycle.left))])
    if search is not None and outcome.counted is None:
        left = {place: models[place] for place in cycle.left}
        outcome.unreachable = len(left) - len(search.reachable(world, left, search_rng))
    return outcome


NO_ANSWER = "no_answer"
"""Reason of an attempt without a grasp: the robot stood still for nothing."""


def _plan(
    settings: ProtocolSettings,
    planner: Planner,
    cloud: Cloud,
    options: dict[str, Any],
    outcome: SceneOutcome,
    failed: list[NDArray[np.float64]],
) -> Synthesis:
    result = planner.plan(
        cloud,
        num_grasps=settings.returned,
        drawn=settings.drawn,
        exclude=failed,
        exclude_radius=settings.exclude_radius,
        **options,
    )
    outcome.seconds.append(result.timing["total"])
    return result


def _target(world: World, models: Sequence[ObjectModel], result: Synthesis) -> str:
    """Name of the object that the best grasp is aimed at; "" without grasps."""
    if not result.grasps:
        return ""
    tcp = result.grasps[0].world_from_tcp[:3, 3]
    poses = world.object_poses()

    def distance(place: int) -> float:
        local = poses[place, :3, :3].T @ (tcp - poses[place, :3, 3])
        return float(np.linalg.norm(models[place].vertices - local, axis=1).min())

    return models[min(world.present, key=distance)].name


def _pick(cycle: PickCycle, result: Synthesis, outcome: SceneOutcome) -> None:
    """Execute the best grasp and leave the scene as the attempt leaves it."""
    if not result.grasps:
        outcome.first.append((False, NO_ANSWER))
        cycle.failures.count(False, None)
        cycle.clear(())
        return
    goals = set(cycle.left)
    verdict = cycle.execute(result.grasps[0])
    outcome.first.append((bool(verdict.success), verdict.reason.value))
    if verdict.success:
        outcome.removed += len(goals & set(verdict.lifted))


def _count(
    cycle: PickCycle,
    result: Synthesis,
    outcome: SceneOutcome,
    search: GraspSearch,
    before: WorldState,
    goals: dict[int, ObjectModel],
    rng: np.random.Generator,
) -> None:
    """Take in whether the last attempt counts: whether anything could have been lifted."""
    if outcome.first[-1][0]:
        outcome.removed_counted = outcome.removed
        return
    after = cycle.world.save()
    cycle.world.restore(before)
    possible = any(cycle.verdict(grasp).success for grasp in result.grasps[1:])
    possible = possible or search.find(cycle.world, goals, rng) is not None
    cycle.world.restore(after)
    if not possible:
        outcome.counted = len(outcome.first) - 1
        outcome.unreachable = len(goals)


def _try_first(cycle: PickCycle, result: Synthesis, outcome: SceneOutcome) -> None:
    """What would become of the best grasp; no path to it is tested, as in the paper."""
    if not result.grasps:
        outcome.first.append((False, NO_ANSWER))
        return
    verdict = cycle.verdict(result.grasps[0], approach=False)
    outcome.first.append((bool(verdict.success), verdict.reason.value))


def _show_failure(
    pictures: FailurePictures,
    cycle: PickCycle,
    result: Synthesis,
    outcome: SceneOutcome,
    before: WorldState,
    index: int,
) -> None:
    """Take a picture of the last attempt, if it counts and failed; the scene stays as it is."""
    success, reason = outcome.first[-1]
    if success or not result.grasps or outcome.counted is not None:
        return
    after = cycle.world.save()
    cycle.world.restore(before)
    pictures.take(
        cycle,
        result.grasps[0],
        scene=index,
        attempt=len(outcome.first),
        reason=reason,
        target=outcome.targets[-1],
    )
    cycle.world.restore(after)


def _judge_samples(
    settings: ProtocolSettings,
    cycle: PickCycle,
    planner: Planner,
    cloud: Cloud,
    options: dict,
    outcome: SceneOutcome,
) -> None:
    """Judge every sample from the restored state; all go through the whole sampler (mode fast),
    and nothing moves them after that.
    """
    result = planner.raw().plan(
        cloud,
        num_grasps=settings.samples,
        drawn=settings.samples,
        mode="fast",
        keep_all=True,
        **options,
    )
    for grasp in result.grasps:
        verdict = cycle.verdict(grasp, approach=settings.protocol == "binpick")
        sample = (bool(verdict.success), bool(grasp.collision_free), verdict.reason.value)
        outcome.sampled.append(sample)


def _scene(
    settings: ProtocolSettings,
    gripper: Gripper,
    pool: Sequence[ObjectModel],
    graspable: Sequence[int],
    index: int,
) -> tuple[World, set[int], list[ObjectModel]]:
    """Settle the scene; a draw that does not come to rest is drawn again with the next seed."""
    for attempt in range(10):
        rng = np.random.default_rng([settings.seed, index, attempt])
        obstacles: set[int] = set()
        if settings.protocol == "binpick":
            count = min(settings.graspable, len(graspable))
            chosen = [pool[i] for i in rng.choice(graspable, count, replace=False)]
            extra = [
                procedural_object(int(rng.integers(2**31)), obstacle=True)
                for _ in range(settings.obstacles)
            ]
            order = rng.permutation(len(chosen) + len(extra))
            objects = [(chosen + extra)[i] for i in order]
            obstacles = {place for place, i in enumerate(order) if i >= len(chosen)}
            bin: Bin | None = Bin()
        else:
            count = 1 if settings.protocol == "single" else int(rng.integers(5, 13))
            count = min(count, len(graspable))
            objects = [pool[i] for i in rng.choice(graspable, count, replace=False)]
            bin = None
        settled = settle(objects, bin=bin, rng=rng, friction=settings.friction)
        kept = {place: new for new, place in enumerate(settled.kept)}
        if settled.ok and (len(kept) == len(objects) or settings.protocol != "binpick"):
            obstacles = {kept[place] for place in obstacles if place in kept}
            world = settled.world(gripper=gripper, friction=settings.friction, obstacles=obstacles)
            return world, obstacles, [objects[place] for place in settled.kept]
    raise SimulationError(
        f"scene {index} of seed {settings.seed} did not come to rest in 10 draws; use fewer or "
        "smaller objects."
    )
