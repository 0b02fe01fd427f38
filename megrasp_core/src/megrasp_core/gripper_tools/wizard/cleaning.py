"""What a gripper's model must not bring along, and a part of a larger model cut out."""

from __future__ import annotations

import mujoco
import numpy as np

from megrasp_core.errors import DescriptionError
from megrasp_core.grippers import (
    COUPLING_SOLREF,
    ROOT_BODY,
    SOLIMP,
    URDF_ARMATURE,
    free_name,
    quiet_mujoco,
)

from .drives import SLIDE_REACH
from .findings import Notes

LONGEST_SLIDE = 0.5
"""A finger's slide is shorter (m)."""

HIDDEN_GROUP = 3
"""Groups of geoms from here on are not shown by viewers."""

JOINT_KINDS = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)


def clean(spec: mujoco.MjSpec, notes: Notes) -> None:
    """Name what has no name; delete what a description does not use, in place."""
    for index, body in enumerate(spec.bodies):
        body.name = body.name or f"link_{index}"
        if body.name == ROOT_BODY:
            body.name = free_name(f"{ROOT_BODY}_base", {other.name for other in spec.bodies})
            notes.add(
                f"link '{ROOT_BODY}' renamed to '{body.name}': the loader's frame has that name"
            )
    for geom in [g for g in spec.geoms if g.type == mujoco.mjtGeom.mjGEOM_PLANE]:
        spec.delete(geom)
    _mocap(spec, notes)
    _loose_objects(spec, notes)
    _free_root(spec, notes)
    for index, joint in enumerate(spec.joints):
        joint.name = joint.name or f"joint_{index}"
        if joint.type not in JOINT_KINDS:
            raise DescriptionError(
                f"joint '{joint.name}' is neither hinge nor slide (nor prismatic, revolute, "
                "continuous); replace it in the model, or cut the gripper out with --root LINK"
            )
    _empty_ranges(spec, notes)
    _servos(spec, notes)
    _solid(spec, notes)
    for index, actuator in enumerate(spec.actuators):
        actuator.name = actuator.name or f"{actuator.target or 'actuator'}_{index}"
    for material in spec.materials:
        material.textures = [""] * len(material.textures)
    unused = [*spec.keys, *spec.lights, *spec.cameras, *spec.textures, *spec.skins, *spec.sensors]
    for element in unused:
        spec.delete(element)


def steady_urdf(spec: mujoco.MjSpec) -> None:
    """State in MJCF what the loader adds to URDFs: stiff mimic couplings, armature."""
    for equality in spec.equalities:
        equality.solref, equality.solimp = COUPLING_SOLREF, SOLIMP
    for joint in spec.joints:
        joint.actfrclimited = int(mujoco.mjtLimited.mjLIMITED_FALSE)
        if joint.type == mujoco.mjtJoint.mjJNT_HINGE and joint.armature == 0.0:
            joint.armature = URDF_ARMATURE


def cut_out(spec: mujoco.MjSpec, root: str) -> mujoco.MjSpec:
    """Return a model of the link `root` and what hangs from it; its frame becomes the model's.

    Raises:
        DescriptionError: there is no such link.
    """
    names = [body.name for body in spec.bodies if body.name != "world"]
    if root not in names:
        raise DescriptionError(
            f"--root names the link '{root}', which the model does not have; valid links: "
            f"{', '.join(names)}"
        )
    body = spec.body(root)
    for joint in list(body.joints):
        spec.delete(joint)
    body.pos = np.zeros(3)
    body.quat = np.array([1.0, 0.0, 0.0, 0.0])
    body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    out = mujoco.MjSpec()
    out.modelname = root
    out.meshdir = spec.meshdir
    out.compiler.boundmass = spec.compiler.boundmass
    out.compiler.boundinertia = spec.compiler.boundinertia
    with quiet_mujoco():
        out.worldbody.add_frame().attach_body(body, "", "")
    used = {geom.meshname for geom in out.geoms}
    for mesh in [m for m in out.meshes if m.name not in used]:
        out.delete(mesh)
    return out


def limit_slides(spec: mujoco.MjSpec, notes: Notes) -> None:
    """Limit slides that carry a shape and may go farther than any finger, in place."""
    for joint in spec.joints:
        low, high = (float(v) for v in joint.range)
        slide = joint.type == mujoco.mjtJoint.mjJNT_SLIDE
        if not slide or high - low <= LONGEST_SLIDE or not list(joint.parent.geoms):
            continue
        ends = float(np.clip(low, -SLIDE_REACH, 0.0)), float(np.clip(high, 0.0, SLIDE_REACH))
        joint.range = np.array(ends)
        notes.add(
            f"joint '{joint.name}' has the limits {low:g} to {high:g} m, which no finger moves; "
            f"{ends[0]:g} to {ends[1]:g} m taken"
        )


