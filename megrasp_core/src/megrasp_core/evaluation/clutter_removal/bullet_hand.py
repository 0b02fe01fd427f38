"""A hand whose fingers slide, in PyBullet.

Bodies, shapes, strokes and forces are those of the gripper's description. The palm hangs on three
motors along the axes of a frame that is set to the pre-grasp, so that it moves straight and does
not turn; the fingers are geared together, as the hands that have one motor are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from megrasp_core.errors import InvalidRequestError
from megrasp_core.grippers import Gripper
from megrasp_core.meshes import Mesh, joined

from .bullet_shapes import convex_shape, visible_shape

CARRIAGE_FORCE = 2000.0
"""Of each of the motors that move the palm (N)."""
PALM_MASS, LEAST_FINGER_MASS = 1.0, 0.1
"""kg. The solver holds an object of some hundred grams badly between fingers of fifteen."""
CLOSING_SPEED = 0.1
"""Of a finger (m/s)."""
AWAY = np.array([0.0, 0.0, 5.0])
"""Where the hand waits (m)."""
COLOUR = (0.55, 0.63, 0.78)
PALM = 2
"""Link of the palm; 0 and 1 are slides without a shape, the fingers follow."""


@dataclass(frozen=True, eq=False)
class Finger:
    """A finger at the open posture, in the gripper frame.

    joint: name. axis: (3,) in which it moves to close, of length 1. stroke: its way (m). force: of
    its motor (N). mass: (kg). meshes: its shapes.
    """

    joint: str
    axis: NDArray[np.float64]
    stroke: float
    force: float
    mass: float
    meshes: list[Mesh]


def sliding_fingers(gripper: Gripper) -> tuple[list[Mesh], list[Finger]]:
    """The shapes of the palm and the fingers of a gripper.

    Raises:
        InvalidRequestError: a finger turns, or hangs on another.
    """
    model = gripper.model
    slides = mujoco.mjtJoint.mjJNT_SLIDE
    moving = [j for j in range(model.njnt)]
    parents = {int(model.body_parentid[model.jnt_bodyid[j]]) for j in moving}
    carried = {int(model.jnt_bodyid[j]) for j in moving}
    if not moving or any(model.jnt_type[j] != slides for j in moving) or parents & carried:
        raise InvalidRequestError(
            f"gripper {gripper.name!r} has fingers that do not slide; expected one such as "
            "franka_hand: PyBullet closes no others here. Give --engine mujoco."
        )
    opened, closed = gripper.qpos("open"), gripper.qpos("closed")
    data = mujoco.MjData(model)
    data.qpos[:], data.ctrl[:] = opened, gripper.control("closed")
    mujoco.mj_forward(model, data)
    poses = gripper.body_poses("open")
    shapes = gripper.body_meshes("collision")
    owner = np.arange(model.nbody)
    for body in range(1, model.nbody):
        if body not in carried:
            owner[body] = owner[model.body_parentid[body]]
    forces = [abs(float(data.qfrc_actuator[model.jnt_dofadr[j]])) for j in moving]
    fingers = []
    for joint in moving:
        body, address = int(model.jnt_bodyid[joint]), model.jnt_qposadr[joint]
        way = float(closed[address] - opened[address])
        axis = poses[body, :3, :3] @ model.jnt_axis[joint] * np.sign(way)
        fingers.append(
            Finger(
                model.joint(joint).name,
                axis / np.linalg.norm(axis),
                abs(way),
                # Where one motor drives them all, the others have none in the model.
                sum(forces) / len(forces),
                max(LEAST_FINGER_MASS, float(model.body_mass[owner == body].sum())),
                [s.mesh.moved(poses[s.body]) for s in shapes if owner[s.body] == body],
            )
        )
    palm = [s.mesh.moved(poses[s.body]) for s in shapes if owner[s.body] not in carried]
    return palm, fingers


class BulletHand:
    """The hand as a PyBullet body.

    Attributes:
        body: its number in the engine.
    """

    def __init__(self, engine: Any, gripper: Gripper, friction: float) -> None:
        """Make the hand out of the scene.

        engine: a PyBullet client. friction: of its surface.
        """
        self._engine = engine
        self._gripper = gripper
        palm, self.fingers = sliding_fingers(gripper)
        self._open = gripper.open_joints
        parts = [palm, *(finger.meshes for finger in self.fingers)]
        middles = [np.concatenate([m.vertices for m in part]).mean(axis=0) for part in parts]
        shapes = [self._shapes(part, middle) for part, middle in zip(parts, middles)]
        count = 2 + len(parts)
        axes = [*np.eye(3), *(finger.axis for finger in self.fingers)]
        offsets = [np.zeros(3), np.zeros(3), middles[0], *(m - middles[0] for m in middles[1:])]
        self.body = engine.createMultiBody(
            baseMass=0.0,
            basePosition=AWAY.tolist(),
            linkMasses=[0.2, 0.2, PALM_MASS, *(finger.mass for finger in self.fingers)],
            linkCollisionShapeIndices=[-1, -1, *(collision for collision, _ in shapes)],
            linkVisualShapeIndices=[-1, -1, *(visual for _, visual in shapes)],
            linkPositions=[offset.tolist() for offset in offsets],
            linkOrientations=[[0.0, 0.0, 0.0, 1.0]] * count,
            linkInertialFramePositions=[[0.0, 0.0, 0.0]] * count,
            linkInertialFrameOrientations=[[0.0, 0.0, 0.0, 1.0]] * count,
            linkParentIndices=[0, 1, 2, *([PALM + 1] * len(self.fingers))],
            linkJointTypes=[engine.JOINT_PRISMATIC] * count,
            linkJointAxis=[axis.tolist() for axis in axes],
        )
        for link in range(count):
            engine.changeDynamics(
                self.body, link, lateralFriction=friction,
                linearDamping=0.0, angularDamping=0.0, jointDamping=0.0,
            )  # fmt: skip
            engine.setCollisionFilterGroupMask(self.body, link, 2, 1)
        self._first = PALM + 1
        for link in range(self._first + 1, count):
            gear = engine.createConstraint(
                self.body, self._first, self.body, link, engine.JOINT_GEAR,
                [1, 0, 0], [0, 0, 0], [0, 0, 0],
            )  # fmt: skip
            force = 2.0 * self.fingers[0].force
            engine.changeConstraint(gear, gearRatio=-1, erp=0.2, maxForce=force)
        self.leave()

    def _shapes(self, part: list[Mesh], middle: NDArray[np.float64]) -> tuple[int, int]:
        """Collision and visual shape of a part, in its own frame."""
        moved = [Mesh(mesh.vertices - middle, mesh.faces) for mesh in part]
        return (
            convex_shape(self._engine, moved),
            visible_shape(self._engine, joined(moved), COLOUR),
        )

    def place(self, world_from_gripper: NDArray[np.float64], opening: float = 0.0) -> None:
        """Put the hand, at rest, at a pose (4, 4), fingers at a share of their way to closed."""
        engine = self._engine
        engine.resetBasePositionAndOrientation(
            self.body,
            world_from_gripper[:3, 3].tolist(),
            Rotation.from_matrix(world_from_gripper[:3, :3]).as_quat().tolist(),
        )
        for link in range(self._first):
            engine.resetJointState(self.body, link, 0.0, 0.0)
        for number, way in enumerate(self._ways(opening)):
            engine.resetJointState(self.body, self._first + number, way, 0.0)
        self.drive(np.zeros(3))
        self.hold(opening)

    def leave(self) -> None:
        """Take the open hand out of the scene."""
        pose = np.eye(4)
        pose[:3, 3] = AWAY
        self.place(pose)

    def drive(self, offset: NDArray[np.float64]) -> None:
        """Command the palm to a place (3,) in the frame in which it was put (m)."""
        self._engine.setJointMotorControlArray(
            self.body,
            range(self._first),
            self._engine.POSITION_CONTROL,
            targetPositions=offset.tolist(),
            forces=[CARRIAGE_FORCE] * 3,
            positionGains=[0.8] * 3,
            velocityGains=[1.0] * 3,
        )

    def jump(self, offset: NDArray[np.float64]) -> None:
        """Put the palm, at rest, at a place (3,) in the frame in which it was put (m)."""
        for link in range(3):
            self._engine.resetJointState(self.body, link, float(offset[link]), 0.0)
        self.drive(offset)

    def hold(self, opening: float) -> None:
        """Command the fingers to a share of their way."""
        for number, way in enumerate(self._ways(opening)):
            self._engine.setJointMotorControl2(
                self.body,
                self._first + number,
                self._engine.POSITION_CONTROL,
                targetPosition=way,
                force=self.fingers[number].force,
                maxVelocity=CLOSING_SPEED,
            )

    def ways(self) -> list[float]:
        """How far each finger has come from open towards closed (m)."""
        links = range(self._first, self._first + len(self.fingers))
        return [state[0] for state in self._engine.getJointStates(self.body, links)]

    def link_places(self) -> list[NDArray[np.float64]]:
        """Where palm and fingers are: the middle of each, world (3,) (m)."""
        links = range(PALM, self._first + len(self.fingers))
        states = self._engine.getLinkStates(self.body, links, computeForwardKinematics=1)
        return [np.array(state[0]) for state in states]

    def _ways(self, opening: float) -> list[float]:
        joints = self._gripper.posture_at(opening)
        return [abs(joints[f.joint] - self._open[f.joint]) for f in self.fingers]
