"""Leaving out what a grasp does not need changes neither shape, weight nor verdict."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
from jaw_and_boxes import make_box

from megrasp_core.grippers import gripper_folders, load_gripper
from megrasp_core.library import antipodal
from megrasp_core.simulation import FreeSpaceRig, Reason, World, build_world
from megrasp_core.simulation.idle import IdleParts, idle_parts, lock

OWN = sorted(name for name in gripper_folders() if not name.endswith("_cad"))
FOLDED = {"rh_RFJ3", "rh_LFJ5", "rh_WRJ1", "rh_THJ4"}

COUPLED = """
<mujoco>
 <compiler angle="radian"/>
 <worldbody><body name="gripper">
  <geom type="box" size=".01 .01 .01"/>
  <body name="a" pos="0 0 .1"><joint name="a" axis="0 1 0"/><geom type="sphere" size=".01"/>
   <body name="b" pos=".05 0 0"><joint name="b" axis="0 0 1" pos="0 .02 0"/>
    <joint name="c" type="slide" axis="1 1 0"/><geom type="box" size=".01 .02 .03"/>
    <body name="d" pos="0 0 .05"><joint name="d" axis="1 0 0"/><geom type="sphere" size=".01"/>
    </body></body></body>
 </body></worldbody>
 <tendon><fixed name="t"><joint joint="a" coef="1"/><joint joint="d" coef="1"/></fixed></tendon>
 <equality><joint joint1="b" joint2="c"/></equality>
 <actuator><position name="at" tendon="t"/><position name="ab" joint="b"/></actuator>
</mujoco>
"""


def double(opened: dict[str, float], closed: dict[str, float], control: Any) -> Any:
    """What `idle_parts` and `lock` ask of a gripper."""
    return SimpleNamespace(
        model=mujoco.MjModel.from_xml_string(COUPLED),
        posture=lambda which: opened if which == "open" else closed,
        control=lambda which: np.array(control[which == "closed"], float),
    )


REST = {"a": 0.3, "b": -0.4, "c": 0.02, "d": 0.5}
STILL = ([1.0, 2.0], [1.0, 2.0])


def test_folded_fingers_and_the_wrist_are_idle():
    parts = idle_parts(load_gripper("shadow_hand_3f"))
    assert parts.joints >= FOLDED
    assert not {"rh_FFJ3", "rh_MFJ2", "rh_THJ1"} & parts.joints
    assert parts.tendons == {"rh_RFJ0", "rh_LFJ0"}
    assert len(parts.actuators) == 10
    assert idle_parts(load_gripper("robotiq_2f85")) == IdleParts()


@pytest.mark.parametrize(
    ("moves", "control", "idle"),
    [
        ({}, STILL, {"a", "b", "c", "d"}),
        ({"d": 0.6}, STILL, {"b", "c"}),  # the tendon drags a along
        ({"c": 0.03}, STILL, {"a", "d"}),  # so do the equality, and the body that b and c share
        ({}, ([1.0, 2.0], [1.5, 2.0]), {"b", "c"}),  # commanded through the tendon
        ({}, ([1.0, 2.0], [1.0, 2.5]), {"a", "d"}),  # commanded itself
    ],
)
def test_what_is_coupled_to_a_moving_joint_moves(moves, control, idle):
    parts = idle_parts(double(REST, {**REST, **moves}, control))
    assert parts.joints == idle
    assert parts.tendons == ({"t"} if "a" in idle else set())
    assert parts.actuators == {i for i, joint in enumerate("ab") if joint in idle}
    assert parts.equalities == ({0} if "b" in idle else set())


def test_locked_links_stand_where_the_joints_held_them():
    gripper = double(REST, REST, STILL)
    spec = mujoco.MjSpec.from_string(COUPLED)
    lock(spec, gripper)
    locked = spec.compile()
    assert (locked.njnt, locked.nu, locked.neq, locked.ntendon) == (0, 0, 0, 0)
    data, fixed = mujoco.MjData(gripper.model), mujoco.MjData(locked)
    for name, value in REST.items():
        data.qpos[gripper.model.joint(name).qposadr[0]] = value
    mujoco.mj_forward(gripper.model, data)
    mujoco.mj_forward(locked, fixed)
    np.testing.assert_allclose(fixed.geom_xpos, data.geom_xpos, atol=1e-9)
    np.testing.assert_allclose(fixed.geom_xmat, data.geom_xmat, atol=1e-9)


@pytest.mark.parametrize("name", OWN)
def test_our_grippers_keep_their_shape_when_locked(name):
    gripper = load_gripper(name)

    def surface(world: World) -> np.ndarray:
        world.place_gripper(np.eye(4))
        world.forward()
        touching = (world.model.geom_contype | world.model.geom_conaffinity) > 0
        return np.hstack([world.data.geom_xpos, world.data.geom_xmat])[touching]

    worlds = [
        build_world([make_box((0.04,) * 3)], gripper=gripper, table=False, locked=locked)
        for locked in (False, True)
    ]
    np.testing.assert_allclose(surface(worlds[1]), surface(worlds[0]), atol=1e-6)
    moving = len(gripper.posture("open")) - len(idle_parts(gripper).joints)
    free, locked = worlds[0].model, worlds[1].model
    assert locked.njnt == moving + 2
    assert len(surface(worlds[1])) == locked.ngeom < free.ngeom
    for name in ("body_mass", "body_inertia", "body_ipos"):
        np.testing.assert_allclose(getattr(locked, name), getattr(free, name), rtol=1e-12)


@pytest.mark.parametrize(
    ("inertia", "compiler", "left"),
    [
        ('<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>', "", 1),
        ("", "", 2),
        (
            '<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/>',
            '<compiler inertiafromgeom="true"/>',
            2,
        ),
    ],
)
def test_visual_geometry_that_weighs_something_stays(inertia, compiler, left):
    text = f"""<mujoco>{compiler}<worldbody><body name="gripper">{inertia}
     <geom type="box" size=".01 .01 .01"/>
     <geom type="sphere" size=".02" contype="0" conaffinity="0"/>
     </body></worldbody></mujoco>"""
    gripper: Any = SimpleNamespace(
        model=mujoco.MjModel.from_xml_string(text),
        posture=lambda which: {},
        control=lambda which: np.zeros(0),
    )
    spec = mujoco.MjSpec.from_string(text)
    lock(spec, gripper)
    locked = spec.compile()
    assert locked.ngeom == left
    assert locked.body_mass[1] == gripper.model.body_mass[1]


@pytest.mark.slow
def test_grasps_of_a_locked_hand_hold_as_before():
    hand, box = load_gripper("shadow_hand_3f"), make_box((0.035, 0.035, 0.08))
    poses = antipodal(box, hand, 24, np.random.default_rng(0)).object_from_gripper
    results = [
        [FreeSpaceRig(hand, box, locked=locked).trial(pose) for pose in poses]
        for locked in (False, True)
    ]
    same = [a.success == b.success for a, b in zip(*results)]
    starts = [[r.reason is Reason.START_COLLISION for r in row] for row in results]
    assert starts[0] == starts[1]
    assert sum(r.success for r in results[0]) >= 6
    assert sum(same) >= len(same) - 3
