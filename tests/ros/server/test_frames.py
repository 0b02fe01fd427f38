"""From the frame of the cloud into the planning frame: parameters first, tf2 (a stub) last."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from std_msgs.msg import Header

from megrasp_core.errors import GravityError
from megrasp_core.grippers import load_gripper
from megrasp_ros.errors import TransformError
from megrasp_ros.server import frames
from megrasp_ros.server.frames import FrameSource, gravity_in
from megrasp_ros.server.static_frames import gripper_frames


@pytest.fixture(scope="module")
def node():
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=19)
    made = Node("frames", context=context)
    yield made
    made.destroy_node()
    context.try_shutdown()


class StubBuffer:
    """tf2 with one transform, 1 m up."""

    def __init__(self, known: tuple[str, str]) -> None:
        self.known = known
        self.asked: list = []

    def lookup_transform(self, target, source, time, timeout):
        self.asked.append((target, source, time.nanoseconds, timeout.nanoseconds))
        if (target, source) != self.known:
            raise LookupError(f"{source} does not exist")
        found = TransformStamped()
        found.transform.translation.z = 1.0
        found.transform.rotation.x = 1.0
        found.transform.rotation.w = 0.0
        return found


def settings(**values):
    return SimpleNamespace(
        **({"planning_frame": "", "extrinsics": None, "gravity": None, "tf_timeout": 0.2} | values)
    )


def header(frame: str = "camera") -> Header:
    made = Header(frame_id=frame)
    made.stamp.sec, made.stamp.nanosec = 12, 500
    return made


def test_without_a_planning_frame_the_cloud_stays_where_it_is(node: Node) -> None:
    frame, matrix = FrameSource(node).planning_from_cloud(header(), settings())
    assert frame == "camera"
    np.testing.assert_array_equal(matrix, np.eye(4))


def test_extrinsics_come_before_tf2(node: Node) -> None:
    buffer, extrinsics = StubBuffer(("base", "camera")), np.diag([1.0, -1.0, -1.0, 1.0])
    given = settings(planning_frame="base", extrinsics=extrinsics)
    frame, matrix = FrameSource(node, buffer).planning_from_cloud(header(), given)
    assert frame == "base"
    np.testing.assert_array_equal(matrix, extrinsics)
    assert not buffer.asked


def test_a_cloud_in_the_planning_frame_is_not_moved(node: Node) -> None:
    given = settings(planning_frame="base", extrinsics=np.diag([1.0, -1.0, -1.0, 1.0]))
    np.testing.assert_array_equal(
        FrameSource(node).planning_from_cloud(header("base"), given)[1], np.eye(4)
    )


def test_tf2_is_asked_at_the_stamp_of_the_cloud(node: Node) -> None:
    buffer = StubBuffer(("base", "camera"))
    frame, matrix = FrameSource(node, buffer).planning_from_cloud(
        header(), settings(planning_frame="base")
    )
    assert frame == "base"
    assert buffer.asked == [("base", "camera", 12 * 10**9 + 500, 200_000_000)]
    np.testing.assert_allclose(matrix @ [0.1, 0.2, 0.3, 1], [0.1, -0.2, 0.7, 1], atol=1e-12)


def test_an_unknown_transform_says_what_to_do(node: Node) -> None:
    source = FrameSource(node, StubBuffer(("base", "other")))
    with pytest.raises(
        TransformError, match=r"'camera' to planning_frame 'base'.*does not exist.*extrinsics"
    ):
        source.planning_from_cloud(header(), settings(planning_frame="base"))


def test_extrinsics_without_the_name_of_their_frame_are_refused(node: Node) -> None:
    with pytest.raises(TransformError, match="planning_frame is empty"):
        FrameSource(node).planning_from_cloud(header(), settings(extrinsics=np.eye(4)))


def test_gravity_has_no_silent_default_in_an_optical_frame() -> None:
    np.testing.assert_array_equal(gravity_in("base_link", settings()), [0, 0, -1])
    np.testing.assert_array_equal(
        gravity_in("camera_optical_frame", settings(gravity=np.array([0, 0, 1.0]))), [0, 0, 1]
    )
    with pytest.raises(GravityError, match=r"gravity: \[0.0, 0.0, 1.0\]"):
        gravity_in("camera_optical_frame", settings())


def test_the_listener_is_there_before_the_first_request(
    node: Node, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[StubBuffer] = []

    def make(node: Node) -> StubBuffer:
        made.append(StubBuffer(("base", "camera")))
        return made[-1]

    monkeypatch.setattr(frames, "tf2_buffer", make)
    source = FrameSource(node)
    source.listen(settings())
    source.listen(settings(planning_frame="base", extrinsics=np.eye(4)))
    assert not made
    source.listen(settings(planning_frame="base"))
    source.listen(settings(planning_frame="base"))
    assert len(made) == 1
    given = settings(planning_frame="base", tf_timeout=1.5)
    assert source.planning_from_cloud(header(), given)[0] == "base"
    assert made[0].asked[0][3] == 1_500_000_000
    assert source.last == "camera -> base by tf2"


def test_the_gripper_hangs_on_the_flange() -> None:
    gripper = load_gripper("robotiq_2f85")
    flange_from_gripper = np.diag([1.0, -1.0, -1.0, 1.0])
    flange_from_gripper[:3, 3] = [0.0, 0.0, 0.02]
    mounted, tcp = gripper_frames(gripper, flange_from_gripper, "tool0", header().stamp)
    assert (mounted.header.frame_id, mounted.child_frame_id) == ("tool0", "gripper")
    assert (tcp.header.frame_id, tcp.child_frame_id) == ("gripper", "gripper_tcp")
    t, q = mounted.transform.translation, mounted.transform.rotation
    assert (t.z, abs(q.x)) == pytest.approx((0.02, 1.0))
    t = tcp.transform.translation
    assert (t.x, t.y, t.z) == pytest.approx(tuple(gripper.tcp))
