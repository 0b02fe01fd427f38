"""Other physics for one trial: what changes, that it is what compiling anew would give, and that
nothing of it is left.
"""

from __future__ import annotations

import copy
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from jaw_and_boxes import at, down, make_box

from megrasp_core.errors import SimulationError
from megrasp_core.grippers import load_gripper
from megrasp_core.simulation import Reason, Variation, World, build_world, judge, varied
from megrasp_core.simulation.world import GRIPPER

ALL = Variation(friction=0.45, mass=1.4, force=0.7)


def model_arrays(world: World) -> dict[str, bytes]:
    """Every array of the compiled model, and its options."""
    model = world.model
    found = {
        name: value.tobytes()
        for name in dir(model)
        if isinstance(value := getattr(model, name), np.ndarray)
    }
    assert len(found) > 300
    return found


def scene(jaw, mass: float = 0.1, friction: float = 0.8) -> World:
    box = replace(make_box((0.04, 0.04, 0.06), mass), friction=(friction, 0.01))
    other = make_box((0.05, 0.05, 0.05), 0.2)
    world = build_world(
        [box, other], gripper=jaw, object_poses=np.stack([at(0, 0, 0.03), at(0.2, 0, 0.025)])
    )
    world.step(200)
    return world


def test_the_model_is_bit_for_bit_as_before_also_after_an_error(jaw):
    world = scene(jaw)
    before = model_arrays(world)
    start = world.save()
    with varied(world, ALL):
        inside = model_arrays(world)
        judge(world, down(0, 0, 0.02))
    changed = {name for name in before if before[name] != inside[name]}
    assert {"geom_friction", "body_mass", "body_inertia", "actuator_forcerange"} <= changed
    assert model_arrays(world) == before
    world.restore(start)
    with pytest.raises(ZeroDivisionError), varied(world, ALL):
        raise ZeroDivisionError
    assert model_arrays(world) == before
    with varied(world, Variation()):
        assert model_arrays(world) == before


def test_a_trial_leaves_no_trace_in_the_next(jaw):
    def outcome(world: World) -> bytes:
        mujoco.mj_resetData(world.model, world.data)
        world.restore(start)
        assert judge(world, down(0.003, 0, 0.02)).success
        return world.save().vector.tobytes()

    world = scene(jaw)
    start = world.save()
    plain = outcome(world)
    with varied(world, ALL):
        assert outcome(world) != plain
    assert outcome(world) == plain


def test_other_masses_are_what_compiling_with_them_gives(jaw):
    world, heavier = scene(jaw), scene(jaw, 0.14)
    with varied(world, Variation(mass=1.4)):
        body, dof = world.object_bodies[0], world.object_dofs[0]
        for name in ("body_mass", "body_inertia", "body_invweight0", "body_subtreemass"):
            ours, theirs = (getattr(one.model, name)[body] for one in (world, heavier))
            np.testing.assert_allclose(ours, theirs, rtol=1e-9, err_msg=name)
        for name in ("dof_invweight0", "dof_M0"):
            ours, theirs = (getattr(one.model, name)[dof] for one in (world, heavier))
            np.testing.assert_allclose(ours, theirs, rtol=1e-9, err_msg=name)
        derived = copy.copy(world.model)
        mujoco.mj_setConst(derived, mujoco.MjData(derived))
        for name in ("body_subtreemass", "body_invweight0", "dof_invweight0", "dof_M0"):
            np.testing.assert_allclose(
                getattr(world.model, name), getattr(derived, name), rtol=1e-9, err_msg=name
            )


def test_a_heap_at_rest_stays_at_rest(jaw):
    stacked = [make_box((0.06, 0.06, 0.04), 0.3), make_box((0.05, 0.05, 0.03), 0.1)]
    tilted = at(0.004, 0, 0.0548)
    world = build_world(stacked, gripper=jaw, object_poses=np.stack([at(0, 0, 0.02), tilted]))
    world.step(500)
    before = world.object_poses()
    with varied(world, ALL):
        world.step(500)
    assert np.abs(world.object_poses() - before).max() < 1e-4


def held_weight(world: World, variation: Variation) -> Reason:
    with varied(world, variation):
        return judge(world, down(0, 0, 0.02)).reason


@pytest.mark.parametrize(
    ("mass", "better", "worse"),
    [
        # 40 N on both sides hold 2 * 0.8 * 40 N / g = 6.5 kg at rest, less while shaken.
        (4.0, Variation(), Variation(friction=0.4)),
        (4.0, Variation(), Variation(force=0.45)),
        (2.6, Variation(), Variation(mass=2.5)),
        (5.2, Variation(friction=1.6), Variation()),
        (7.5, Variation(mass=0.4), Variation()),
    ],
)
def test_what_is_smoother_weaker_or_heavier_slips(jaw, mass, better, worse):
    reasons = []
    for variation in (better, worse):
        world = scene(jaw, mass)
        reasons.append(held_weight(world, variation))
    assert reasons == [Reason.SUCCESS, Reason.SLIPPED]


def test_friction_counts_for_the_gripper_and_nothing_else(jaw):
    world = scene(jaw)
    with varied(world, Variation(friction=0.45)):
        start = world.save()
        world.place_gripper(down(0, 0, 0.02), "closed")
        world.forward()
        owner = world.owner[world.data.contact.geom]
        ours = (owner == GRIPPER).any(axis=1)
        sliding = world.data.contact.friction[:, 0]
        assert ours.any() and not ours.all()
        np.testing.assert_allclose(sliding[ours], 0.45)
        np.testing.assert_allclose(sliding[~ours], 0.8)
        world.restore(start)


@pytest.mark.parametrize("name", ["robotiq_2f85", "shadow_hand", "angular_000042"])
def test_drives_give_that_share_of_their_force(name):
    world = build_world([], gripper=load_gripper(name))
    model, data = world.model, world.data
    for share in (0.0, 0.02, 1.0):
        world.place_gripper(at(0, 0, 0.5), "open")
        world.hand.drive(share)
        data.qvel[6:] = 0.01
        world.forward()
        plain = data.actuator_force.copy()
        with varied(world, Variation(force=0.7)):
            world.forward()
            np.testing.assert_allclose(data.actuator_force, 0.7 * plain, atol=1e-12)
        assert share == 0.0 or np.abs(plain).max() > 0.0
    assert (np.abs(plain) <= np.abs(model.actuator_forcerange).max(axis=1) + 1e-12).all()


def test_nonsense_is_refused(jaw):
    for field in ("friction", "mass", "force"):
        with pytest.raises(SimulationError, match=f"{field} -1.0 was given"):
            Variation(**{field: -1.0})
    world = build_world([make_box((0.04, 0.04, 0.06))], gripper=jaw)
    world.model.actuator_gaintype[0] = int(mujoco.mjtGain.mjGAIN_MUSCLE)
    before = model_arrays(world)
    with pytest.raises(SimulationError, match="such as muscles"), varied(world, ALL):
        pass
    assert model_arrays(world) == before
    with (
        pytest.raises(SimulationError, match="no gripper"),
        varied(build_world([]), Variation(force=0.9)),
    ):
        pass
