"""A MuJoCo world of objects on a support and at most one gripper, with exact save and restore."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import SimulationError

from .assembly import GRIPPER_PREFIX, GUARD_CONTYPE, Guard, assemble
from .coordinates import read_pose, write_pose
from .hand import Hand, HandPosture
from .support import Bin

if TYPE_CHECKING:
    from megrasp_core.grippers import Gripper
    from megrasp_core.objects import ObjectModel

STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
SCENERY, GRIPPER, GUARD = -1, -2, -3
"""Owners of geoms in `World.owner`; objects own theirs by index (0 and up)."""

PARKED_AT = (20.0, 20.0, 5.0)
"""Corner of the row where objects and gripper wait, weightless and out of sight (m)."""


@dataclass(frozen=True)
class WorldState:
    """What `World.save` keeps: MuJoCo's integration state and the parked objects."""

    vector: NDArray[np.float64]
    parked: frozenset[int]


class World:
    """Objects, support and gripper with their MuJoCo model and data; see `build_world`."""

    def __init__(
        self,
        model: mujoco.MjModel,
        objects: Sequence[ObjectModel],
        gripper: Gripper | None,
        bin: Bin | None,
        obstacles: Collection[int],
        *,
        locked: bool = False,
    ) -> None:
        self.model = model
        self.data = mujoco.MjData(model)
        self._warnings = [
            self.data.warning[int(kind)]
            for kind in (
                mujoco.mjtWarning.mjWARN_BADQPOS,
                mujoco.mjtWarning.mjWARN_BADQVEL,
                mujoco.mjtWarning.mjWARN_BADQACC,
            )
        ]
        self.objects = tuple(objects)
        self.gripper = gripper
        self.bin = bin
        self.obstacles = frozenset(obstacles)
        self.has_table = any(model.geom(i).name == "table" for i in range(model.ngeom))
        self._parked: set[int] = set()
        self._object_body = np.array(
            [model.body(f"object_{i}").id for i in range(len(self.objects))], dtype=np.int64
        )
        joints = model.body_jntadr[self._object_body]
        self._object_qpos = model.jnt_qposadr[joints][:, None] + np.arange(7)
        self._object_dof = model.jnt_dofadr[joints][:, None] + np.arange(6)
        self.owner = self._geom_owners()
        self._hand = (
            Hand(model, self.data, gripper, locked=locked) if gripper is not None else None
        )
        if self._hand is not None:
            self.park_gripper()
        model.body_gravcomp[self._object_body] = 0.0
        for index in range(len(self.objects)):
            self.park_object(index)
        self.forward()

    def _geom_owners(self) -> NDArray[np.int64]:
        model = self.model
        body_owner = np.full(model.nbody, SCENERY, dtype=np.int64)
        body_owner[self._object_body] = np.arange(len(self.objects))
        for body in range(model.nbody):
            if model.body(body).name.startswith(GRIPPER_PREFIX):
                body_owner[body] = GRIPPER
        owner = body_owner[model.geom_bodyid]
        for geom in range(model.ngeom):
            if model.geom(geom).name.startswith("guard_"):
                owner[geom] = GUARD
        return owner

    # ---------------------------------------------------------------- objects

    @property
    def parked(self) -> frozenset[int]:
        """Objects that are out of the scene."""
        return frozenset(self._parked)

    @property
    def present(self) -> list[int]:
        """Objects that are in the scene, ascending."""
        return [i for i in range(len(self.objects)) if i not in self._parked]

    @property
    def object_bodies(self) -> NDArray[np.int64]:
        """(n,) body of each object in `model`."""
        return self._object_body

    @property
    def object_dofs(self) -> NDArray[np.int64]:
        """(n, 6) degrees of freedom of each object in `model`: three to move, three to turn."""
        return self._object_dof

    def object_poses(self) -> NDArray[np.float64]:
        """World-from-object of every object, parked ones too; (n, 4, 4)."""
        poses = [read_pose(self.data.qpos, address) for address in self._object_qpos]
        return np.array(poses).reshape(-1, 4, 4)

    def set_object_poses(self, poses: NDArray[np.float64]) -> None:
        """Put all objects into the scene, at rest, at world-from-object `poses` (n, 4, 4)."""
        if poses.shape != (len(self.objects), 4, 4):
            raise SimulationError(
                f"object poses have shape {poses.shape}; expected ({len(self.objects)}, 4, 4)"
            )
        for index, pose in enumerate(poses):
            self.place_object(index, pose)
        self.forward()

    def object_speeds(self) -> NDArray[np.float64]:
        """Speed (m/s) and rate of turn (rad/s) of the objects in the scene, (k, 2)."""
        velocity = self.data.qvel[self._object_dof[self.present]].reshape(-1, 2, 3)
        return np.linalg.norm(velocity, axis=-1)

    def set_drag(self, rate: float) -> None:
        """Brake all objects: speed by `rate` (1/s), rotation four times as much; 0 ends it."""
        mass = self.model.body_mass[self._object_body]
        inertia = self.model.body_inertia[self._object_body].max(axis=1, initial=0.0)
        self.model.dof_damping[self._object_dof[:, :3]] = rate * mass[:, None]
        self.model.dof_damping[self._object_dof[:, 3:]] = 4.0 * rate * inertia[:, None]

    def place_object(self, index: int, world_from_object: NDArray[np.float64]) -> None:
        """Put one object, at rest, at a pose (4, 4) of the world and let gravity act on it."""
        write_pose(self.data.qpos, self._object_qpos[index], world_from_object)
        self.data.qvel[self._object_dof[index]] = 0.0
        self.data.qacc_warmstart[self._object_dof[index]] = 0.0
        self._parked.discard(index)
        self.model.body_gravcomp[self._object_body[index]] = 0.0

    def park_object(self, index: int) -> None:
        """Take an object out of the scene: far away, weightless, at rest."""
        pose = np.eye(4)
        pose[:3, 3] = PARKED_AT
        pose[0, 3] += 1.0 + index
        self.place_object(index, pose)
        self._parked.add(index)
        self.model.body_gravcomp[self._object_body[index]] = 1.0

    def set_guard(self, stands: bool) -> None:
        """Whether the walls of `guard`, where there are any, stop objects."""
        self.model.geom_contype[self.owner == GUARD] = GUARD_CONTYPE if stands else 0

    # ---------------------------------------------------------------- gripper

    @property
    def hand(self) -> Hand:
        """The gripper. Raises SimulationError in a world without one."""
        if self._hand is None:
            raise SimulationError(
                "this world has no gripper; pass gripper=... to build_world to place one"
            )
        return self._hand

    def place_gripper(
        self, world_from_gripper: NDArray[np.float64], posture: HandPosture = "open"
    ) -> None:
        """Put the gripper, at rest in a posture, at a pose (4, 4), driven to hold that posture."""
        self.hand.place(world_from_gripper, posture)

    def park_gripper(self) -> None:
        """Move the open gripper out of the scene."""
        pose = np.eye(4)
        pose[:3, 3] = PARKED_AT
        pose[1, 3] += 10.0
        self.hand.place(pose, "open")

    def gripper_depth(self) -> float:
        """Deepest penetration of the gripper with anything, m; 0 if nothing is touched.

        Brings poses and contacts up to date; forces are not computed.
        """
        self.detect_contacts()
        return self.contact_depth()

    def contact_depth(self) -> float:
        """Deepest penetration of the gripper in the contacts of the last step or detection, m."""
        contact = self.data.contact
        distance = contact.dist
        if distance.size == 0:
            return 0.0
        involved = (self.owner[contact.geom] == GRIPPER).any(axis=1)
        return float(max(0.0, -distance[involved].min(initial=0.0)))

    def gripper_contacts(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Penetration (n,) (m) and place (n, 3) (m, world) of the gripper's contacts with anything
        else in the last step or detection.
        """
        contact = self.data.contact
        if contact.dist.size == 0:
            return np.zeros(0), np.zeros((0, 3))
        involved = (self.owner[contact.geom] == GRIPPER).any(axis=1)
        return -contact.dist[involved], contact.pos[involved].copy()

    def touched(self) -> tuple[set[int], bool]:
        """Objects that touched the gripper in the last step, and whether table or bin did."""
        owner = self.owner[self.data.contact.geom]
        if owner.size == 0:
            return set(), False
        first, second = owner[:, 0], owner[:, 1]
        found = set(second[first == GRIPPER].tolist())
        found.update(first[second == GRIPPER].tolist())
        return {i for i in found if i >= 0}, SCENERY in found

    # ---------------------------------------------------------------- state

    def save(self) -> WorldState:
        """State that `restore` brings back exactly."""
        vector = np.empty(mujoco.mj_stateSize(self.model, STATE))
        mujoco.mj_getState(self.model, self.data, vector, STATE)
        return WorldState(vector, self.parked)

    def restore(self, state: WorldState) -> None:
        """Go back to a saved state; the next step or check updates poses and contacts."""
        mujoco.mj_setState(self.model, self.data, state.vector, STATE)
        self._parked = set(state.parked)
        gravcomp = np.zeros(len(self.objects))
        gravcomp[list(state.parked)] = 1.0
        self.model.body_gravcomp[self._object_body] = gravcomp

    def forward(self) -> None:
        """Bring everything derived from the state up to date."""
        mujoco.mj_forward(self.model, self.data)

    def step(self, count: int = 1) -> None:
        """Advance by so many timesteps."""
        mujoco.mj_step(self.model, self.data, nstep=count)

    def detect_contacts(self) -> None:
        """Bring link poses and contacts up to date, at a third of the cost of `forward`."""
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)

    def unstable(self) -> bool:
        """Whether the simulation has diverged since `clear_warnings`."""
        return any(warning.number > 0 for warning in self._warnings)

    def clear_warnings(self) -> None:
        """Forget MuJoCo's warnings, see `unstable`."""
        for warning in self._warnings:
            warning.number = 0


def build_world(
    objects: Sequence[ObjectModel],
    *,
    gripper: Gripper | None = None,
    bin: Bin | None = None,
    friction: float | None = None,
    timestep: float = 0.002,
    gravity: bool = True,
    obstacles: Collection[int] = (),
    object_poses: NDArray[np.float64] | None = None,
    table: bool = True,
    visual: bool = False,
    guard: Guard | None = None,
    locked: bool = False,
) -> World:
    """Compile a world: support surface z = 0, z up.

    Args:
        objects: in it.
        gripper: in it, parked out of the scene; None: none.
        bin: on the table; None: the table alone.
        friction: sliding friction of everything; None: each object's own (0.8 by default).
        timestep: (s).
        gravity: whether it pulls.
        obstacles: indices of objects that must not be lifted.
        object_poses: world_from_object (n, 4, 4); None: all objects start parked out of the scene.
        table: whether there is a support at all (free space has none).
        visual: whether to add the visual meshes to the MuJoCo model, which only MuJoCo's own
            viewer needs.
        guard: walls that keep falling objects in; None: none.
        locked: whether joints that the gripper's grasps do not move are fixed (`idle.py`).

    Raises:
        SimulationError: an obstacle is no object, or MuJoCo cannot compile the model.
    """
    wrong = [i for i in obstacles if not 0 <= i < len(objects)]
    if wrong:
        raise SimulationError(f"obstacles {wrong} are not indices of the {len(objects)} objects")
    try:
        model = assemble(
            objects,
            gripper=gripper,
            bin=bin,
            table=table,
            friction=friction,
            timestep=timestep,
            gravity=gravity,
            visual=visual,
            guard=guard,
            locked=locked,
        )
    except ValueError as error:
        names = ", ".join(model.name for model in objects)
        raise SimulationError(
            f"MuJoCo cannot build a world of gripper {gripper.name if gripper else None!r} and "
            f"objects {names}: {error}"
        ) from error
    world = World(model, objects, gripper, bin, obstacles, locked=locked)
    if object_poses is not None:
        world.set_object_poses(object_poses)
    return world
