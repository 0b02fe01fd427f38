"""A robot cell in MuJoCo: a bin with objects, a top-down depth camera, a rack of grippers.

It plays the robot of the protocol `binpick` for the demo, the evaluation and the ROS node
`sim_cell`: it shows a cloud, executes a grasp with its approach path by the one verdict, leaves
the scene as the attempt leaves it, takes what was lifted out of the bin, and changes tools. No ROS
here.

A cell belongs to one thread at a time: call it from one worker. On one machine the same seed,
objects and calls give the same scenes and clouds.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import InvalidRequestError, UnknownGripperError
from megrasp_core.grippers import Gripper, load_gripper
from megrasp_core.objects import ObjectModel, procedural_object
from megrasp_core.pointcloud import Cloud, OrientedBox
from megrasp_core.ranking import ClosingPath, gripper_probe
from megrasp_core.simulation import (
    Bin,
    Camera,
    DepthNoise,
    TopDownCamera,
    World,
    build_world,
    depth_to_points,
    render_view,
)
from megrasp_core.synthesizer import RankedGrasp

from .inputs import checked_pose, unique_names
from .pick_cycle import PickCycle
from .rest import outside_bin, settle_all

LOGGER = logging.getLogger(__name__)


@dataclass(frozen=True)
class CellSettings:
    """What a cell is made of; lengths in m."""

    bin: Bin = field(default_factory=Bin)
    """What the objects lie in."""
    friction: float | None = None
    """Sliding friction of everything; None: each object's own."""
    camera: Camera = field(default_factory=TopDownCamera)
    """What looks at them."""
    noise: DepthNoise | None = field(default_factory=DepthNoise)
    """What the camera does to depths; None: nothing."""


@dataclass(frozen=True)
class CellView:
    """One picture of the depth camera.

    cloud: points with a reading, world frame, with the camera's place as viewpoint.
    depth: (h, w) float32, m along the optical axis, 0 without a reading.
    camera: the camera that took it.
    """

    cloud: Cloud
    depth: NDArray[np.float32]
    camera: Camera


@dataclass(frozen=True)
class ExecutionResult:
    """What became of one attempt.

    success: the verdict's, an object was lifted, held and shaken.
    removed: names of the objects that the gripper took out, empty after a failure.
    spilled: names of the objects that ended up outside the bin, which are taken out of the scene
    too.
    error: "" or the verdict's reason.
    width: between the fingers after closing, with what is between them (m); NaN for hands, and
    where the fingers have not closed.
    depth: deepest penetration of the open gripper with anything before closing (m).
    """

    success: bool
    removed: tuple[str, ...]
    spilled: tuple[str, ...]
    objects_left: int
    error: str
    depth: float
    width: float = math.nan


