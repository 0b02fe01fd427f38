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

from .findings import Notes

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
    _free_root(spec, notes)
    for index, joint in enumerate(spec.joints):
        joint.name = joint.name or f"joint_{index}"
        if joint.type not in JOINT_KINDS:
            raise DescriptionError(
                f"joint '{joint.name}' is neither hinge nor slide (nor prismatic, revolute, "
                "continuous); replace it in the model, or cut the gripper out with --root LINK"
            )
    _servos(spec, notes)
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
