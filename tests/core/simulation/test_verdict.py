"""The verdict: what counts as a grasp and why not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from jaw_and_boxes import Jaw, at, down, make_box

from megrasp_core.errors import SimulationError
from megrasp_core.simulation import Bin, Reason, World, build_world, judge
from megrasp_core.simulation.verdict import shake_axes

BOX = (0.04, 0.06, 0.05)


def one_box(jaw: Jaw, **arguments: object) -> World:
    return build_world(
        [make_box(BOX)], gripper=jaw, object_poses=at(0, 0, 0.025)[None], **arguments
    )


def test_box_between_the_pads_is_lifted(jaw: Jaw) -> None:
    world = one_box(jaw)
    verdict = judge(world, down(0, 0, 0.01), approach=down(0, 0, 0.11))
    assert verdict.success and verdict.reason is Reason.SUCCESS
    assert verdict.lifted == (0,) and verdict.target == 0 and verdict.extra == 0
    # The scene stays as the attempt leaves it: the box hangs 20 cm higher in the hand.
    assert world.object_poses()[0, 2, 3] == pytest.approx(0.225, abs=0.003)
    assert world.hand.pose()[2, 3] == pytest.approx(0.01 + Jaw.tip + 0.2, abs=0.003)


def test_miss_beside_the_box(jaw: Jaw) -> None:
    world = one_box(jaw)
    verdict = judge(world, down(0, 0.06, 0.01))
    assert not verdict.success and verdict.reason is Reason.NO_CONTACT
    assert world.object_poses()[0] == pytest.approx(at(0, 0, 0.025), abs=1e-3)


@pytest.mark.parametrize(
    ("pose", "depth"),
    [(down(0.025, 0, 0.01), 0.005), (down(0, 0, -0.004), 0.004), (down(0.022, 0, 0.01), 0.002)],
    ids=["pad in box", "tips in table", "two millimetres"],
)
def test_start_collision_is_rejected_and_measured(
    jaw: Jaw, pose: np.ndarray, depth: float
) -> None:
    world = one_box(jaw)
    before = world.save().vector
    verdict = judge(world, pose)
    assert verdict.reason is Reason.START_COLLISION
    assert verdict.depth == pytest.approx(depth, abs=2e-4)
    assert np.array_equal(world.save().vector, before)


def test_half_a_millimetre_is_no_collision(jaw: Jaw) -> None:
    verdict = judge(one_box(jaw), down(0.0205, 0, 0.01))
    assert verdict.success and 0.0003 < verdict.depth < 0.001


def test_collision_on_the_way_is_rejected_only_with_an_approach(jaw: Jaw) -> None:
    world = build_world(
        [make_box(BOX), make_box((0.05, 0.05, 0.20), name="tower")],
        gripper=jaw,
        object_poses=np.stack([at(0, 0, 0.025), at(0.0, 0.12, 0.10)]),
    )
    through_tower = down(0, 0.12, 0.05)
    verdict = judge(world, down(0, 0, 0.01), approach=through_tower)
    assert verdict.reason is Reason.APPROACH_COLLISION and verdict.depth > 0.001
    assert judge(world, down(0, 0, 0.01)).success


def test_slippery_box_is_lost(jaw: Jaw) -> None:
    verdict = judge(one_box(jaw, friction=0.01), down(0, 0, 0.01))
    assert verdict.reason is Reason.SLIPPED and verdict.lifted == ()


def test_friction_belongs_to_the_object(jaw: Jaw) -> None:
    slippery = dataclasses.replace(make_box(BOX), friction=(0.01, 0.001))
    world = build_world([slippery], gripper=jaw, object_poses=at(0, 0, 0.025)[None])
    assert judge(world, down(0, 0, 0.01)).reason is Reason.SLIPPED


def test_obstacle_and_ungraspable_objects_do_not_count(jaw: Jaw) -> None:
    verdict = judge(one_box(jaw, obstacles={0}), down(0, 0, 0.01))
    assert not verdict.success and verdict.reason is Reason.OBSTACLE
    verdict = judge(one_box(jaw), down(0, 0, 0.01), graspable=[])
    assert not verdict.success and verdict.reason is Reason.NO_CONTACT


def test_two_at_once_count_as_extra_or_fail_with_an_obstacle(jaw: Jaw) -> None:
    def pair(**arguments: object) -> World:
        return build_world(
            [make_box((0.03, 0.05, 0.05)), make_box((0.03, 0.05, 0.05))],
            gripper=jaw,
            object_poses=np.stack([at(-0.0151, 0, 0.025), at(0.0151, 0, 0.025)]),
            **arguments,
        )

    both = judge(pair(), down(0, 0, 0.01))
    assert both.success and both.lifted == (0, 1) and both.extra == 1
    mixed = judge(pair(obstacles={1}), down(0, 0, 0.01))
    assert not mixed.success and mixed.reason is Reason.OBSTACLE and mixed.lifted == (0, 1)


def test_pinching_the_bin_wall_lifts_the_bin(jaw: Jaw) -> None:
    bin = Bin((0.4, 0.3, 0.15))
    plate = make_box((0.006, 0.08, 0.14), name="plate")
    world = build_world([plate], gripper=jaw, bin=bin, object_poses=at(0.1968, 0, 0.07)[None])
    verdict = judge(world, down(0.2, 0, 0.11))
    assert not verdict.success and verdict.reason is Reason.BIN


def test_restore_is_exact_and_trials_repeat(jaw: Jaw) -> None:
    world = build_world(
        [make_box(BOX), make_box((0.03, 0.03, 0.03))],
        gripper=jaw,
        object_poses=np.stack([at(0, 0, 0.025), at(0.1, 0, 0.015)]),
    )
    world.park_object(1)
    state = world.save()
    first, poses = judge(world, down(0, 0, 0.01, yaw=0.1)), world.object_poses()
    world.place_object(1, at(0.1, 0, 0.015))
    world.restore(state)
    assert np.array_equal(world.save().vector, state.vector) and world.parked == {1}
    assert judge(world, down(0, 0, 0.01, yaw=0.1)) == first
    assert np.array_equal(world.object_poses(), poses)


def test_shake_turns_with_the_grasp_and_survives_a_vertical_closing_axis() -> None:
    along, across = shake_axes(down(0, 0, 0.1, yaw=0.7))
    turned = down(0, 0, 0.1, yaw=0.7 + np.pi / 2)
    assert shake_axes(turned)[0] == pytest.approx(across)
    assert along @ across == pytest.approx(0.0)
    sideways = np.eye(4)
    sideways[:3, :3] = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # closing axis -z
    first, second = shake_axes(sideways)
    assert first == pytest.approx([0, 1, 0]) and abs(second[2]) == 0.0


def test_shipped_gripper_lifts_a_box() -> None:
    grippers = pytest.importorskip("megrasp_core.grippers")
    gripper = grippers.load_gripper("franka_hand")
    pose = down(0, 0, 0)
    pose[2, 3] = 0.02 + gripper.tcp[2]
    world = build_world([make_box(BOX)], gripper=gripper, object_poses=at(0, 0, 0.025)[None])
    assert judge(world, pose).success


def test_errors_name_what_is_wrong(jaw: Jaw) -> None:
    world = build_world([make_box(BOX)])
    with pytest.raises(SimulationError, match="gripper="):
        world.place_gripper(np.eye(4))
    with pytest.raises(SimulationError, match="obstacles"):
        build_world([make_box(BOX)], obstacles={3})
    jaw.posture = lambda which: {"left_joint": 0.0}  # type: ignore[method-assign]
    with pytest.raises(SimulationError, match="right_joint"):
        build_world([make_box(BOX)], gripper=jaw)
