"""Class Gripper: a loaded description with model, postures, clouds and tokens."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property, lru_cache
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import DescriptionError, InvalidRequestError
from megrasp_core.meshes import Mesh

from .cache import recalled
from .clouds import GripperClouds, GripperTokens, make_clouds, make_tokens, surface_points
from .description import GripperDescription, load_description
from .geometry import BodyMesh, body_meshes, body_poses, geometry_arrays, posed
from .model import build_spec, compile_spec
from .posture import Posture, resolve_posture
from .render import RENDERER
from .stroke import Stroke, drive_stroke, make_stroke

POSTURES = ("open", "closed")
TOKEN_CLOUD = 1024


class Gripper:
    """A gripper ready for rendering, simulation and the network; frames and words as in
    docs/architecture.md.

    Loading compiles the model and checks the whole description, so a Gripper that exists is valid.
    Results that cost time are kept on the instance, clouds and collision points also on disk
    (`cache.py`); it holds no other state and may be shared between threads that only read.

    Raises:
        DescriptionError: model, joints, actuators, links or postures do not fit each other.
    """

    def __init__(self, description: GripperDescription) -> None:
        self.description = description
        self._spec = build_spec(description)
        self.model: mujoco.MjModel = compile_spec(self._spec, description)
        self._postures = {
            name: resolve_posture(self.model, description, name) for name in POSTURES
        }
        self._clouds = lru_cache(maxsize=8)(self._make_clouds)
        self._tokens = lru_cache(maxsize=8)(self._make_tokens)
        self._collision_points = lru_cache(maxsize=4)(self._make_collision_points)

    def __reduce__(self) -> tuple[type[Gripper], tuple[GripperDescription]]:
        """Travel between processes as the description; the model is loaded again there."""
        return Gripper, (self.description,)

    @classmethod
    def from_path(cls, path: str | Path) -> Gripper:
        """Load the `gripper.yaml` at `path`, a file or its folder."""
        return cls(load_description(path))

    @property
    def name(self) -> str:
        """Registered name."""
        return self.description.name

    @property
    def tcp(self) -> NDArray[np.float64]:
        """TCP (3,) in the gripper frame, metres."""
        return np.array(self.description.tcp)

    @property
    def gripper_from_tcp(self) -> NDArray[np.float64]:
        """Pose (4, 4) of the TCP frame in the gripper frame, a pure translation."""
        out = np.eye(4)
        out[:3, 3] = self.tcp
        return out

    @property
    def tcp_from_gripper(self) -> NDArray[np.float64]:
        """Pose (4, 4) of the gripper frame in the TCP frame, the inverse of `gripper_from_tcp`."""
        out = np.eye(4)
        out[:3, 3] = -self.tcp
        return out

    @property
    def open_joints(self) -> dict[str, float]:
        """All joint positions of the open posture, in model order."""
        return dict(self._postures["open"].joints)

    @property
    def closed_joints(self) -> dict[str, float]:
        """All joint positions of the closed posture (closed on nothing), in model order."""
        return dict(self._postures["closed"].joints)

    @cached_property
    def hash(self) -> str:
        """Hash of the description and of every file of its model; comments and the folder's place
        do not count.
        """
        digest = hashlib.sha256(json.dumps(self.description.to_dict(), sort_keys=True).encode())
        for file in self.model_files():
            digest.update(file.read_bytes())
        return digest.hexdigest()[:16]

    def model_files(self) -> list[Path]:
        """Return the model file and the mesh files it uses, sorted after the first."""
        path = self.description.model_path
        spec = mujoco.MjSpec.from_file(str(path))
        folder = path.parent / (spec.meshdir or "")
        meshes = {folder / mesh.file for mesh in spec.meshes if mesh.file}
        return [path, *sorted(file for file in meshes if file.is_file())]

    def spec(self) -> mujoco.MjSpec:
        """Return a fresh copy of the model; the frame of its root body "gripper" is the gripper
        frame.
        """
        return self._spec.copy()

    def control(self, posture: str) -> NDArray[np.float64]:
        """Return the control (nu,) that drives to the posture "open" or "closed"."""
        return self._posture(posture).control.copy()

    def posture(self, posture: str) -> dict[str, float]:
        """Return joint name -> position of the posture "open" or "closed"."""
        return dict(self._posture(posture).joints)

    def qpos(self, posture: str) -> NDArray[np.float64]:
        """Return the joint positions (nq,) of `self.model` in the posture "open" or "closed"."""
        return self._posture(posture).qpos.copy()

    def body_poses(self, posture: str) -> NDArray[np.float64]:
        """Return gripper_from_body (nbody, 4, 4) of `self.model` in a posture."""
        return body_poses(self.model, self._posture(posture).qpos)

    def meshes(self, posture: str, which: str = "visual") -> list[Mesh]:
        """Return the mesh of every visual or collision geom in the gripper frame."""
        return posed(self.body_meshes(which), self.body_poses(posture))

    def body_meshes(self, which: str = "visual") -> list[BodyMesh]:
        """Return the meshes of the "visual" or "collision" geoms in the frames of their bodies."""
        if which not in ("visual", "collision"):
            raise InvalidRequestError(f"which is {which!r}; expected 'visual' or 'collision'")
        return self._visual_meshes if which == "visual" else self._collision_meshes

    def clouds(self, count: int = TOKEN_CLOUD, seed: int = 0) -> GripperClouds:
        """Return the outer surface of both postures, `count` points each, in the gripper frame."""
        return self._clouds(count, seed)

    def tokens(self, count: int = 32, seed: int = 0) -> GripperTokens:
        """Return the network's view of the gripper: `count` open and `count` closed points in TCP
        coordinates.
        """
        return self._tokens(count, seed)

    def collision_points(
        self, spacing: float = 0.005
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return points (M, 3) on the open posture's collision surface and their finger group
        (M,), -1 for the palm.
        """
        points, bodies = self._collision_points(spacing)
        return points, self.finger_groups[bodies]

    def collision_bodies(self, spacing: float = 0.005) -> NDArray[np.int64]:
        """Return the body (M,) of `self.model` that each of the `collision_points` lies on."""
        return self._collision_points(spacing)[1]

    @cached_property
    def stroke(self) -> Stroke:
        """Postures from open to closed, as the fingers take them when they close on nothing."""
        opened, closed = self._postures["open"], self._postures["closed"]
        inputs = (
            *(array for posture in (opened, closed) for array in (posture.qpos, posture.control)),
            self.hash,
        )
        found = recalled(
            "stroke", inputs, lambda: {"qpos": drive_stroke(self.model, opened, closed)}
        )
        return make_stroke(self.model, found["qpos"])

    def share_of(self, joints: Mapping[str, float]) -> float:
        """Return the share of the stroke, 0 open to 1 closed, at which the joints are nearest to
        given positions; joints that are not named do not count.
        """
        names = [self.model.joint(i).name for i in range(self.model.njnt)]
        known = [i for i, name in enumerate(names) if name in joints]
        adr = self.model.jnt_qposadr[known]
        wanted = np.array([joints[names[i]] for i in known], dtype=np.float64)
        fine = np.linspace(0.0, 1.0, 8 * (len(self.stroke.shares) - 1) + 1)
        way = np.stack([self.stroke.qpos_at(share)[adr] for share in fine])
        return float(fine[np.square(way - wanted).sum(axis=1).argmin()])

    def posture_at(self, share: float) -> dict[str, float]:
        """Return joint name -> position at a share of the stroke, 0 open to 1 closed."""
        if share == 0.0:
            return self.open_joints
        qpos = self.stroke.qpos_at(share)
        return {
            self.model.joint(i).name: float(qpos[self.model.jnt_qposadr[i]])
            for i in range(self.model.njnt)
        }

    def pad_points(self, posture: str, group: int, spacing: float = 0.004) -> NDArray[np.float64]:
        """Return collision surface points (M, 3) of a finger group in a posture, gripper frame."""
        meshes = self.body_meshes("collision")
        groups = self.finger_groups[[mesh.body for mesh in meshes]]
        poses = self.body_poses(posture)
        chosen = [mesh for mesh, owner in zip(meshes, groups, strict=True) if owner == group]
        if not chosen:
            raise InvalidRequestError(
                f"finger group {group} has no collision geometry; groups: 0 to "
                f"{len(self.description.fingers) - 1}"
            )
        return surface_points(posed(chosen, poses), spacing).points

    @cached_property
    def finger_groups(self) -> NDArray[np.int64]:
        """Finger group (nbody,) of every body of `self.model`: its own or that of the nearest
        parent, else -1.
        """
        groups = np.full(self.model.nbody, -1, np.int64)
        named = {
            link: index for index, links in enumerate(self.description.fingers) for link in links
        }
        for body in range(1, self.model.nbody):
            groups[body] = named.get(
                self.model.body(body).name, groups[self.model.body_parentid[body]]
            )
        return groups

    @contextmanager
    def _explained(self, which: str) -> Iterator[None]:
        """Turn what the renderer says of a gripper without a surface into a DescriptionError."""
        try:
            yield
        except ValueError as error:
            path = self.description.model_path
            raise DescriptionError(
                f"{path}: the {which} geometry cannot be rendered: {error}. Expected shapes that "
                f"can be seen from outside; `megrasp gripper new {path.name}` takes visual shapes "
                "where a model has no collision geometry"
            ) from error

    @cached_property
    def _visual_meshes(self) -> list[BodyMesh]:
        return body_meshes(self.model, "visual")

    @cached_property
    def _collision_meshes(self) -> list[BodyMesh]:
        return body_meshes(self.model, "collision")

    def _posture(self, name: str) -> Posture:
        if name not in self._postures:
            raise InvalidRequestError(
                f"posture is {name!r}; expected one of {', '.join(POSTURES)}"
            )
        return self._postures[name]

    def _make_clouds(self, count: int, seed: int) -> GripperClouds:
        if count < 1:
            raise InvalidRequestError(f"count is {count}; expected at least 1 point")
        poses = self.body_poses("open"), self.body_poses("closed")
        with self._explained("visual"):
            return GripperClouds(
                **recalled(
                    "clouds",
                    (RENDERER, "bodies", count, seed, *poses, *geometry_arrays(self.model)),
                    lambda: vars(make_clouds(self.body_meshes(), *poses, count, seed)),
                )
            )

    def _make_tokens(self, count: int, seed: int) -> GripperTokens:
        if not 1 <= count <= TOKEN_CLOUD // 2:
            raise InvalidRequestError(
                f"count is {count}; expected 1 to {TOKEN_CLOUD // 2} tokens a posture"
            )
        return make_tokens(self.clouds(TOKEN_CLOUD, seed), self.description.tcp, count)

    def _make_collision_points(
        self, spacing: float
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        if spacing <= 0.0:
            raise InvalidRequestError(f"spacing is {spacing}; expected more than 0 m")
        poses = self.body_poses("open")

        def make() -> dict[str, NDArray]:
            meshes = self.body_meshes("collision")
            sample = surface_points(posed(meshes, poses), spacing)
            bodies = np.array([mesh.body for mesh in meshes])
            return {"points": sample.points, "bodies": bodies[sample.mesh]}

        inputs = (RENDERER, spacing, poses, *geometry_arrays(self.model))
        with self._explained("collision"):
            found = recalled("collision_points", inputs, make)
        return found["points"], found["bodies"]
