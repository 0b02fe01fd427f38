"""Mistakes in a model file that MuJoCo tells in words of its own, corrects or drops without any.

Messages begin with the path of the model, since that is the file to correct.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import DescriptionError

from .fields import LARGEST, choices

AXIS_TOLERANCE = 1e-3
SMALLEST = 0.004
"""A whole gripper (m) is larger."""

NO_SUCTION = "suction tools are not supported; grippers need two fingers that close"

MESH_SUFFIXES = (".stl", ".obj", ".msh")
URDF_JOINTS = ("revolute", "continuous", "prismatic", "fixed")
NAMED = {"robot": ("link", "joint"), "mujoco": ("worldbody//body", "worldbody//joint")}
MOVING = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)


def check_xml(root: ElementTree.Element, path: Path) -> None:
    """Raise DescriptionError for names given twice and, in a URDF, joints that lead nowhere."""
    check_names(root, path)
    if root.tag == "robot":
        for joint in root.iterfind("joint"):
            _check_urdf_joint(joint.get("name", ""), joint, path)
        check_tree(root, path)


def check_tree(root: ElementTree.Element, path: Path) -> None:
    """Raise DescriptionError for joints of a URDF that lead nowhere or back, and for mimics of
    what is no other moving joint, or of each other.
    """
    links = [link.get("name", "") for link in root.iterfind("link")]
    joints = {joint.get("name", ""): joint for joint in root.iterfind("joint")}
    moving = [name for name, joint in joints.items() if joint.get("type") != "fixed"]
    above: dict[str, str] = {}
    copied: dict[str, str] = {}
    for name, joint in joints.items():
        where = f"{path}: joint '{name}'"
        ends = {end: _attribute(joint, end, "link") for end in ("parent", "child")}
        for end, link in ends.items():
            if link not in links:
                raise DescriptionError(
                    f"{where} has the {end} link '{link}', which the model does not have; "
                    f"{choices('links', link, links)}"
                )
        if ends["child"] in above:
            raise DescriptionError(
                f"{where} has the child link '{ends['child']}', which hangs from another joint "
                "already; expected one joint above each link: remove one of the two"
            )
        above[ends["child"]] = ends["parent"]
        mimic = _attribute(joint, "mimic", "joint")
        others = [other for other in moving if other != name]
        if joint.find("mimic") is None:
            continue
        if mimic not in others:
            raise DescriptionError(
                f"{where} mimics '{mimic}', which is no other moving joint of the model; name one "
                f"or remove the <mimic>; {choices('joints', mimic, others)}"
            )
        copied[name] = mimic
    ring = _ring(above)
    if ring:
        raise DescriptionError(
            f"{path}: the links {', '.join(ring)} hang from each other in a ring; expected a tree "
            "with one root: remove the joint that closes it, or turn its parent and child round"
        )
    ring = _ring(copied)
    if ring:
        raise DescriptionError(
            f"{path}: the joints {', '.join(ring)} mimic each other in a ring; expected one that "
            "moves by itself: remove its <mimic>"
        )


def _ring(follows: Mapping[str, str]) -> list[str]:
    """Return names that follow each other in a ring, none where every chain ends."""
    for start in follows:
        chain = [start]
        while chain[-1] in follows and follows[chain[-1]] not in chain:
            chain.append(follows[chain[-1]])
        last = follows.get(chain[-1])
        if last is not None:
            return chain[chain.index(last) :]
    return []


def check_names(root: ElementTree.Element, path: Path) -> None:
    """Raise DescriptionError for names given twice."""
    for kind in NAMED.get(root.tag, ()):
        names = [item.get("name", "") for item in root.iterfind(kind)]
        twice = [name for name in names if name and names.count(name) > 1]
        if twice:
            raise DescriptionError(
                f"{path}: two elements <{kind.rpartition('/')[2]}> have the name '{twice[0]}'; "
                "expected a name of its own for each"
            )


def _check_urdf_joint(name: str, joint: ElementTree.Element, path: Path) -> None:
    where = f"{path}: joint '{name}'"
    kind = joint.get("type", "")
    if kind not in URDF_JOINTS:
        raise DescriptionError(
            f"{where} is of type '{kind}'; {choices('types', kind, URDF_JOINTS)}"
        )
    if kind == "fixed" or joint.find("axis") is None:
        return
    text = _attribute(joint, "axis", "xyz")
    axis = _vector(text)
    length = float(np.linalg.norm(axis)) if axis is not None else 0.0
    if axis is None or not length > 0.0:
        raise DescriptionError(
            f'{where} has the axis "{text}"; expected a unit vector, the direction in which it '
            'moves, such as <axis xyz="0 0 1"/>'
        )
    if abs(length - 1.0) > AXIS_TOLERANCE:
        unit = " ".join(f"{value:.6g}" for value in axis / length)
        raise DescriptionError(
            f'{where} has the axis "{text}" of length {length:.4g}; expected a unit vector: write '
            f'<axis xyz="{unit}"/>'
        )


def check_spec(spec: mujoco.MjSpec, path: Path) -> None:
    """Raise DescriptionError for joints that cannot move, and for references that lead nowhere:
    attaching a model drops whatever holds one.
    """
    if not spec.joints:
        raise DescriptionError(
            f"{path}: the model has no moving joint; expected fingers on revolute, prismatic, "
            f"hinge or slide joints. Was it exported with its joints fixed? ({NO_SUCTION})"
        )
    for joint in spec.joints:
        where = f"{path}: joint '{joint.name}' of link '{joint.parent.name}'"
        if joint.type not in MOVING:
            kind = mujoco.mjtJoint(joint.type).name.removeprefix("mjJNT_").lower()
            raise DescriptionError(
                f"{where} is of type {kind}; expected hinge or slide. Remove free and ball joints"
            )
        if not np.linalg.norm(joint.axis) > 0.0:
            raise DescriptionError(
                f"{where} has the axis {np.asarray(joint.axis).tolist()}; expected the direction "
                "in which it moves, such as 0 0 1"
            )
        low, high = joint.range
        if low > high:
            raise DescriptionError(
                f"{where} has the limits {low:g} to {high:g}; expected the lower one first"
            )
    joints = [joint.name for joint in spec.joints if joint.name]
    coupled = [
        ("an equality", name)
        for item in spec.equalities
        if item.type == mujoco.mjtEq.mjEQ_JOINT
        for name in (item.name1, item.name2)
    ]
    kinds = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    driven = [("an actuator", item.target) for item in spec.actuators if item.trntype in kinds]
    for what, name in [*coupled, *driven]:
        if name and name not in joints:
            raise DescriptionError(
                f"{path}: {what} names the joint '{name}', which the model does not have; "
                f"{choices('joints', name, joints)}"
            )


def check_model(model: mujoco.MjModel, path: Path) -> None:
    """Raise DescriptionError for a compiled model without shape, with nan, or not in metres."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    bad = np.flatnonzero(~np.isfinite(np.hstack([data.xpos, data.xmat])).all(axis=1))
    if len(bad):
        raise DescriptionError(
            f"{path}: link '{model.body(int(bad[0])).name}' is placed at nan; expected finite "
            "numbers in its position, orientation and joints"
        )
    shapes = model.geom_type != int(mujoco.mjtGeom.mjGEOM_PLANE)
    if not shapes.any():
        raise DescriptionError(
            f"{path}: the model has no shape; expected visual and collision geometry"
        )
    # Direct children of the root also hold the mount, which the description gives.
    inner = model.body_pos[model.body_parentid > 1]
    size = max(float(np.abs(inner).max(initial=0.0)), 2.0 * float(model.geom_rbound[shapes].max()))
    if not SMALLEST <= size <= LARGEST:
        raise DescriptionError(
            f"{path}: the model is {size:.3g} m large; expected {SMALLEST:g} to {LARGEST:g} m, "
            "all lengths in metres. A model in millimetres becomes one in metres with `megrasp "
            f"gripper new {path.name} --scale 0.001`"
        )


