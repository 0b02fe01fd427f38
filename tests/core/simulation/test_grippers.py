"""Registered grippers in simulation: they close, hold a box through shaking, and stay stable."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from megrasp_core.grippers import (
    COLLISION_GROUP,
    VISUAL_GROUP,
    Gripper,
    gripper_folders,
    list_grippers,
    load_description,
    load_gripper,
)

NARROW, WIDE = (0.04, 0.03, 0.03), (0.05, 0.06, 0.04)


def box_size(gripper: Gripper) -> tuple[float, float, float]:
    """Full edges of a box that fits: a wide one for hands and for opposing groups of fingers."""
    width = gripper.description.max_width
    return NARROW if width is not None and "3f" not in gripper.name else WIDE


def world(gripper: Gripper, timestep: float, friction: float, mass: float) -> mujoco.MjModel:
    """Return a gripper on a free mount, welded to a mocap body, and a free box at the TCP."""
    spec = mujoco.MjSpec()
    spec.option.timestep = timestep
    spec.option.gravity = (0, 0, 0)
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10
    spec.worldbody.add_body(name="hand", mocap=True)
    mount = spec.worldbody.add_body(
        name="mount", mass=1.0, inertia=(0.01, 0.01, 0.01), explicitinertial=True
    )
    mount.add_freejoint()
    weld = spec.add_equality(
        type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY, name1="hand", name2="mount"
    )
    weld.solref, weld.data[10] = (0.004, 1), 1.0
    spec.attach(gripper.spec(), prefix="g/", frame=mount.add_frame())
    box = spec.worldbody.add_body(name="box", pos=gripper.tcp)
    box.add_freejoint()
    box.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=np.array(box_size(gripper)) / 2,
        mass=mass,
        contype=1,
        conaffinity=3,
        condim=4,
        friction=(friction, 0.01, 0.0001),
    )
    return spec.compile()


def hold(
    gripper: Gripper, timestep: float, friction: float, mass: float = 0.2, axis: int = 2
) -> tuple[float, float, float]:
    """Close on the box, shake +-5 cm at 2 Hz for 1 s along an axis.

    Returns the slip (m), the deepest contact (m) and the sum of the normal forces (N).
    """
    model = world(gripper, timestep, friction, mass)
    data = mujoco.MjData(model)
    for name, value in gripper.posture("open").items():
        data.joint(f"g/{name}").qpos[0] = value
    data.ctrl[:] = gripper.control("closed")
    for _ in range(round(0.6 / timestep)):
        mujoco.mj_step(model, data)
    before = data.body("box").xpos - data.body("mount").xpos
    depth = -min((contact.dist for contact in data.contact), default=0.0)
    force = 0.0
    for index in range(data.ncon):
        wrench = np.zeros(6)
        mujoco.mj_contactForce(model, data, index, wrench)
        force += wrench[0]
    for step in range(round(1.0 / timestep)):
        data.mocap_pos[0, axis] = 0.05 * np.sin(4 * np.pi * step * timestep)
        mujoco.mj_step(model, data)
    data.mocap_pos[0] = 0.0
    for _ in range(round(0.2 / timestep)):
        mujoco.mj_step(model, data)
    assert not any(int(warning.number) for warning in data.warning)
    after = data.body("box").xpos - data.body("mount").xpos
    return float(np.linalg.norm(after - before)), float(depth), force


@pytest.fixture(scope="module", params=list_grippers())
def gripper(request: pytest.FixtureRequest) -> Gripper:
    """Every registered gripper in turn."""
    return load_gripper(request.param)


@pytest.fixture(
    scope="module",
    params=[
        name
        for name, folder in gripper_folders().items()
        if load_description(folder).kind != "hand"
    ],
)
def jaws(request: pytest.FixtureRequest) -> Gripper:
    """Every registered gripper but the hands, which test_hands.py gives several tries."""
    return load_gripper(request.param)


@pytest.mark.parametrize("timestep", [0.002, 0.004])
def test_holds_a_box(jaws: Gripper, timestep: float) -> None:
    """The box stays within 5 mm through the shake, pressed firmly and not sunk in."""
    slip, depth, force = hold(jaws, timestep, friction=0.8)
    assert slip < 0.005
    assert depth < 0.0015
    assert 30.0 < force < 400.0


def test_slips_without_friction(jaws: Gripper) -> None:
    """Friction comes from the object: a slippery box is lost, so holding it was no artefact."""
    slip, _, _ = hold(jaws, 0.002, friction=0.005, mass=1.0, axis=1)
    assert slip > 0.02


def test_spec_contract(gripper: Gripper) -> None:
    """Root body, groups, contact bits, gravity compensation; every call gives a fresh copy."""
    spec = gripper.spec()
    assert spec.worldbody.bodies[0].name == "gripper"
    for geom in spec.geoms:
        if geom.group == VISUAL_GROUP:
            assert (geom.contype, geom.conaffinity) == (0, 0)
        else:
            assert geom.group == COLLISION_GROUP
            assert (geom.contype, geom.conaffinity, geom.condim, geom.priority) == (2, 1, 4, 0)
            assert geom.solref[0] == 0.004
    assert all(body.gravcomp == 1.0 for body in spec.bodies if body.name != "world")
    spec.body("gripper").name = "changed"
    assert gripper.spec().worldbody.bodies[0].name == "gripper"
    model = gripper.model
    assert model.actuator_forcelimited.all()
    assert len(gripper.control("open")) == model.nu > 0


def test_no_self_contact(gripper: Gripper) -> None:
    """Neither posture makes the gripper touch itself, whatever overlaps."""
    data = mujoco.MjData(gripper.model)
    for posture in ("open", "closed"):
        data.qpos[:] = gripper.qpos(posture)
        mujoco.mj_forward(gripper.model, data)
        assert data.ncon == 0
