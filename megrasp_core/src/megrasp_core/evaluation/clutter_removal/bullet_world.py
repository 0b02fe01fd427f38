"""The rounds' world in PyBullet, without a display; its camera is PyBullet's software renderer."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from megrasp_core.errors import MissingPackageError
from megrasp_core.grippers import Gripper
from megrasp_core.meshes import Mesh
from megrasp_core.objects import ObjectModel
from megrasp_core.simulation import Camera, look_at

from .bullet_hand import BulletHand
from .bullet_shapes import convex_shape, visible_shape
from .world import (
    FENCE,
    LIFT,
    MAX_DEPTH,
    MIN_RISE,
    PUSHED,
    Attempt,
    ClutterWorld,
    Outcome,
)

TIMESTEP = 1.0 / 240.0
SOLVER_ITERATIONS = 150
SPINNING = 0.01
"""How far from their middle contacts bear torque (m), as in the project's other simulations."""
ROLLING = 0.0005
"""The same for rolling: balls come to rest."""
PARKED = np.array([20.0, 20.0, 1.0])
NEAR, FAR = 0.1, 2.0
TABLE_COLOUR = [0.72, 0.72, 0.70, 1.0]
APPROACH_POSES = 10
APPROACH_TIME, CLOSE_TIME, LIFT_TIME, HOLD_TIME = 0.5, 0.6, 0.7, 0.5
"""s."""


