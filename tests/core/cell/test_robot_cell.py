"""The robot cell: known boxes at known places, grasps computed by hand."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from megrasp_core.cell.robot_cell import CellSettings, RobotCell
from megrasp_core.errors import CancelledError, InvalidRequestError, UnknownGripperError
from megrasp_core.objects import ObjectModel

RACK = ("robotiq_2f85", "franka_hand")
BOX = np.array([0.03, 0.05, 0.05])
NEAR, FAR = (0.06, 0.05), (-0.06, -0.05)


def box_model(name: str, edges: np.ndarray = BOX, density: float = 600.0) -> ObjectModel:
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * edges / 2
    faces = np.array(
        [
            [0, 1, 3],
            [0, 3, 2],
            [4, 6, 7],
            [4, 7, 5],
            [0, 4, 5],
            [0, 5, 1],
            [2, 3, 7],
            [2, 7, 6],
            [0, 2, 6],
            [0, 6, 4],
            [1, 5, 7],
            [1, 7, 3],
        ]
    )
    mass = density * float(np.prod(edges))
    x, y, z = edges**2
    inertia = np.diag([y + z, x + z, x + y]) * mass / 12
    return ObjectModel(name, corners, faces, ((corners, faces),), mass, inertia)


def standing(xy: tuple[float, float], yaw: float = 0.0) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("z", yaw).as_matrix()
    pose[:3, 3] = [*xy, BOX[2] / 2]
    return pose


def grasp_from_above(cell: RobotCell, xy: tuple[float, float], z: float) -> tuple:
    """Pre-grasp and approach pose (4, 4) with the TCP at (x, y, z), closing along world x."""
    tcp = np.diag([1.0, -1.0, -1.0, 1.0])
    tcp[:3, 3] = [*xy, z]
    pose = tcp @ np.linalg.inv(cell.gripper.gripper_from_tcp)
    approach = pose.copy()
    approach[2, 3] += 0.10
    return pose, approach


@pytest.fixture(scope="module")
def grippers():
    from megrasp_core.grippers import load_gripper

    return [load_gripper(name) for name in RACK]


@pytest.fixture
def cell(grippers) -> RobotCell:
    return RobotCell(
        [box_model("box"), box_model("box")],
        grippers,
        seed=3,
        object_poses=np.stack([standing(NEAR), standing(FAR)]),
    )


def test_names_are_unique_and_everything_is_there(cell):
    assert cell.object_names == ("box", "box#2")
    assert cell.objects_left == 2
    assert cell.rack == RACK
    assert cell.gripper.name == RACK[0]


def test_capture_shows_the_boxes_where_they_stand(cell):
    cloud = cell.capture()
    on_top = cloud.points[np.abs(cloud.points[:, 2] - BOX[2]) < 0.004]
    # The walls' inner sides show at this height too; look near the boxes only.
    for xy in (NEAR, FAR):
        near = on_top[np.linalg.norm(on_top[:, :2] - xy, axis=1) < 0.06]
        assert len(near) > 500
        assert near[:, :2].mean(axis=0) == pytest.approx(xy, abs=0.003)
        extent = np.quantile(near, 0.99, axis=0) - np.quantile(near, 0.01, axis=0)
        assert extent[:2] == pytest.approx(BOX[:2], abs=0.006)
    np.testing.assert_allclose(cloud.viewpoint, cell.settings.camera.position)


def test_capture_is_noisy_and_can_be_repeated(grippers, cell):
    same = RobotCell(
        [box_model("box"), box_model("box")],
        grippers,
        seed=3,
        object_poses=np.stack([standing(NEAR), standing(FAR)]),
    )
    np.testing.assert_array_equal(cell.capture().points, same.capture().points)
    other = RobotCell(
        [box_model("box"), box_model("box")],
        grippers,
        seed=4,
        object_poses=np.stack([standing(NEAR), standing(FAR)]),
    )
    assert not np.array_equal(cell.look().depth, other.look().depth)
    floor = cell.capture().points
    floor = floor[np.linalg.norm(floor[:, :2], axis=1) < 0.03]
    assert 0.0002 < floor[:, 2].std() < 0.003


def test_depth_image_and_cloud_agree(cell):
    view = cell.look()
    assert view.depth.shape == (view.camera.height, view.camera.width)
    assert np.count_nonzero(view.depth > 0) == len(view.cloud)
    camera_from_world = np.linalg.inv(view.camera.world_from_camera)
    depths = (view.cloud.points @ camera_from_world[:3, :3].T + camera_from_world[:3, 3])[:, 2]
    np.testing.assert_allclose(depths, view.depth[view.depth > 0], atol=1e-5)


@pytest.mark.parametrize("name", RACK)
def test_a_good_grasp_removes_the_box(cell, name):
    cell.change_tool(name)
    result = cell.execute(*grasp_from_above(cell, NEAR, 0.030))
    assert result.success, result
    assert result.removed == ("box",)
    assert result.error == ""
    assert result.width == pytest.approx(BOX[0], abs=0.006)
    assert cell.objects_left == result.objects_left == 1
    assert cell.remaining == ("box#2",)
    cloud = cell.capture().points
    above = cloud[(cloud[:, 2] > 0.02) & (np.linalg.norm(cloud[:, :2] - NEAR, axis=1) < 0.04)]
    assert len(above) == 0


def test_a_grasp_into_the_air_leaves_everything(cell):
    before = cell.object_poses()
    result = cell.execute(*grasp_from_above(cell, (0.0, 0.0), 0.05))
    assert not result.success
    assert result.removed == ()
    assert result.error == "no_contact"
    assert result.width < 0.005
    assert cell.objects_left == 2
    for name, pose in cell.object_poses().items():
        np.testing.assert_allclose(pose, before[name], atol=1e-3)


def test_a_grasp_inside_the_box_is_a_start_collision(cell):
    """The box stands turned by a quarter, 50 mm wide, right under one finger."""
    off = (NEAR[0] + 0.045, NEAR[1])
    result = cell.execute(*grasp_from_above(cell, off, 0.030))
    assert not result.success
    assert result.error == "start_collision"
    assert result.depth > 0.001
    assert np.isnan(result.width)
    assert cell.objects_left == 2
    # A ranked grasp starts at its own opening, here short of the box.
    pose, approach = grasp_from_above(cell, off, 0.030)
    grasp = SimpleNamespace(
        world_from_gripper=pose, world_from_gripper_approach=approach, share=0.9
    )
    assert cell.execute_grasp(grasp).error != "start_collision"


def test_an_approach_through_the_wall_fails(cell):
    pose, approach = grasp_from_above(cell, NEAR, 0.030)
    approach[:2, 3] += [0.25, 0.0]
    result = cell.execute(pose, approach)
    assert not result.success
    assert result.error == "approach_collision"
    assert cell.execute(pose, None).success


def test_a_box_that_slips_out_stays_in_the_bin(cell):
    """Held by the last 3 mm of its top, the box slips or is lifted; it is never lost."""
    result = cell.execute(*grasp_from_above(cell, NEAR, 0.060))
    assert result.spilled == ()
    assert cell.objects_left == 2 - len(result.removed)
    assert result.success == bool(result.removed)


def test_the_rest_stands_still_while_one_is_taken(cell):
    before = cell.object_poses()["box#2"]
    cell.execute(*grasp_from_above(cell, NEAR, 0.030))
    np.testing.assert_allclose(cell.object_poses()["box#2"], before, atol=1e-3)


def test_a_tool_change_keeps_the_poses(cell):
    cell.execute(*grasp_from_above(cell, NEAR, 0.030))
    before = cell.object_poses()
    depth = cell.look().depth
    cell.change_tool("franka_hand")
    assert cell.gripper.name == "franka_hand"
    assert cell.objects_left == 1
    after = cell.object_poses()
    assert after.keys() == before.keys() == {"box#2"}
    np.testing.assert_allclose(after["box#2"], before["box#2"], atol=1e-9)
    # The camera sees the very same scene: the gripper is not in the picture.
    cell._view = None
    np.testing.assert_array_equal(cell.look().depth, depth)


def test_an_unknown_tool_is_refused_and_the_old_one_stays(cell):
    with pytest.raises(UnknownGripperError, match="franka_hand"):
        cell.change_tool("vacuum")
    assert cell.gripper.name == RACK[0]
    assert cell.execute(*grasp_from_above(cell, NEAR, 0.030)).success


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        (np.eye(3), "shape"),
        (np.full((4, 4), np.nan), "finite"),
        (np.diag([2.0, 2.0, 2.0, 1.0]), "orthonormal"),
        (np.diag([-1.0, 1.0, 1.0, 1.0]), "orthonormal"),
        (np.block([[np.eye(3), np.array([[0], [0], [300.0]])], [0, 0, 0, 1]]), "metres"),
    ],
)
def test_bad_poses_are_refused(cell, pose, message):
    with pytest.raises(InvalidRequestError, match=message):
        cell.execute(pose)
    with pytest.raises(InvalidRequestError, match=message):
        cell.execute(grasp_from_above(cell, NEAR, 0.03)[0], pose)
    assert cell.version == 0


def test_bad_cells_are_refused(grippers):
    with pytest.raises(InvalidRequestError, match="0 objects"):
        RobotCell([], grippers)
    with pytest.raises(InvalidRequestError, match="grippers"):
        RobotCell([box_model("box")], [])
    with pytest.raises(UnknownGripperError):
        RobotCell([box_model("box")], grippers, mounted="vacuum")
    with pytest.raises(InvalidRequestError, match="object_poses"):
        RobotCell([box_model("box")], grippers, object_poses=np.eye(4))
    with pytest.raises(InvalidRequestError, match="1 to 40"):
        RobotCell.procedural(0, grippers)


def test_a_procedural_cell_can_be_repeated(grippers):
    settings = CellSettings(noise=None)
    first, second = (
        RobotCell.procedural(4, grippers[:1], seed=5, settings=settings) for _ in range(2)
    )
    assert first.object_names == second.object_names
    for a, b in zip(first.object_poses().values(), second.object_poses().values(), strict=True):
        np.testing.assert_array_equal(a, b)
    assert all(
        first.region.contains(pose[None, :3, 3])[0] for pose in first.object_poses().values()
    )
    other = RobotCell.procedural(4, grippers[:1], seed=6, settings=settings)
    assert other.object_names != first.object_names
    pose, approach = grasp_from_above(first, (0.0, 0.0), 0.05)
    assert first.execute(pose, approach) == second.execute(pose, approach)
    for a, b in zip(first.object_poses().values(), second.object_poses().values(), strict=True):
        np.testing.assert_array_equal(a, b)


def test_phases_are_told_and_an_attempt_can_be_broken_off_in_each(cell):
    pose, approach = grasp_from_above(cell, NEAR, 0.03)
    for last in ("approach", "close", "lift", "drop"):
        before = cell.object_poses()

        def stop(phase: str, last: str = last) -> None:
            if phase == last:
                raise CancelledError("enough")

        with pytest.raises(CancelledError, match="enough"):
            cell.execute(pose, approach, on_phase=stop)
        assert (cell.version, cell.objects_left) == (0, 2)
        for name, place in cell.object_poses().items():
            np.testing.assert_allclose(place, before[name], atol=1e-12)
    told: list[str] = []
    assert cell.execute(pose, approach, on_phase=told.append).success
    assert told == ["approach", "close", "lift", "drop"]
