"""One round of packed or pile."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import InvalidRequestError
from megrasp_core.evaluation.planners import Planner
from megrasp_core.grippers import Gripper
from megrasp_core.objects import ObjectModel
from megrasp_core.pointcloud import Cloud
from megrasp_core.synthesizer import RankedGrasp, Synthesis

from .bullet_world import BulletWorld
from .mujoco_world import MujocoWorld
from .scenes import SceneName, make_scene
from .side_view import SideNoise, look, side_camera
from .world import WORKSPACE, Attempt, ClutterWorld, come_to_rest, take_out_lost

Engine = Literal["pybullet", "mujoco"]
Ending = Literal["cleared", "failures", "no_grasp"]
"""Why a round is over: nothing is left; two failures in a row; the planner knows no grasp."""


@dataclass(frozen=True)
class ClutterSettings:
    """One run.

    Attributes:
        scene: packed or pile.
        rounds: scenes.
        objects: in each.
        engine: in which the grasps are tried.
        drawn: poses of every synthesis.
        returned: grasps that it returns.
        friction: between any two bodies.
        noise: of the depth camera.
        max_failures: in a row, after which a round ends.
        exclude_radius: grasps whose TCP lies so near (m) to one that failed since the last success
            are passed over.
        seed: of scenes, cameras, noise and samples.
    """

    scene: SceneName = "packed"
    rounds: int = 100
    objects: int = 5
    engine: Engine = "pybullet"
    drawn: int = 100
    returned: int = 20
    friction: float = 0.8
    noise: SideNoise = "gaussian"
    max_failures: int = 2
    exclude_radius: float = 0.05
    seed: int = 1

    def __post_init__(self) -> None:
        for name, value, known in (
            ("scene", self.scene, get_args(SceneName)),
            ("engine", self.engine, get_args(Engine)),
            ("noise", self.noise, get_args(SideNoise)),
        ):
            if value not in known:
                raise InvalidRequestError(
                    f"{name} {value!r} was given; expected one of {', '.join(known)}."
                )
        if min(self.rounds, self.objects, self.drawn, self.returned, self.max_failures) < 1:
            raise InvalidRequestError(
                f"rounds {self.rounds}, objects {self.objects}, drawn {self.drawn}, returned "
                f"{self.returned}, max_failures {self.max_failures} were given; expected at least "
                "1 each."
            )


@dataclass(frozen=True)
class Tried:
    """An attempt, the grasp it was made with, and the names of the objects it removed."""

    grasp: RankedGrasp
    attempt: Attempt
    removed: tuple[str, ...]


@dataclass
class Round:
    """What happened in one round.

    Attributes:
        objects: at the start.
        tried: every attempt in order.
        removed: objects that were held at the end of an attempt.
        lost: objects that an attempt pushed out of the workspace; they count as left.
        ending: why it was over.
        seconds: wall time of every synthesis.
        evaluations: of the network that a pose went through.
    """

    objects: int
    tried: list[Tried] = field(default_factory=list)
    removed: int = 0
    lost: int = 0
    ending: Ending = "cleared"
    seconds: list[float] = field(default_factory=list)
    evaluations: int = 0


OnAttempt = Callable[[Cloud, Synthesis, Tried, NDArray[np.uint8] | None], None]
"""(what was seen, the answer, what came of it, picture of the hand or None)."""


def run_round(
    settings: ClutterSettings,
    gripper: Gripper,
    planner: Planner,
    pool: Sequence[ObjectModel],
    index: int,
    on_attempt: OnAttempt | None = None,
) -> Round:
    """Run one round; on one machine the same settings and index give the same scene.

    Args:
        settings: the run.
        gripper: in the simulation.
        planner: answers with grasps.
        pool: objects, see `fitting`.
        index: number of the round.
        on_attempt: called after every attempt, for pictures.

    Raises:
        MissingPackageError: the engine is not installed.
        InvalidRequestError: the engine cannot close this gripper; too few objects.
        SimulationError: no scene comes to rest.
    """

    def make(objects: Sequence[ObjectModel]) -> ClutterWorld:
        if settings.engine == "mujoco":
            return MujocoWorld(objects, gripper, friction=settings.friction)
        return BulletWorld(
            objects, gripper, friction=settings.friction, pictures=on_attempt is not None
        )

    seed = (settings.seed, index)
    world = make_scene(settings.scene, pool, settings.objects, make, seed)
    try:
        return play(settings, world, planner, np.random.default_rng([*seed, 2**20]), on_attempt)
    finally:
        world.close()


def play(
    settings: ClutterSettings,
    world: ClutterWorld,
    planner: Planner,
    rng: np.random.Generator,
    on_attempt: OnAttempt | None = None,
) -> Round:
    """Look, try the best grasp, take away what is held, until the round is over."""
    outcome = Round(len(world.present))
    failed: list[NDArray[np.float64]] = []
    failures = 0
    while world.present:
        if failures >= settings.max_failures:
            outcome.ending = "failures"
            break
        cloud = look(world, side_camera(rng), settings.noise, rng)
        result = planner.plan(
            cloud,
            num_grasps=settings.returned,
            drawn=settings.drawn,
            region=WORKSPACE,
            walls=False,
            exclude=failed,
            exclude_radius=settings.exclude_radius,
            seed=int(rng.integers(2**31)),
        )
        outcome.seconds.append(result.timing["total"])
        outcome.evaluations = max(outcome.evaluations, result.evaluations)
        if not result.grasps:
            outcome.ending = "no_grasp"
            break
        grasp = result.grasps[0]
        attempt = world.attempt(
            grasp.world_from_gripper, grasp.world_from_gripper_approach, grasp.share
        )
        for held in attempt.held:
            world.take_out(held)
        come_to_rest(world)
        outcome.removed += len(attempt.held)
        outcome.lost += len(take_out_lost(world))
        names = tuple(world.objects[held].name for held in attempt.held)
        outcome.tried.append(Tried(grasp, attempt, names))
        failures = 0 if attempt.success else failures + 1
        failed = [] if attempt.success else [*failed, grasp.world_from_tcp]
        if on_attempt is not None:
            on_attempt(cloud, result, outcome.tried[-1], world.last_hand())
    return outcome
