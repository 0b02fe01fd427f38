"""From a stranger's file to a clean model beside the description to be: `model.xml` and meshes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco

from megrasp_core.errors import DescriptionError
from megrasp_core.grippers import (
    GripperDescription,
    Pose,
    PostureDescription,
    build_spec,
    check_spec,
    compile_spec,
    quiet_mujoco,
)

from .cleaning import clean, cut_out, limit_slides, steady_urdf
from .drives import find_drives
from .findings import Notes
from .foreign import leave_out_foreign
from .mechanism import Mechanism, find_mechanism, rigid_parts, shared_link
from .meshes import FOLDER
from .motion import DriveMotion
from .source import SourceOptions, is_urdf, read_source
from .units import check_units, far_root, scale_meshes, scale_model

MODEL_FILE = "model.xml"
ARM_JOINTS = 3
"""So many joints above the palm are an arm and no wrist."""

LARGEST_REACH = 0.5
"""A longer 'finger' (m) is a limb of a whole robot."""

MOST_NAMES = 40


@dataclass(frozen=True)
class Prepared:
    """A clean model: `folder` holds model.xml and meshes/; `model` is it compiled as the loader
    compiles it; `mechanism` and `motion` belong to it. `carried`: joints that lead to the palm.
    """

    folder: Path
    model: mujoco.MjModel
    mechanism: Mechanism
    motion: DriveMotion
    carried: int = 0


def prepare(
    path: Path,
    folder: Path,
    options: SourceOptions,
    notes: Notes,
    accept_scale: Callable[[float], bool],
) -> Prepared:
    """Read, clean, scale and cut a model, and write it to `folder`.

    Args:
        path: URDF or MJCF.
        folder: an empty folder.
        options: what the user said.
        notes: what was done is written here.
        accept_scale: whether to scale the whole model by a factor found from its size.

    Raises:
        DescriptionError: what is wrong with the file, and what to do.
    """
    spec = read_source(path, folder, options, notes)
    clean(spec, notes)
    # The loader adds this to URDFs; the model is written as MJCF.
    if is_urdf(path):
        steady_urdf(spec)
    if options.scale is not None:
        scale_model(spec, options.scale)
        notes.add(f"all lengths scaled by {options.scale:g}")
    model = _compile(spec, path)
    if options.root is not None:
        # Units are those of what is left.
        spec = cut_out(spec, options.root)
        model = _compile(spec, path)
    elif (far := far_root(model)) is not None:
        notes.add(f"the model stands far from its origin: the frame of link '{far}' is taken")
        spec = cut_out(spec, far)
        model = _compile(spec, path)
    if options.scale is None and scale_meshes(spec, model, notes):
        model = _compile(spec, path)
    factor = check_units(model, path)
    if factor is not None:
        if not accept_scale(factor):
            raise DescriptionError(
                f"{path}: the model's lengths look like millimetres (a link or distance of "
                "several metres); expected metres. Scale it: --scale 0.001"
            )
        scale_model(spec, factor)
        notes.add(f"the model's lengths look like millimetres: all scaled by {factor:g}")
    limit_slides(spec, notes)
    prepared = _written(spec, folder, path)
    carried = len(prepared.mechanism.above)
    if carried >= ARM_JOINTS and options.root is None:
        link = _gripper_root(prepared.mechanism)
        notes.add(
            f"{carried} joints lead to the palm, so this is an arm with a "
            f"gripper: cut at link '{link}' (another: --root LINK)"
        )
        spec = cut_out(spec, link)
        prepared = _written(spec, folder, path)
    _refuse_robot(prepared.mechanism, path)
    if leave_out_foreign(spec, prepared.mechanism, prepared.motion, notes):
        prepared = _written(spec, folder, path)
    return replace(prepared, carried=carried)


def _compile(spec: mujoco.MjSpec, path: Path) -> mujoco.MjModel:
    check_spec(spec, path)
    try:
        with quiet_mujoco():
            return spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split())
        raise DescriptionError(f"MuJoCo cannot compile {path}: {reason}") from error


def _written(spec: mujoco.MjSpec, folder: Path, path: Path) -> Prepared:
    """Write the model and load it the way every description's model is loaded."""
    _compile(spec, path)
    with quiet_mujoco():
        xml = spec.to_xml()
    (folder / MODEL_FILE).write_text(xml.replace(spec.meshdir, FOLDER), encoding="utf-8")
    used = {mesh.file for mesh in spec.meshes}
    for file in (folder / FOLDER).glob("*"):
        if file.name not in used:
            file.unlink()
    description = provisional_description(folder)
    try:
        model = compile_spec(build_spec(description), description)
    except DescriptionError as error:
        # The user knows the model by the name of the file that was given.
        written = str(description.model_path)
        raise DescriptionError(str(error).replace(written, str(path))) from error
    motion = DriveMotion(model, find_drives(model))
    middle = (motion.low + motion.high) / 2.0
    samples = [motion.poses(v) for v in (motion.rest(), motion.low, middle, motion.high)]
    return Prepared(folder, model, find_mechanism(model, samples), motion)


def provisional_description(folder: Path) -> GripperDescription:
    """Return a description that names nothing but the model, gripper frame = model frame."""
    nothing = PostureDescription(joints={})
    return GripperDescription(
        name="new",
        display_name="new",
        kind="hand",
        model=MODEL_FILE,
        mount_from_model=Pose(),
        tcp=(0.0, 0.0, 0.1),
        open=nothing,
        closed=nothing,
        actuation={},
        max_width=None,
        min_width=0.0,
        fingers=(),
        symmetry=1,
        licence="unknown",
        source="unknown",
        folder=folder,
    )


def _gripper_root(mechanism: Mechanism) -> str:
    """Return the lowest link of the palm that all fingers hang from."""
    roots = [branch.root for branch in mechanism.branches]
    return shared_link(mechanism.model, roots, mechanism.palm)


def _refuse_robot(mechanism: Mechanism, path: Path) -> None:
    if mechanism.branches[0].reach <= LARGEST_REACH:
        return
    model = mechanism.model
    parts = rigid_parts(model)
    names = []
    for part, bodies in parts.items():
        own = [p for p in parts if p and int(model.body_weldid[model.body_parentid[p]]) == part]
        if part and len(own) >= 2:
            names.append(shared_link(model, own, bodies))
    listed = ", ".join(names[:MOST_NAMES]) or "none has two moving links"
    raise DescriptionError(
        f"{path}: a limb of {mechanism.branches[0].reach:.2f} m moves, so this is more than a "
        "gripper (or not in metres: --scale, or the scale of its meshes in the model). Name the "
        "link that the fingers hang from: --root LINK. Links with two moving links or more: "
        f"{listed}"
    )
