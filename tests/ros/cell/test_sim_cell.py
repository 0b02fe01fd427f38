"""sim_cell as a real process over Fast DDS: camera, tool change, execution, refusals."""

import numpy as np
import pytest
import rclpy
from action_msgs.msg import GoalStatus
from builtin_interfaces.msg import Time
from cell_processes import WAIT, own_domain, processes, save_boxes, spinning_node, until
from geometry_msgs.msg import Point, Pose, Quaternion
from megrasp_msgs.action import ExecuteGrasp
from megrasp_msgs.msg import ErrorCode, Grasp
from megrasp_msgs.srv import ChangeTool
from rclpy.action import ActionClient
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.time import Time as NodeTime
from sensor_msgs.msg import CameraInfo, Image, JointState, PointCloud2
from std_msgs.msg import Header, String

from megrasp_core.errors import InvalidRequestError, MegraspError, UnknownGripperError
from megrasp_core.grippers import load_gripper
from megrasp_ros.cell.parameters import declare_cell_parameters
from megrasp_ros.cell.sim_cell import make_cell
from megrasp_ros.conversions import points_from_cloud, pose_from_matrix
from megrasp_ros.qos import LATCHED, SENSOR
from megrasp_ros.waiting import send_in_executor

BOX = (0.03, 0.05, 0.05)
GRIPPERS = ["robotiq_2f85", "franka_hand"]
DOMAIN = own_domain(6)


class Cell:
    """What a cell program sees of the cell."""

    def __init__(self, node) -> None:
        self.node = node
        self.latest: dict[type, object] = {}
        self.tools: list[str] = []
        for kind, topic in (
            (PointCloud2, "points"),
            (Image, "depth"),
            (CameraInfo, "camera_info"),
        ):
            node.create_subscription(
                kind, topic, lambda m, k=kind: self.latest.update({k: m}), SENSOR
            )
        node.create_subscription(String, "tool_id", lambda m: self.tools.append(m.data), LATCHED)
        self.change = node.create_client(ChangeTool, "change_tool")
        self.execution = ActionClient(node, ExecuteGrasp, "execute_grasp")
        assert self.change.wait_for_service(timeout_sec=WAIT)
        assert self.execution.wait_for_server(timeout_sec=WAIT)

    def change_tool(self, name: str) -> ChangeTool.Response:
        request = ChangeTool.Request(gripper_name=name)
        answer = send_in_executor(self.node, lambda: self.change.call_async(request), WAIT)
        assert answer is not None, "no answer in time"
        return answer

    def newest(self, kind: type):
        """A message that was stamped after now."""
        now = self.node.get_clock().now()

        def arrived() -> bool:
            message = self.latest.get(kind)
            return message is not None and NodeTime.from_msg(message.header.stamp) > now

        assert until(arrived), f"no {kind.__name__}"
        return self.latest[kind]

    def execute(self, header: Header, gripper: str, grasp: Grasp, feedback=None):
        goal = ExecuteGrasp.Goal(header=header, gripper=gripper, grasp=grasp)
        handle = self.send(goal, feedback)
        return send_in_executor(self.node, handle.get_result_async, WAIT).result

    def send(self, goal: ExecuteGrasp.Goal, feedback=None):
        def send():
            return self.execution.send_goal_async(goal, feedback_callback=feedback)

        handle = send_in_executor(self.node, send, WAIT)
        assert handle.accepted
        return handle