def mesh_mistake(spec: mujoco.MjSpec, path: Path) -> str | None:
    """Return what is wrong with the mesh files of a model that MuJoCo did not compile, None where
    they are there.
    """
    users = {geom.meshname: f" of link '{geom.parent.name}'" for geom in spec.geoms}
    for mesh in spec.meshes:
        if not mesh.file:
            continue
        where = f"{path}: the mesh '{mesh.file}'{users.get(mesh.name, '')}"
        scheme, _, rest = mesh.file.partition("://")
        if rest:
            package = rest.partition("/")[0]
            option = f" --package {package}=/folder/of/{package}" if scheme == "package" else ""
            return (
                f"{where} is not looked for; expected a path from the model's folder. "
                f"`megrasp gripper new {path.name}{option}` copies it there"
            )
        suffix = Path(mesh.file).suffix.lower()
        if suffix not in MESH_SUFFIXES:
            return (
                f"{where} is of a kind that MuJoCo does not read; "
                f"{choices('kinds', suffix, MESH_SUFFIXES)}. `megrasp gripper new {path.name}` "
                "converts it"
            )
        name = Path(mesh.file).name if spec.strippath else mesh.file
        file = path.parent / (spec.meshdir or "") / name
        if not file.is_file():
            return f"{where} is missing; expected the file {file}"
    return None


def _attribute(joint: ElementTree.Element, element: str, name: str) -> str:
    found = joint.find(element)
    return "" if found is None else found.get(name, "")


def _vector(text: str) -> NDArray[np.float64] | None:
    """Return three finite numbers (3,), None of any other text."""
    try:
        values: Iterable[float] = [float(word) for word in text.split()]
    except ValueError:
        return None
    values = list(values)
    return np.array(values) if len(values) == 3 and all(map(math.isfinite, values)) else None