def _client() -> Any:
    """A client of PyBullet, without what that writes to standard output and standard error."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    kept = [os.dup(stream) for stream in (1, 2)]
    for stream in (1, 2):
        os.dup2(nowhere, stream)
    try:
        import pybullet
        from pybullet_utils.bullet_client import BulletClient

        return BulletClient(pybullet.DIRECT)
    finally:
        # It is written by C, which keeps it back.
        ctypes.CDLL(None).fflush(None)
        for stream, before in zip((1, 2), kept):
            os.dup2(before, stream)
            os.close(before)
        os.close(nowhere)


class BulletWorld(ClutterWorld):
    """Objects, table and a hand with sliding fingers in a PyBullet client of their own.

    Raises:
        MissingPackageError: PyBullet is not installed.
        InvalidRequestError: the gripper's fingers do not slide.
    """

    def __init__(
        self,
        objects: Sequence[ObjectModel],
        gripper: Gripper,
        *,
        friction: float = 0.8,
        pictures: bool = False,
    ) -> None:
        """Make the world.

        friction: sliding friction between any two bodies. pictures: attempts are photographed, see
            `last_hand`.
        """
        super().__init__(objects)
        try:
            engine: Any = _client()
        except ImportError:
            raise MissingPackageError(
                "pybullet",
                "bench",
                "packed and pile (--engine mujoco does without; for Python 3.12 "
                "`pip install pybullet` compiles it)",
            ) from None
        self._engine = engine
        engine.setGravity(0.0, 0.0, -9.81)
        engine.setPhysicsEngineParameter(
            fixedTimeStep=TIMESTEP,
            numSolverIterations=SOLVER_ITERATIONS,
            deterministicOverlappingPairs=1,
        )
        # Bullet multiplies the coefficients of the two bodies.
        self._friction = float(np.sqrt(friction))
        self._table = self._box([1.0, 1.0, 0.05], [0.0, 0.0, -0.05], TABLE_COLOUR)
        self._fence: list[int] = []
        self._turns: list[NDArray[np.float64]] = []
        self._bodies = [self._add(model) for model in objects]
        for index in range(len(self._bodies)):
            self._park(index)
        self.hand = BulletHand(engine, gripper, self._friction)
        self._picture: NDArray[np.uint8] | None = None
        self._pictures = pictures

    def _box(self, half: list[float], place: list[float], colour: list[float] | None) -> int:
        engine = self._engine
        shape = engine.createCollisionShape(engine.GEOM_BOX, halfExtents=half)
        look = -1
        if colour is not None:
            look = engine.createVisualShape(engine.GEOM_BOX, halfExtents=half, rgbaColor=colour)
        body = engine.createMultiBody(0.0, shape, look, place)
        engine.changeDynamics(body, -1, lateralFriction=self._friction)
        return body

    def _add(self, model: ObjectModel) -> int:
        engine = self._engine
        moments, axes = np.linalg.eigh(model.inertia)
        axes = axes * np.sign(np.linalg.det(axes))
        # The body's frame has the principal axes of inertia.
        self._turns.append(axes)
        shape = convex_shape(engine, [Mesh(p.vertices @ axes, p.faces) for p in model.pieces])
        look = visible_shape(engine, Mesh(model.vertices @ axes, model.faces), model.colour)
        body = engine.createMultiBody(model.mass, shape, look)
        engine.changeDynamics(
            body, -1, lateralFriction=self._friction, rollingFriction=ROLLING,
            spinningFriction=SPINNING / self._friction, restitution=0.0,
            localInertiaDiagonal=moments.tolist(),
        )  # fmt: skip
        return body

    # ---------------------------------------------------------------- objects

    def place(self, index: int, world_from_object: NDArray[np.float64]) -> None:
        """Put an object into the scene, at rest, at a pose (4, 4)."""
        body = self._bodies[index]
        turn = world_from_object[:3, :3] @ self._turns[index]
        self._engine.resetBasePositionAndOrientation(
            body, world_from_object[:3, 3].tolist(), Rotation.from_matrix(turn).as_quat().tolist()
        )
        self._engine.resetBaseVelocity(body, [0.0] * 3, [0.0] * 3)
        self._engine.changeDynamics(body, -1, mass=self.objects[index].mass)
        moments = np.linalg.eigvalsh(self.objects[index].inertia)
        self._engine.changeDynamics(body, -1, localInertiaDiagonal=moments.tolist())
        self.present = sorted({*self.present, index})

    def take_out(self, index: int) -> None:
        """Take an object out of the scene."""
        self.present = [i for i in self.present if i != index]
        self._park(index)

    def _park(self, index: int) -> None:
        body = self._bodies[index]
        # Without mass it stays where it is put.
        self._engine.changeDynamics(body, -1, mass=0.0)
        place = PARKED + np.array([float(index), 0.0, 0.0])
        self._engine.resetBasePositionAndOrientation(body, place.tolist(), [0.0, 0.0, 0.0, 1.0])

    def poses(self) -> NDArray[np.float64]:
        """World-from-object (n, 4, 4) of all objects."""
        poses = np.tile(np.eye(4), (len(self._bodies), 1, 1))
        for index, (body, turn) in enumerate(zip(self._bodies, self._turns)):
            place, quaternion = self._engine.getBasePositionAndOrientation(body)
            poses[index, :3, :3] = Rotation.from_quat(quaternion).as_matrix() @ turn.T
            poses[index, :3, 3] = place
        return poses

    def fence(self, stands: bool) -> None:
        """Put up, or take away, four walls; the hand is not there while they stand."""
        for body in self._fence:
            self._engine.removeBody(body)
        middle, height = FENCE / 2 + 0.05, 0.5
        sides = [(middle, 0.0), (-middle, 0.0), (0.0, middle), (0.0, -middle)]
        self._fence = [
            self._box([0.05 if x else FENCE, 0.05 if y else FENCE, height], [x, y, height], None)
            for x, y in (sides if stands else [])
        ]

    def run(self, duration: float) -> None:
        """Let time pass (s)."""
        for _ in range(round(duration / TIMESTEP)):
            self._engine.stepSimulation()

    # ---------------------------------------------------------------- camera

    def depth_image(self, camera: Camera) -> NDArray[np.float32]:
        """What a camera sees without noise, (h, w) in m along its axis, 0 where nothing is."""
        buffer = self._render(camera)[3]
        depth = np.asarray(buffer, np.float64).reshape(camera.height, camera.width)
        metres = FAR * NEAR / (FAR - (FAR - NEAR) * depth)
        return np.where(metres < 0.999 * FAR, metres, 0.0).astype(np.float32)

    def colour_image(self, camera: Camera) -> NDArray[np.uint8]:
        """The scene, hand included, (h, w, 3)."""
        pixels = np.asarray(self._render(camera)[2], np.uint8)
        return pixels.reshape(camera.height, camera.width, 4)[..., :3].copy()

    def _render(self, camera: Camera) -> Any:
        engine = self._engine
        # OpenGL's camera looks along -z with y up, ours along z with y down.
        view = np.linalg.inv(camera.world_from_camera @ np.diag([1.0, -1.0, -1.0, 1.0]))
        lens = list(
            engine.computeProjectionMatrixFOV(
                float(np.rad2deg(camera.fovy)), camera.width / camera.height, NEAR, FAR
            )
        )
        # The renderer looks through the lower left corners of pixels.
        lens[8] += 1.0 / camera.width
        lens[9] += 1.0 / camera.height
        return engine.getCameraImage(
            camera.width,
            camera.height,
            viewMatrix=view.T.ravel().tolist(),
            projectionMatrix=lens,
            shadow=0,
            renderer=engine.ER_TINY_RENDERER,
        )

    def last_hand(self) -> NDArray[np.uint8] | None:
        """Picture (h, w, 3) of the last attempt with its fingers closed."""
        return self._picture

    # ---------------------------------------------------------------- hand

    def depth_at(self, world_from_gripper: NDArray[np.float64], opening: float = 0.0) -> float:
        """How deep (m) the hand, put at a pose (4, 4), is in anything."""
        self.hand.place(world_from_gripper, opening)
        deepest = 0.0
        for body in [self._table, *(self._bodies[i] for i in self.present)]:
            for point in self._engine.getClosestPoints(self.hand.body, body, 0.0):
                deepest = max(deepest, -point[8])
        return deepest

    def touched(self) -> set[int]:
        """Objects that pressed on the hand in the last step."""
        return {
            index
            for index in self.present
            for point in self._engine.getContactPoints(self.hand.body, self._bodies[index])
            # Points a little apart are among them; those that touch have a normal force.
            if point[9] > 0.0
        }

    def attempt(
        self,
        world_from_gripper: NDArray[np.float64],
        approach: NDArray[np.float64],
        opening: float = 0.0,
    ) -> Attempt:
        """See `ClutterWorld.attempt`; the hand stops for good where it is too deep in anything."""
        way = approach[:3, 3] - world_from_gripper[:3, 3]
        depth = 0.0
        for share in np.linspace(1.0, 0.0, APPROACH_POSES + 1):
            pose = world_from_gripper.copy()
            pose[:3, 3] += share * way
            depth = max(depth, self.depth_at(pose, opening))
            if depth > MAX_DEPTH:
                self._photograph(world_from_gripper)
                self.hand.leave()
                return Attempt(Outcome.COLLISION, depth=depth)
        before = self.poses()
        self.hand.place(world_from_gripper, opening)
        to_frame = world_from_gripper[:3, :3].T
        start = to_frame @ way
        self.hand.jump(start)
        self._move(start, np.zeros(3), APPROACH_TIME)
        self.hand.hold(1.0)
        self.run(CLOSE_TIME)
        self._photograph(world_from_gripper)
        caught, closed = self.touched(), self.poses()
        lifted = to_frame @ [0.0, 0.0, LIFT]
        self._move(np.zeros(3), lifted, LIFT_TIME)
        self.run(HOLD_TIME)
        after = self.poses()
        rise = after[:, 2, 3] - before[:, 2, 3]
        held = tuple(i for i in sorted(self.touched()) if rise[i] > MIN_RISE)
        self.hand.leave()
        if not np.isfinite(after).all():
            return Attempt(Outcome.UNSTABLE, depth=depth)
        if held:
            return Attempt(Outcome.SUCCESS, held, depth)
        if caught:
            return Attempt(Outcome.SLIPPED, depth=depth)
        shift = np.linalg.norm(closed[:, :3, 3] - before[:, :3, 3], axis=1)
        pushed = any(shift[i] > PUSHED for i in self.present)
        return Attempt(Outcome.OBJECT_MOVED if pushed else Outcome.NO_CONTACT, depth=depth)

    def _move(self, start: NDArray[np.float64], end: NDArray[np.float64], duration: float) -> None:
        steps = round(duration / TIMESTEP)
        for step in range(1, steps + 1):
            x = step / steps
            self.hand.drive(start + (end - start) * x * x * (3.0 - 2.0 * x))
            self._engine.stepSimulation()

    def _photograph(self, world_from_gripper: NDArray[np.float64]) -> None:
        if not self._pictures:
            return
        # Along Y of the gripper both fingers are seen.
        side = world_from_gripper[:3, 1] * [1.0, 1.0, 0.0]
        side = side / max(float(np.linalg.norm(side)), 1e-6)
        eye = world_from_gripper[:3, 3] + 0.45 * side
        eye[2] = 0.22
        target = world_from_gripper[:3, 3] + 0.08 * world_from_gripper[:3, 2]
        self._picture = self.colour_image(Camera(look_at(eye, target), 480, 420, 0.7))

    def close(self) -> None:
        """End the client."""
        self._engine.disconnect()