@pytest.fixture(scope="module")
def started(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sim_cell")
    save_boxes(folder / "boxes", 3, BOX)
    with processes(DOMAIN, folder) as running:
        running.start(
            "sim_cell",
            objects_dir=folder / "boxes",
            num_objects=3,
            grippers=GRIPPERS,
            seed=2,
            cloud_rate=10.0,
        )
        yield running


@pytest.fixture(scope="module")
def cell(started):
    with spinning_node(DOMAIN) as node:
        yield Cell(node)


def in_the_air(gripper: str, height: float = 0.4) -> Grasp:
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = height
    return Grasp(pregrasp=pose_from_matrix(pose), approach=pose_from_matrix(pose))


def box_from_above(cloud: np.ndarray, gripper: str) -> Grasp:
    """A grasp by hand on the box whose level top is seen best."""
    inside = (np.abs(cloud[:, :2]) < [0.17, 0.12]).all(axis=1)
    top = cloud[inside & (cloud[:, 2] > 0.025)]
    corner = top[np.lexsort((top[:, 1], top[:, 0]))[0]]
    box = top[np.linalg.norm(top[:, :2] - corner[:2], axis=1) < 0.075]
    middle = (box.min(axis=0) + box.max(axis=0)) / 2
    _, axes = np.linalg.eigh(np.cov(box[:, :2].T))
    tcp = np.eye(4)
    tcp[:3, 0] = [*axes[:, 0], 0.0]
    tcp[:3, 2] = [0.0, 0.0, -1.0]
    tcp[:3, 1] = np.cross(tcp[:3, 2], tcp[:3, 0])
    tcp[:3, 3] = [*middle[:2], max(0.022, box[:, 2].max() - 0.02)]
    pose = tcp @ np.linalg.inv(load_gripper(gripper).gripper_from_tcp)
    approach = pose.copy()
    approach[2, 3] += 0.10
    return Grasp(
        pregrasp=pose_from_matrix(pose),
        approach=pose_from_matrix(approach),
        tcp=pose_from_matrix(tcp),
    )


def test_points_depth_and_camera_agree(cell):
    cloud = cell.newest(PointCloud2)
    points = points_from_cloud(cloud)
    assert cloud.header.frame_id == "cell"
    assert len(points) > 100_000
    assert abs(np.median(points[:, 2])) < 0.01
    assert (
        (points[:, 2] > 0.02) & (np.abs(points[:, :2]) < [0.19, 0.14]).all(axis=1)
    ).sum() > 2000
    depth = cell.newest(Image)
    info = cell.newest(CameraInfo)
    assert depth.encoding == "32FC1"
    assert depth.header.frame_id == info.header.frame_id == "cell_camera_optical_frame"
    image = np.frombuffer(depth.data, "<f4").reshape(depth.height, depth.width)
    assert (info.width, info.height) == (depth.width, depth.height)
    assert np.isfinite(image).sum() == len(points)
    # The depth image, unprojected with camera_info and seen from 0.85 m above, is the cloud.
    k = np.array(info.k).reshape(3, 3)
    row, column = np.nonzero(np.isfinite(image))
    z = image[row, column].astype(float)
    x = (column - k[0, 2]) / k[0, 0] * z
    y = (row - k[1, 2]) / k[1, 1] * z
    np.testing.assert_allclose(np.stack([x, -y, 0.85 - z], axis=1), points, atol=1e-4)


def test_the_tool_is_changed_and_reported(cell):
    answer = cell.change_tool("franka_hand")
    assert (answer.success, answer.mounted, answer.message) == (True, "franka_hand", "")
    assert until(lambda: cell.tools[-1:] == ["franka_hand"])
    answer = cell.change_tool("vacuum")
    assert not answer.success
    assert answer.mounted == "franka_hand"
    assert "robotiq_2f85" in answer.message
    assert "gripper_name is empty" in cell.change_tool("").message
    assert cell.change_tool("robotiq_2f85").success
    assert until(lambda: cell.tools[-1:] == ["robotiq_2f85"])


@pytest.mark.parametrize(
    ("change", "code", "message"),
    [
        ({"gripper": "franka_hand"}, ErrorCode.TOOL_MISMATCH, "robotiq_2f85 is mounted"),
        ({"gripper": ""}, ErrorCode.TOOL_MISMATCH, "no gripper named"),
        ({"frame": "base_link"}, ErrorCode.TRANSFORM_OR_GRAVITY_MISSING, "expected 'cell'"),
        ({"stamp": Time()}, ErrorCode.INVALID_REQUEST, "header.stamp is 0"),
        ({"stamp": Time(sec=2_000_000_000)}, ErrorCode.INVALID_REQUEST, "in the future"),
        ({"pregrasp": Pose(orientation=Quaternion(w=0.0))}, ErrorCode.INVALID_REQUEST, "unit"),
        ({"pregrasp": Pose(position=Point(x=float("nan")))}, ErrorCode.INVALID_REQUEST, "finite"),
        ({"approach": Pose(position=Point(z=300.0))}, ErrorCode.INVALID_REQUEST, "metres"),
        (
            {"pregrasp_posture": JointState(name=["elbow"], position=[0.1])},
            ErrorCode.INVALID_REQUEST,
            "joints ['elbow']",
        ),
        (
            {"pregrasp_posture": JointState(name=["elbow"])},
            ErrorCode.INVALID_REQUEST,
            "expected a finite position",
        ),
    ],
)
def test_goals_that_make_no_sense_are_refused(cell, change, code, message):
    cell.change_tool("robotiq_2f85")
    grasp = in_the_air("robotiq_2f85")
    header = Header(
        frame_id=change.get("frame", "cell"), stamp=cell.node.get_clock().now().to_msg()
    )
    header.stamp = change.get("stamp", header.stamp)
    for name in ("pregrasp", "approach", "pregrasp_posture"):
        setattr(grasp, name, change.get(name, getattr(grasp, name)))
    answer = cell.execute(header, change.get("gripper", "robotiq_2f85"), grasp)
    assert not answer.success
    assert answer.error_code == code
    assert message in answer.error_msg
    assert answer.objects_left == 3
    assert np.isnan(answer.width)


def test_a_stale_grasp_is_refused(cell):
    cell.change_tool("robotiq_2f85")
    header = cell.newest(PointCloud2).header
    first = cell.execute(header, "robotiq_2f85", in_the_air("robotiq_2f85"))
    assert (first.success, first.error_code, first.error_msg) == (False, 0, "no_contact")
    # Closed on nothing, the fingers meet.
    assert first.width < 0.005
    second = cell.execute(header, "robotiq_2f85", in_the_air("robotiq_2f85"))
    assert second.error_code == ErrorCode.STALE_CLOUD
    assert "not_before" in second.error_msg


def test_a_second_goal_is_busy_or_waits_its_turn(cell):
    """Two goals at once: one is carried out, the other gets an answer, and nothing hangs."""
    cell.change_tool("robotiq_2f85")
    header = cell.newest(PointCloud2).header
    goal = ExecuteGrasp.Goal(
        header=header, gripper="robotiq_2f85", grasp=in_the_air("robotiq_2f85")
    )
    handles = [cell.send(goal) for _ in range(2)]
    codes = {
        send_in_executor(cell.node, handle.get_result_async, WAIT).result.error_code
        for handle in handles
    }
    assert 0 in codes
    assert codes <= {0, ErrorCode.BUSY, ErrorCode.STALE_CLOUD}
    assert len(codes) == 2


def test_a_good_grasp_takes_a_box_out(cell):
    """Last in this file, because it changes the number of objects."""
    phases = []
    for gripper in GRIPPERS:
        cell.change_tool(gripper)
        cloud = cell.newest(PointCloud2)
        grasp = box_from_above(points_from_cloud(cloud), gripper)
        answer = cell.execute(
            cloud.header, gripper, grasp, feedback=lambda m: phases.append(m.feedback.phase)
        )
        if answer.success:
            break
    assert answer.success, answer
    assert len(answer.removed) == 1
    assert answer.removed[0].startswith("box_")
    assert answer.objects_left == 2
    assert answer.width == pytest.approx(BOX[0], abs=0.008)
    assert until(lambda: phases[-4:] == ["approach", "close", "lift", "drop"])


def test_a_cancelled_grasp_leaves_the_scene_as_it_was(cell):
    cell.change_tool("robotiq_2f85")
    cloud = cell.newest(PointCloud2)
    grasp = box_from_above(points_from_cloud(cloud), "robotiq_2f85")
    goal = ExecuteGrasp.Goal(header=cloud.header, gripper="robotiq_2f85", grasp=grasp)
    handle = cell.send(goal)
    send_in_executor(cell.node, handle.cancel_goal_async, WAIT)
    answer = send_in_executor(cell.node, handle.get_result_async, WAIT)
    if answer.status == GoalStatus.STATUS_SUCCEEDED:
        # The attempt was over before the cancellation came.
        return
    assert answer.status == GoalStatus.STATUS_CANCELED
    assert answer.result.error_code == ErrorCode.CANCELLED
    assert not answer.result.success and not answer.result.removed
    # The cloud still shows the scene, so that the same grasp may be executed.
    again = cell.execute(cloud.header, "robotiq_2f85", grasp)
    assert again.error_code == ErrorCode.NONE


def test_the_optical_frame_looks_down_on_the_bin(tmp_path):
    domain = own_domain(7)
    with processes(domain, tmp_path) as running, spinning_node(domain) as node:
        running.start("sim_cell", num_objects=1, grippers=["robotiq_2f85"], frame="optical")
        cell = Cell(node)
        cloud = cell.newest(PointCloud2)
        points = points_from_cloud(cloud)
        assert cloud.header.frame_id == "cell_camera_optical_frame"
        assert np.median(points[:, 2]) == pytest.approx(0.85, abs=0.01)
        # z up in the cell is -z here: a grasp pointing down has the identity as rotation.
        pose = np.eye(4)
        pose[2, 3] = 0.40
        grasp = Grasp(pregrasp=pose_from_matrix(pose), approach=pose_from_matrix(pose))
        answer = cell.execute(cloud.header, "robotiq_2f85", grasp)
        assert (answer.error_code, answer.error_msg) == (0, "no_contact")


def test_wrong_parameters_end_the_process_with_2(tmp_path):
    with processes(DOMAIN, tmp_path) as running:
        process = running.start("sim_cell", grippers=["vacuum"])
        assert process.wait(timeout=WAIT) == 2, running.log("sim_cell")
        assert "unknown gripper 'vacuum'" in running.log("sim_cell")


@pytest.mark.parametrize(
    ("parameters", "error", "message"),
    [
        ({"frame": "base_link"}, InvalidRequestError, "expected one of cell, optical"),
        ({"gripper": "vacuum"}, UnknownGripperError, "unknown gripper 'vacuum'"),
        ({"objects_dir": "/nowhere"}, MegraspError, "/nowhere"),
        ({"num_objects": 0}, ParameterException, "num_objects"),
        ({"cloud_rate": 1000.0}, ParameterException, "cloud_rate"),
    ],
)
def test_wrong_parameters_are_named(parameters, error, message):
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    overrides = [Parameter(name, value=value) for name, value in parameters.items()]
    node = Node("sim_cell", context=context, parameter_overrides=overrides)
    try:
        with pytest.raises(error, match=message):
            make_cell(declare_cell_parameters(node))
    finally:
        node.destroy_node()
        context.try_shutdown()
