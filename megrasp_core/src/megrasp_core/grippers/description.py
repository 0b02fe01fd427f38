"""The gripper description: `gripper.yaml`, read strictly (docs/own-gripper.md)."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from megrasp_core.errors import DescriptionError

from .fields import Fields, show
from .model_file import MODEL_SUFFIXES, find_model
from .yaml_file import read_yaml

FILE_NAME = "gripper.yaml"
KINDS = ("parallel", "adaptive", "hand")
REQUIRED = (
    "format",
    "name",
    "display_name",
    "kind",
    "model",
    "mount_from_model",
    "tcp",
    "postures",
    "actuation",
    "max_width",
    "min_width",
    "fingers",
    "symmetry",
    "licence",
    "source",
)
VALID = (*REQUIRED, "flange_from_gripper")


@dataclass(frozen=True)
class Pose:
    """A rigid transform `a_from_b`: xyz in metres and a unit quaternion (x, y, z, w)."""

    xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    quat: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)

    def matrix(self) -> NDArray[np.float64]:
        """Return the transform as a (4, 4) homogeneous matrix."""
        out = np.eye(4)
        out[:3, :3] = Rotation.from_quat(self.quat).as_matrix()
        out[:3, 3] = self.xyz
        return out


@dataclass(frozen=True)
class PostureDescription:
    """A posture: joint positions, or actuator controls that the loader settles. Exactly one of
    them is given.
    """

    joints: Mapping[str, float] | None = None
    actuators: Mapping[str, float] | None = None


@dataclass(frozen=True)
class Actuation:
    """Position drive of a joint: stiffness (N/m or Nm/rad), force limit (N or Nm), joint damping,
    armature.
    """

    kp: float
    force: float
    damping: float = 0.0
    armature: float = 0.0


@dataclass(frozen=True)
class GripperDescription:
    """Contents of a `gripper.yaml`. Lengths in metres, angles in radians.

    Attributes:
        name: registered.
        display_name: for people.
        kind: parallel, adaptive or hand.
        model: file beside it, or `asset:` and a path below MEGRASP_ASSETS/grippers.
        mount_from_model: brings the model's axes to the gripper frame.
        tcp: (x, y, z) in the gripper frame.
        open: posture.
        closed: posture, where the fingers end with nothing between them.
        actuation: joint -> drive, where the model's own is not used.
        max_width: widest thing between the open fingers; None for hands.
        min_width: narrowest that they can hold.
        fingers: links of the opposing groups, the first on -X.
        symmetry: n-fold about +Z through the TCP.
        licence: of the model.
        source: where it comes from.
        flange_from_gripper: where the gripper frame is on the robot's flange.
        folder: that it was read from.
    """

    name: str
    display_name: str
    kind: str
    model: str
    mount_from_model: Pose
    tcp: tuple[float, float, float]
    open: PostureDescription
    closed: PostureDescription
    actuation: Mapping[str, Actuation]
    max_width: float | None
    min_width: float
    fingers: tuple[tuple[str, ...], ...]
    symmetry: int
    licence: str
    source: str
    flange_from_gripper: Pose = field(default_factory=Pose)
    folder: Path = field(default_factory=Path)

    @property
    def file(self) -> Path:
        """The gripper.yaml this description was read from."""
        return self.folder / FILE_NAME

    @property
    def model_path(self) -> Path:
        """The model file. Raises DescriptionError when it is not there."""
        return find_model(self.model, self.file)

    def to_dict(self) -> dict[str, Any]:
        """Return the contents of `gripper.yaml`; loading them gives an equal description."""

        def posture(value: PostureDescription) -> dict[str, Any]:
            if value.joints is not None:
                return {"joints": dict(value.joints)}
            return {"actuators": dict(value.actuators or {})}

        def pose(value: Pose) -> dict[str, Any]:
            return {"xyz": list(value.xyz), "quat": list(value.quat)}

        out: dict[str, Any] = {
            "format": 1,
            "name": self.name,
            "display_name": self.display_name,
            "kind": self.kind,
            "model": self.model,
            "mount_from_model": pose(self.mount_from_model),
            "tcp": list(self.tcp),
            "postures": {"open": posture(self.open), "closed": posture(self.closed)},
            "actuation": {key: vars(value).copy() for key, value in self.actuation.items()},
            "max_width": self.max_width,
            "min_width": self.min_width,
            "fingers": [list(group) for group in self.fingers],
            "symmetry": self.symmetry,
            "licence": self.licence,
            "source": self.source,
        }
        if self.flange_from_gripper != Pose():
            out["flange_from_gripper"] = pose(self.flange_from_gripper)
        return out


def load_description(path: str | Path) -> GripperDescription:
    """Read a `gripper.yaml`, or the one in a folder. Raises DescriptionError for every mistake in
    it.

    The model file is not opened here: `megrasp_core.grippers.Gripper` checks joints, actuators and
    bodies.
    """
    file = Path(path).expanduser()
    if file.is_dir():
        file = file / FILE_NAME
    if not (os.path.isfile(file) and os.access(file, os.R_OK)):
        raise DescriptionError(
            f"no readable gripper description at {file}; expected a {FILE_NAME} or a folder that "
            "holds one"
        )
    if file.suffix.lower() in MODEL_SUFFIXES:
        raise DescriptionError(
            f"{file} is a model; expected a {FILE_NAME}. `megrasp gripper new {file.name}` makes "
            "one from it"
        )
    return parse_description(read_yaml(file), file)


def save_description(description: GripperDescription, folder: Path) -> Path:
    """Write `gripper.yaml` into `folder` (made if missing) and return its path. The model file is
    not copied.
    """
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / FILE_NAME
    text = yaml.safe_dump(
        description.to_dict(), sort_keys=False, default_flow_style=None, width=110
    )
    file.write_text(text, encoding="utf-8")
    return file


def parse_description(data: Any, file: Path) -> GripperDescription:
    """Check the contents of a gripper.yaml and return them. Raises DescriptionError."""
    top = Fields(data, str(file))
    top.check_names(VALID, REQUIRED)
    version = top.data["format"]
    if type(version) is not int or version != 1:
        raise top.error("format", f"must be 1, got {show(version)}")
    name = top.text("name")
    if not re.fullmatch(r"[a-z0-9_]+", name):
        raise top.error("name", f"must consist of a-z, 0-9 and _, got '{name}'")
    model = top.text("model")
    if Path(model).suffix.lower() not in MODEL_SUFFIXES:
        raise top.error("model", f"must end in one of {', '.join(MODEL_SUFFIXES)}, got '{model}'")
    tcp = top.point("tcp")
    if tcp[2] <= 0.0:
        raise top.error(
            "tcp",
            f"must lie in front of the palm (z > 0 in the gripper frame), got z = {tcp[2]:g}",
        )
    postures = top.sub("postures")
    postures.check_names(("open", "closed"), ("open", "closed"))
    kind = top.text("kind", KINDS)
    max_width = None if top.data["max_width"] is None else top.length("max_width", above=0.0)
    if max_width is None and kind != "hand":
        raise top.error("max_width", f"may be null for kind hand only; kind is '{kind}'")
    min_width = top.length("min_width", minimum=0.0)
    if max_width is not None and min_width >= max_width:
        raise top.error(
            "min_width", f"must be less than max_width {max_width:g}, got {min_width:g}"
        )
    return GripperDescription(
        name=name,
        display_name=top.text("display_name"),
        kind=kind,
        model=model,
        mount_from_model=_pose(top, "mount_from_model"),
        tcp=tcp,
        open=_posture(postures, "open"),
        closed=_posture(postures, "closed"),
        actuation=_actuation(top),
        max_width=max_width,
        min_width=min_width,
        fingers=_fingers(top),
        symmetry=top.integer("symmetry", 1),
        licence=top.text("licence"),
        source=top.text("source"),
        flange_from_gripper=_pose(top, "flange_from_gripper")
        if "flange_from_gripper" in top.data
        else Pose(),
        folder=file.parent,
    )


def _pose(top: Fields, name: str) -> Pose:
    fields = top.sub(name)
    fields.check_names(("xyz", "quat"), ("xyz", "quat"))
    return Pose(fields.point("xyz"), fields.quaternion("quat"))


def _posture(postures: Fields, name: str) -> PostureDescription:
    fields = postures.sub(name)
    fields.check_names(("joints", "actuators"), ())
    if len(fields.data) != 1:
        given = " and ".join(str(key) for key in fields.data) or "neither"
        raise fields.error(None, f"must hold exactly one of: joints, actuators; got {given}")
    key = next(iter(fields.data))
    values = fields.named_numbers(key)
    return (
        PostureDescription(joints=values)
        if key == "joints"
        else PostureDescription(actuators=values)
    )


def _actuation(top: Fields) -> dict[str, Actuation]:
    outer = top.sub("actuation")
    out = {}
    for joint in outer.names():
        drive = outer.sub(joint)
        drive.check_names(("kp", "force", "damping", "armature"), ("kp", "force"))
        optional = {
            key: drive.number(key, minimum=0.0)
            for key in ("damping", "armature")
            if key in drive.data
        }
        out[joint] = Actuation(
            drive.number("kp", above=0.0), drive.number("force", above=0.0), **optional
        )
    return out


def _fingers(top: Fields) -> tuple[tuple[str, ...], ...]:
    value = top.data["fingers"]
    groups = value if isinstance(value, list) else []
    good = all(
        isinstance(group, list) and group and all(isinstance(link, str) for link in group)
        for group in groups
    )
    if len(groups) < 2 or not good:
        raise top.error(
            "fingers",
            "must be at least two lists of link names, opposing groups, the first on -X; got "
            f"{show(value)}",
        )
    flat = [link for group in groups for link in group]
    twice = sorted({link for link in flat if flat.count(link) > 1})
    if twice:
        raise top.error(
            "fingers", f"names the link '{twice[0]}' more than once; expected each link once"
        )
    return tuple(tuple(group) for group in groups)
