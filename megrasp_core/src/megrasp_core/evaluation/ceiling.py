"""How far a protocol can be passed at all: a planner that searches with every object's true
geometry before it names a grasp.

Its rate is what no planner that sees one noisy cloud can be expected to beat: where it finds
nothing, the objects that are left lie against walls, under others or too flat on the floor.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from megrasp_core.errors import InvalidRequestError
from megrasp_core.grippers import Gripper
from megrasp_core.objects import ObjectModel
from megrasp_core.pointcloud import Cloud
from megrasp_core.simulation import World
from megrasp_core.synthesizer import RankedGrasp, Synthesis

from .planners import Planner
from .search import GRAVITY, GraspSearch, SearchSettings


class CeilingPlanner(Planner):
    """Names a grasp only after it has succeeded in a copy of the very state."""

    name = "ceiling"

    def __init__(self, gripper: Gripper, settings: SearchSettings | None = None) -> None:
        self.gripper = gripper
        self._search = GraspSearch(gripper, settings)
        self._stage: tuple[World, dict[int, ObjectModel]] | None = None

    def look_inside(self, world: World, models: Mapping[int, ObjectModel]) -> None:
        """Take the true state in.

        Args:
            world: as the next grasp will find it; left as it is.
            models: of the objects that may be grasped, by place.
        """
        self._stage = world, dict(models)

    def plan(self, cloud: Cloud, **options: Any) -> Synthesis:
        """The first grasp found that succeeds; the cloud is not looked at.

        Raises:
            InvalidRequestError: nobody called `look_inside`.
        """
        if self._stage is None:
            raise InvalidRequestError(
                "the ceiling was asked without a world; expected look_inside first. It works in "
                "simulated protocols only."
            )
        began = time.perf_counter()
        world, goals = self._stage
        rng = np.random.default_rng(options.get("seed"))
        found = self._search.find(world, goals, rng)
        return Synthesis(
            grasps=[] if found is None else [self._grasp(found)],
            rejected={},
            timing={"total": time.perf_counter() - began},
            seed=int(options.get("seed") or 0),
            drawn=int(options.get("drawn", 0)),
            evaluations=0,
            gripper=self.gripper.name,
            model=self.name,
        )

    def _grasp(self, pose: np.ndarray) -> RankedGrasp:
        tilt = float(np.arccos(np.clip(pose[:3, 2] @ GRAVITY, -1.0, 1.0)))
        tcp = pose @ np.asarray(self.gripper.gripper_from_tcp)
        nan = float("nan")
        back = self._search.stand_off(pose)
        return RankedGrasp(tcp, pose, back, back, 1.0, nan, nan, tilt, True)
