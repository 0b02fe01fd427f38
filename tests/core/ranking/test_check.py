"""Grasps of the 2F-85 at boxes whose place is known."""

from __future__ import annotations

import numpy as np
import pytest

from megrasp_core.grippers import load_gripper
from megrasp_core.pointcloud import OrientedBox
from megrasp_core.ranking import CheckSettings, SceneObservation, check_grasps, gripper_probe

BOX = ((-0.02, -0.03, 0.0), (0.02, 0.03, 0.06))
DOWN = np.array([0.0, 0.0, -1.0])
BIN = OrientedBox.around((0.0, 0.0, 0.075), (0.40, 0.30, 0.15))


@pytest.fixture(scope="module")
def probe():
    return gripper_probe(load_gripper("robotiq_2f85"))


def pose_at(probe, tcp, tilt: float = 0.0) -> np.ndarray:
    """world_from_gripper (4, 4) with the TCP at a point, pointing down, tilted about Y."""
    c, s = np.cos(tilt), np.sin(tilt)
    pose = np.eye(4)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    pose[:3, 3] = np.asarray(tcp) - pose[:3, :3] @ probe.tcp
    return pose


def check(observation, probe, *poses: np.ndarray, distance: float = 0.10, **options):
    stack = np.stack(poses)
    approach = stack.copy()
    approach[:, :3, 3] -= distance * stack[:, :3, 2]
    return check_grasps(observation, probe, stack, approach, **options)


def test_a_grasp_astride_a_box_passes_and_one_in_it_does_not(seen, camera, probe):
    observation = SceneObservation(seen([BOX]), camera, gravity=DOWN, region=BIN)
    result = check(
        observation, probe, pose_at(probe, (0, 0, 0.045)), pose_at(probe, (0.035, 0, 0.045))
    )
    assert list(result.reason) == ["", "collision"]
    assert result.collision_depth[0] == 0 and result.collision_depth[1] > 0.003
    assert result.inside[1] > 3 and result.inside[0] == 0
    # The box is 40 mm wide, the gripper opens to 85: 22 mm to either side, further than measured.
    assert result.clearance[0] == pytest.approx(probe.field.limit, abs=1e-3)
    assert result.clearance[1] == 0


def test_clearance_is_the_gap_beside_the_box(seen, camera, probe):
    observation = SceneObservation(seen([BOX]), camera, gravity=DOWN, region=BIN)
    result = check(observation, probe, pose_at(probe, (0.012, 0, 0.045)))
    inner = probe.volume.high[0]
    assert result.reason[0] == ""
    assert result.clearance[0] == pytest.approx(inner - 0.012 - 0.02, abs=0.0025)


def test_a_neighbour_under_the_fingers_rejects(seen, camera, probe):
    neighbour = ((0.035, -0.03, 0.0), (0.07, 0.03, 0.05))
    free = SceneObservation(seen([BOX]), camera, gravity=DOWN, region=BIN)
    tight = SceneObservation(seen([BOX, neighbour]), camera, gravity=DOWN, region=BIN)
    grasp = pose_at(probe, (0, 0, 0.03))
    assert check(free, probe, grasp).reason[0] == ""
    assert check(tight, probe, grasp).reason[0] == "collision"


def test_a_finger_in_the_shadow_of_the_box_is_unseen(seen, probe):
    side = np.array([-0.75, 0.0, 0.55])
    grasp = pose_at(probe, (0, 0, 0.02))
    slanted = SceneObservation(seen([BOX], side), side, gravity=DOWN, region=BIN)
    above = np.array([0.0, 0.0, 0.85])
    straight = SceneObservation(seen([BOX], above), above, gravity=DOWN, region=BIN)
    hidden, visible = check(slanted, probe, grasp), check(straight, probe, grasp)
    assert visible.reason[0] == "" and visible.unseen_share[0] < 0.03
    assert hidden.unseen_share[0] > 0.08
    strict = CheckSettings(max_unseen=0.05)
    assert check(slanted, probe, grasp, settings=strict).reason[0] == "unseen"


def test_an_overhang_on_the_way_rejects_although_the_pre_grasp_is_free(seen, camera, probe):
    observation = SceneObservation(seen([BOX]), camera, gravity=DOWN)
    pose = pose_at(probe, (0.20, 0.0, 0.06))
    way_through_the_box = pose.copy()
    way_through_the_box[0, 3] -= 0.15
    way_through_the_box[2, 3] -= 0.03
    without = check_grasps(observation, probe, pose[None])
    with_way = check_grasps(observation, probe, pose[None], way_through_the_box[None])
    assert without.reason[0] == "" and with_way.reason[0] == "collision"
    assert with_way.approach_inside[0] > 0 and with_way.inside[0] == 0


@pytest.mark.parametrize("tcp", [(0.17, 0.0, 0.05), (0.0, 0.0, -0.012), (-0.175, 0.0, 0.1)])
def test_walls_and_floor_reject(seen, camera, probe, tcp):
    observation = SceneObservation(seen([BOX]), camera, gravity=DOWN, region=BIN)
    result = check(observation, probe, pose_at(probe, tcp))
    assert result.reason[0] in ("collision", "workspace") and result.structure[0] > 0


def test_workspace_and_tilt(seen, camera, probe):
    observation = SceneObservation(seen([BOX]), camera, gravity=DOWN, region=BIN)
    poses = [
        pose_at(probe, (0.5, 0.0, 0.1)),
        pose_at(probe, (0, 0, 0.05), tilt=0.6),
        pose_at(probe, (0, 0, 0.05), tilt=0.2),
    ]
    result = check(observation, probe, *poses, max_tilt=0.4)
    assert list(result.reason[:2]) == ["workspace", "tilt"] and result.reason[2] != "tilt"
    np.testing.assert_allclose(result.tilt, [0.0, 0.6, 0.2], atol=1e-6)


def test_tilt_is_unknown_without_gravity(seen, camera, probe):
    observation = SceneObservation(seen([BOX]), camera)
    result = check(observation, probe, pose_at(probe, (0, 0, 0.05)), max_tilt=0.1)
    assert np.isnan(result.tilt[0]) and result.reason[0] == ""


def test_no_poses_give_no_results(seen, camera, probe):
    observation = SceneObservation(seen([BOX]), camera, gravity=DOWN, region=BIN)
    empty = np.zeros((0, 4, 4))
    result = check_grasps(observation, probe, empty, empty)
    assert len(result.reason) == len(result.clearance) == 0
