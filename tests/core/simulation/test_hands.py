"""The shipped hands in simulation: stable drives, and things of 35 to 50 mm held in free space."""

from __future__ import annotations

from collections import Counter

import mujoco
import numpy as np
import pytest
import trimesh

from megrasp_core.grippers import Gripper, gripper_folders, load_description, load_gripper
from megrasp_core.library import antipodal
from megrasp_core.objects import ConvexPiece, ObjectModel, mass_properties
from megrasp_core.ranking import gripper_probe
from megrasp_core.simulation import FreeSpaceRig, Reason

SHIPPED = ("allegro_hand", "shadow_dexee", "shadow_hand", "shadow_hand_2f", "shadow_hand_3f")
CANDIDATES = 24
LUCKY = 3
"""So many grasps may hold by chance."""


def solid(name: str) -> ObjectModel:
    """A cube of 50 mm, or a cylinder of 35 mm where folded fingers leave less room; 150 g."""
    if name.endswith(("_2f", "_3f")):
        mesh = trimesh.creation.cylinder(radius=0.0175, height=0.08, sections=32)
    else:
        mesh = trimesh.creation.box(extents=(0.05, 0.05, 0.05))
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    properties = mass_properties([(vertices, faces)])
    return ObjectModel(
        name="solid",
        vertices=vertices,
        faces=faces,
        pieces=(ConvexPiece(vertices, faces),),
        mass=0.15,
        inertia=properties.inertia * (0.15 / properties.volume),
        colour=(0.5, 0.5, 0.5),
        category="solid",
    )


@pytest.fixture(scope="module", params=SHIPPED)
def hand(request: pytest.FixtureRequest) -> Gripper:
    """Every shipped hand in turn."""
    return load_gripper(request.param)


def test_all_shipped_hands_are_here() -> None:
    """The list above is complete."""
    own = {n: f for n, f in gripper_folders().items() if not n.endswith("_cad")}
    assert {n for n, f in own.items() if load_description(f).kind == "hand"} == set(SHIPPED)


@pytest.mark.parametrize("timestep", [0.002, 0.004])
def test_some_grasps_hold(hand: Gripper, timestep: float) -> None:
    """Of two dozen antipodal grasps several hold through the shakes, and none is unstable."""
    model = solid(hand.name)
    poses = antipodal(model, hand, CANDIDATES, np.random.default_rng(0)).object_from_gripper
    rig = FreeSpaceRig(hand, model, timestep=timestep)
    reasons = Counter(rig.trial(pose).reason for pose in poses)
    assert len(poses) == CANDIDATES
    assert reasons[Reason.SUCCESS] > LUCKY, reasons
    assert not reasons[Reason.UNSTABLE], reasons


def test_grasps_need_friction(hand: Gripper) -> None:
    """A slippery block of 2 kg leaves fingertips that held a light one, in most grasps."""
    model = solid(hand.name)
    poses = antipodal(model, hand, CANDIDATES, np.random.default_rng(0)).object_from_gripper
    rig = FreeSpaceRig(hand, model)
    held = [pose for pose in poses if rig.trial(pose).success]
    heavy = ObjectModel(**{**vars(model), "mass": 2.0, "inertia": model.inertia * (2.0 / 0.15)})
    slippery = FreeSpaceRig(hand, heavy, friction=0.005)
    lost = [not slippery.trial(pose).success for pose in held]
    assert np.mean(lost) > 0.5


def test_fingers_face_each_other(hand: Gripper) -> None:
    """The space between thumb and fingers is found, also where a forearm takes most points."""
    volume = gripper_probe(hand).volume
    assert volume is not None
    assert volume.low[0] < hand.tcp[0] - 0.01 and volume.high[0] > hand.tcp[0] + 0.01
    assert volume.low[2] < hand.tcp[2] <= volume.high[2]


def test_coupled_joints_of_the_shadow_hand() -> None:
    """One tendon bends the two last joints; stopping one leaves the motion to the other."""
    gripper = load_gripper("shadow_hand")
    model = gripper.model
    data = mujoco.MjData(model)
    data.qpos[:] = gripper.qpos("open")
    data.ctrl[:] = gripper.control("closed")
    middle = model.joint("rh_FFJ2")
    start = data.qpos[middle.qposadr[0]]
    model_limit = model.jnt_range[middle.id].copy()
    try:
        model.jnt_range[middle.id, 1] = start + 0.02
        for _ in range(500):
            mujoco.mj_step(model, data)
    finally:
        model.jnt_range[middle.id] = model_limit
    bent, last = (data.joint(f"rh_FFJ{i}").qpos[0] for i in (2, 1))
    assert bent < start + 0.05
    wanted = sum(gripper.closed_joints[f"rh_FFJ{i}"] for i in (1, 2))
    assert bent + last == pytest.approx(wanted, abs=0.05)
    assert last > gripper.closed_joints["rh_FFJ1"] + 0.3
