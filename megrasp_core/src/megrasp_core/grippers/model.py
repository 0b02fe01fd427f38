"""Loading of URDF and MJCF models through `mujoco.MjSpec`, brought to one form for simulation and
rendering.

The form: a root body "gripper" whose frame is the gripper frame; visual geoms in group 2 without
contacts; collision geoms in group 3 with contact bits that never meet another geom of the gripper;
every joint that `actuation` names driven by a position actuator; gravity compensated.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from megrasp_core.errors import DescriptionError

from .actuation import apply_actuation, free_name
from .description import GripperDescription
from .fields import choices
from .inertia import correct_masses
from .model_file import read_xml
from .model_mistakes import check_model, check_spec, check_xml, mesh_mistake

ROOT_BODY = "gripper"
VISUAL_GROUP = 2
COLLISION_GROUP = 3
# MuJoCo's viewers show geoms of the groups 0 to 2 only.
HIDDEN_GROUPS = range(3, mujoco.mjNGROUP)
CONTACT_TYPE = 2
CONTACT_AFFINITY = 1
# Contact stiffness of the fingers counts against every object (solmix), friction is left to the
# object: MuJoCo takes the larger of the two coefficients, so the gripper's own must be small.
SOLREF = (0.004, 1.0)
SOLIMP = (0.95, 0.99, 0.001, 0.5, 2.0)
SOLMIX = 1000.0
FRICTION = (0.01, 0.0001, 0.00001)
COUPLING_SOLREF = (0.005, 1.0)
URDF_ARMATURE = 0.001

_log = logging.getLogger(__name__)


def build_spec(description: GripperDescription) -> mujoco.MjSpec:
    """Return the wrapped model of a description. Raises DescriptionError when it cannot be read or
    does not fit.
    """
    path = description.model_path
    check_xml(read_xml(path), path)
    child = _read(path)
    check_spec(child, path)
    child.compiler.fusestatic = False
    child.compiler.discardvisual = False
    _strip(child)
    _name_joints(child)
    _prepare_geoms(child)
    if path.suffix.lower() == ".urdf":
        _steady_urdf(child)
    apply_actuation(child, description)
    _check_bodies(child, description)
    return _wrap(child, description)


def compile_spec(spec: mujoco.MjSpec, description: GripperDescription) -> mujoco.MjModel:
    """Compile a wrapped model; impossible masses in it are corrected, in `spec` too.

    Raises DescriptionError with MuJoCo's reason, or a better one where it is known.
    """
    path = description.model_path
    with _explained(path, "compile"):
        model = spec.compile()
        if correct_masses(spec, model):
            model = spec.compile()
    check_model(model, path)
    return model


def _read(path: Path) -> mujoco.MjSpec:
    with _explained(path, "read"):
        return mujoco.MjSpec.from_file(str(path))


@contextmanager
def _explained(path: Path, doing: str) -> Iterator[None]:
    """Turn what MuJoCo raises about a model into a DescriptionError."""
    try:
        with quiet_mujoco():
            yield
    except (ValueError, mujoco.FatalError) as error:
        mistake = mesh_mistake(_read(path), path) if doing == "compile" else None
        reason = " ".join(str(error).split())
        raise DescriptionError(
            mistake or f"{path}: MuJoCo cannot {doing} the model; it says: {reason}"
        ) from error


def _strip(spec: mujoco.MjSpec) -> None:
    """Delete what a gripper on a mount must not bring along.

    A geom that neither touches anything nor is shown, such as the outline a planner uses, is no
    part of the surface.
    """
    helpers = [
        geom
        for geom in spec.geoms
        if not (geom.contype or geom.conaffinity) and geom.group in HIDDEN_GROUPS
    ]
    for element in [*spec.keys, *spec.lights, *spec.cameras, *spec.pairs, *helpers]:
        spec.delete(element)


def _name_joints(spec: mujoco.MjSpec) -> None:
    """Give unnamed joints a name, clear URDF effort clamps."""
    taken = {joint.name for joint in spec.joints}
    for index, joint in enumerate(spec.joints):
        joint.name = joint.name or free_name(f"joint_{index}", taken)
        joint.actfrclimited = int(mujoco.mjtLimited.mjLIMITED_FALSE)


def _prepare_geoms(spec: mujoco.MjSpec) -> None:
    """Split geoms into visual and collision ones; a body with collision geoms alone shows copies
    of them.
    """
    for body in spec.bodies:
        solid = [geom for geom in body.geoms if geom.contype or geom.conaffinity]
        shown = [geom for geom in body.geoms if not (geom.contype or geom.conaffinity)]
        if not shown:
            shown = [_copy_geom(body, geom) for geom in solid]
        for geom in shown:
            geom.contype, geom.conaffinity, geom.group = 0, 0, VISUAL_GROUP
        for geom in solid:
            geom.contype, geom.conaffinity, geom.group = (
                CONTACT_TYPE,
                CONTACT_AFFINITY,
                COLLISION_GROUP,
            )
            geom.condim, geom.priority, geom.solmix = 4, 0, SOLMIX
            geom.solref, geom.solimp, geom.friction = SOLREF, SOLIMP, FRICTION
            geom.margin, geom.gap = 0.0, 0.0
        body.gravcomp = 1.0


def _copy_geom(body: mujoco.MjsBody, geom: mujoco.MjsGeom) -> mujoco.MjsGeom:
    """Add a massless copy of the shape of `geom` to its body."""
    copy = body.add_geom(
        type=geom.type,
        size=geom.size,
        pos=geom.pos,
        quat=geom.quat,
        fromto=geom.fromto,
        meshname=geom.meshname,
        rgba=geom.rgba,
        material=geom.material,
        mass=0.0,
    )
    # An orientation given as euler, axisangle, xyaxes or zaxis is kept apart from quat and wins
    # over it.
    for name in ("type", "axisangle", "euler", "xyaxes", "zaxis"):
        setattr(copy.alt, name, getattr(geom.alt, name))
    return copy


def _steady_urdf(spec: mujoco.MjSpec) -> None:
    """Add what a URDF cannot state: stiff mimic couplings, armature for light mimic links."""
    for equality in spec.equalities:
        equality.solref, equality.solimp = COUPLING_SOLREF, SOLIMP
    for joint in spec.joints:
        if joint.type == mujoco.mjtJoint.mjJNT_HINGE and joint.armature == 0.0:
            joint.armature = URDF_ARMATURE


def _wrap(child: mujoco.MjSpec, description: GripperDescription) -> mujoco.MjSpec:
    """Put the model below a body "gripper" whose frame is the gripper frame."""
    spec = mujoco.MjSpec()
    spec.modelname = description.name
    mount = description.mount_from_model
    x, y, z, w = Rotation.from_quat(mount.quat).as_quat()
    root = spec.worldbody.add_body(name=ROOT_BODY, gravcomp=1.0)
    frame = root.add_frame(pos=np.array(mount.xyz), quat=np.array([w, x, y, z]))
    with quiet_mujoco():
        spec.attach(child, prefix="", frame=frame)
    if _mechanics(spec) < _mechanics(child):
        # Attaching drops what refers to something that is not there; compiling names it.
        with _explained(description.model_path, "compile"):
            _read(description.model_path).compile()
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10.0
    return spec


def _mechanics(spec: mujoco.MjSpec) -> int:
    return len(spec.equalities) + len(spec.actuators) + len(spec.tendons)


@contextmanager
def quiet_mujoco() -> Iterator[None]:
    """Send MuJoCo's warnings to the log instead of stderr and a file in the working directory.

    Attaching without a prefix warns about saving to XML; names without a prefix are what
    descriptions refer to.
    """
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda text: _log.debug("MuJoCo: %s", text))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        mujoco.set_mju_user_warning(before)


def _check_bodies(spec: mujoco.MjSpec, description: GripperDescription) -> None:
    names = [body.name for body in spec.bodies if body.name != "world"]
    if ROOT_BODY in names:
        raise DescriptionError(
            f"{description.model_path}: a link has the name '{ROOT_BODY}', which the loader gives "
            f"to the frame it adds; expected another, such as '{ROOT_BODY}_base'"
        )
    for link in (link for group in description.fingers for link in group):
        if link not in names:
            raise DescriptionError(
                f"{description.file}: 'fingers' names the link '{link}', which the model does not "
                f"have; {choices('links', link, names)}"
            )