def _mocap(spec: mujoco.MjSpec, notes: Notes) -> None:
    """Delete bodies that a user drags about in a viewer, and what ties others to them; one that
    carries joints is the gripper itself.
    """
    carriers = {_topmost(joint.parent).name for joint in spec.joints}
    dragged = [body for body in spec.bodies if body.mocap]
    gone = [body.name for body in dragged if body.name not in carriers]
    for body in dragged:
        if body.name in carriers:
            body.mocap = False
            notes.add(f"mocap body '{body.name}' carries the fingers: taken as mounted")
    if not gone:
        return
    for equality in [e for e in spec.equalities if e.name1 in gone or e.name2 in gone]:
        spec.delete(equality)
    for name in gone:
        spec.delete(spec.body(name))
    notes.add(f"mocap bodies and what is welded to them left out: {', '.join(gone)}")


def _loose_objects(spec: mujoco.MjSpec, notes: Notes) -> None:
    """Delete bodies that lie free in the scene of a gripper."""
    moved = [joint for joint in spec.joints if joint.type in JOINT_KINDS]
    holders = {_topmost(joint.parent).name for joint in moved}
    free = [joint for joint in spec.joints if joint.type == mujoco.mjtJoint.mjJNT_FREE]
    loose = [joint.parent.name for joint in free]
    loose = [name for name in loose if name not in holders] if holders else []
    for name in loose:
        spec.delete(spec.body(name))
    if loose:
        notes.add(f"objects that lie free in the scene left out: {', '.join(loose)}")


def _topmost(body: mujoco.MjsBody) -> mujoco.MjsBody:
    while body.parent.name != "world":
        body = body.parent
    return body


def _empty_ranges(spec: mujoco.MjSpec, notes: Notes) -> None:
    empty = [
        joint
        for joint in spec.joints
        if joint.limited != mujoco.mjtLimited.mjLIMITED_FALSE
        and joint.range[0] == joint.range[1]
        and (joint.limited == mujoco.mjtLimited.mjLIMITED_TRUE or joint.range[0] != 0.0)
    ]
    for joint in empty:
        joint.limited = int(mujoco.mjtLimited.mjLIMITED_FALSE)
    if empty:
        low = float(empty[0].range[0])
        names = ", ".join(joint.name for joint in empty)
        notes.add(f"limits {low:g} to {low:g} taken as none: {names}")


def _solid(spec: mujoco.MjSpec, notes: Notes) -> None:
    """Let the shapes of rigid parts that only show something touch, too.

    Parts between others, such as the bars of a linkage, need not touch anything.
    """
    parts: dict[str, list[mujoco.MjsBody]] = {}
    part_of: dict[str, str] = {"world": "world"}
    inner: set[str] = set()
    for body in spec.bodies:
        if body.name == "world":
            continue
        above = part_of[body.parent.name]
        own = body.name if list(body.joints) else above
        if own != above:
            inner.add(above)
        part_of[body.name] = own
        parts.setdefault(own, []).append(body)
    base = next((part for part in ("world", *parts) if part in parts), "world")
    changed = []
    for part, bodies in parts.items():
        shown = [g for b in bodies for g in b.geoms if g.group < HIDDEN_GROUP]
        touching = any(g.contype or g.conaffinity for b in bodies for g in b.geoms)
        if touching or not shown or (part in inner and part != base):
            continue
        for geom in shown:
            geom.contype, geom.conaffinity = 1, 1
        changed += [body.name for body in bodies if list(body.geoms)]
    if changed:
        notes.add(
            f"links without collision geometry, their visual shapes taken (meshes as hulls): "
            f"{', '.join(changed)}"
        )


def _free_root(spec: mujoco.MjSpec, notes: Notes) -> None:
    for joint in [j for j in spec.joints if j.type == mujoco.mjtJoint.mjJNT_FREE]:
        notes.add("the free joint of the base was removed: a gripper is mounted")
        spec.delete(joint)


def _servos(spec: mujoco.MjSpec, notes: Notes) -> None:
    """Delete actuators that hold no position; their joints get drives of the description."""
    affine = mujoco.mjtBias.mjBIAS_AFFINE
    replaced = []
    for actuator in list(spec.actuators):
        plugin = bool(actuator.plugin.active)
        if actuator.biastype == affine and actuator.biasprm[1] < 0.0 and not plugin:
            continue
        replaced.append(actuator.name or actuator.target)
        spec.delete(actuator)
    if replaced:
        notes.add(
            f"no position servos, so their joints get drives of the description: "
            f"{', '.join(replaced)}"
        )
    if not any(item.plugin.active for item in [*spec.actuators, *spec.bodies, *spec.meshes]):
        for plugin in list(spec.plugins):
            spec.delete(plugin)