class RobotCell:
    """A bin with objects, a camera and one mounted gripper out of a rack."""

    def __init__(
        self,
        objects: Sequence[ObjectModel],
        grippers: Sequence[str | Gripper],
        *,
        seed: int = 0,
        mounted: str | None = None,
        settings: CellSettings | None = None,
        object_poses: NDArray[np.float64] | None = None,
    ) -> None:
        """Fills the bin.

        objects: what to put in. grippers: the rack, names, folders or loaded grippers. mounted:
        name of the gripper to start with (default: the first). object_poses: (n, 4, 4)
        world_from_object to start from; by default the objects fall in one after another and come
        to rest.

        Raises InvalidRequestError for an empty list, UnknownGripperError, SimulationError if the
        objects do not come to rest in the bin.
        """
        if not objects or not grippers:
            raise InvalidRequestError(
                f"{len(objects)} objects and {len(grippers)} grippers were given; "
                "a cell needs one of each"
            )
        self.settings = settings or CellSettings()
        self._objects = list(objects)
        self._names = unique_names([model.name for model in objects])
        rack = [entry if isinstance(entry, Gripper) else load_gripper(entry) for entry in grippers]
        self._rack = {gripper.name: gripper for gripper in rack}
        self._seed = seed
        self._version = 0
        self._gone: set[int] = set()
        self._view: CellView | None = None
        self._ways: dict[str, ClosingPath | None] = {}
        first = mounted or rack[0].name
        if first not in self._rack:
            raise UnknownGripperError(first, self._rack)
        poses = (
            settle_all(self._objects, self.settings.bin, seed, friction=self.settings.friction)
            if object_poses is None
            else np.asarray(object_poses, dtype=float)
        )
        if poses.shape != (len(self._objects), 4, 4):
            raise InvalidRequestError(
                f"object_poses of shape {poses.shape} were given; expected ({len(objects)}, 4, 4)"
            )
        self._gripper = self._rack[first]
        self._world = self._build(poses)

    @classmethod
    def procedural(
        cls,
        count: int,
        grippers: Sequence[str | Gripper],
        *,
        seed: int = 0,
        mounted: str | None = None,
        settings: CellSettings | None = None,
    ) -> RobotCell:
        """A bin with `count` procedural objects drawn from the seed."""
        if not 1 <= count <= 40:
            raise InvalidRequestError(
                f"{count} objects were asked for; expected 1 to 40, which is what the bin holds"
            )
        seeds = np.random.SeedSequence(seed).generate_state(count)
        objects = [procedural_object(int(one)) for one in seeds]
        return cls(objects, grippers, seed=seed, mounted=mounted, settings=settings)

    @property
    def rack(self) -> tuple[str, ...]:
        """Names of the grippers that `change_tool` can mount."""
        return tuple(self._rack)

    @property
    def gripper(self) -> Gripper:
        """The mounted gripper."""
        return self._gripper

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of all objects, those that have left included; unique."""
        return tuple(self._names)

    @property
    def remaining(self) -> tuple[str, ...]:
        """Names of the objects in the bin."""
        return tuple(name for i, name in enumerate(self._names) if i not in self._gone)

    @property
    def objects_left(self) -> int:
        """Number of objects in the bin."""
        return len(self._names) - len(self._gone)

    @property
    def region(self) -> OrientedBox:
        """Inside of the bin in the world frame."""
        return self.settings.bin.region()

    @property
    def version(self) -> int:
        """Counts the attempts; a cloud of an older version no longer shows the scene."""
        return self._version

    def object_poses(self) -> dict[str, NDArray[np.float64]]:
        """world_from_object (4, 4) of the objects in the bin, by name."""
        poses = self._world.object_poses()
        return {name: poses[i].copy() for i, name in enumerate(self._names) if i not in self._gone}

    def look(self) -> CellView:
        """A picture of the bin, without the gripper.

        Its noise depends on the seed and the number of attempts so far, not on how often one
        looks: a run can then be repeated however fast the reader is.
        """
        if self._view is None:
            rng = np.random.default_rng([self._seed, self._version, 1])
            camera = self.settings.camera
            view = render_view(self._world, camera)
            noise = self.settings.noise
            depth = view.depth if noise is None else noise.apply(view, rng)
            cloud = Cloud(depth_to_points(depth, camera), None, camera.position)
            self._view = CellView(cloud, depth, camera)
        return self._view

    def capture(self) -> Cloud:
        """The cloud of `look`, in the world frame."""
        return self.look().cloud

    def execute(
        self,
        world_from_gripper: NDArray[np.float64],
        approach: NDArray[np.float64] | None = None,
        opening: float = 0.0,
        *,
        on_phase: Callable[[str], None] | None = None,
    ) -> ExecutionResult:
        """Approaches, closes, lifts, shakes; then the gripper leaves and the objects come to rest.

        world_from_gripper: (4, 4) pre-grasp. approach: (4, 4) world_from_gripper at the stand-off,
        from where the path to the pre-grasp is tested for collision; None: no path is tested.
        opening: share of the way from open to closed at which the fingers start.
        on_phase: called at the beginning of `approach`, `close`, `lift` and `drop`; may raise
        CancelledError.

        Physics that diverge are a failure, `unstable`. Raises InvalidRequestError for something
        that is no pose, CancelledError; the scene is then as before.
        """
        pose = checked_pose(world_from_gripper, "world_from_gripper")
        start = None if approach is None else checked_pose(approach, "approach")
        cycle = PickCycle(self._world)
        verdict = cycle.carry_out(pose, start, opening, on_phase=on_phase)
        lifted = sorted(verdict.lifted) if verdict.success else []
        spilled = [i for i in outside_bin(self._world) if i not in lifted]
        for index in spilled:
            self._world.park_object(index)
        self._gone.update(lifted, spilled)
        self._version += 1
        self._view = None
        return ExecutionResult(
            success=bool(verdict.success),
            removed=tuple(self._names[i] for i in lifted),
            spilled=tuple(self._names[i] for i in spilled),
            objects_left=self.objects_left,
            error="" if verdict.success else verdict.reason.value,
            depth=float(verdict.depth),
            width=self._width(cycle.joints),
        )

    def execute_grasp(self, grasp: RankedGrasp) -> ExecutionResult:
        """The grasp as it was checked: from its stand-off, at its opening; see `execute`."""
        return self.execute(
            grasp.world_from_gripper, grasp.world_from_gripper_approach, grasp.share
        )

    def _width(self, joints: dict[str, float]) -> float:
        if self._gripper.name not in self._ways:
            self._ways[self._gripper.name] = gripper_probe(self._gripper).closing
        way = self._ways[self._gripper.name]
        if way is None or not joints:
            return math.nan
        return float(np.interp(self._gripper.share_of(joints), way.shares, way.widths))

    def change_tool(self, name: str) -> None:
        """Mounts another gripper of the rack; the objects stay where they are, at rest.

        Raises UnknownGripperError, listing the rack, and then keeps the mounted gripper.
        """
        if name not in self._rack:
            raise UnknownGripperError(name, self._rack)
        if name == self._gripper.name:
            return
        previous, self._gripper = self._gripper, self._rack[name]
        try:
            self._world = self._build(self._world.object_poses())
        except Exception:
            self._gripper = previous
            raise

    def _build(self, poses: NDArray[np.float64]) -> World:
        world = build_world(
            self._objects,
            gripper=self._gripper,
            bin=self.settings.bin,
            friction=self.settings.friction,
            object_poses=poses,
        )
        for index in self._gone:
            world.park_object(index)
        world.forward()
        return world
