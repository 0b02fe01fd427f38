"""`megrasp_call view`: clouds of a real topic in the viewer, a server's settings, a cell."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from ament_index_python.packages import get_package_prefix
from browser import chromium, eventually, opened
from cell_processes import default_signals, own_domain, processes, spinning_node, until
from geometry_msgs.msg import TransformStamped
from megrasp_msgs.action import ExecuteGrasp
from megrasp_msgs.msg import ErrorCode
from megrasp_msgs.srv import ChangeTool
from rclpy.action import ActionServer
from rclpy.node import Node
from server_client import Client, camera, table_points

from megrasp_core.errors import CancelledError, CloudError, MegraspError
from megrasp_core.synthesizer import GraspSynthesizer
from megrasp_core.viewer import SceneViewer, open_server
from megrasp_ros.call import view as view_module
from megrasp_ros.call.app import run
from megrasp_ros.call.view import LiveCloud, as_the_server, live_viewer
from megrasp_ros.client import GraspClient
from megrasp_ros.conversions import matrix_from_pose
from megrasp_ros.server import frames

pytest.importorskip("viser", reason="viser is missing: pip install 'megrasp-core[view]'")

DOMAIN = own_domain(8)
LOOKING_DOWN = np.diag([1.0, -1.0, -1.0, 1.0])
LOOKING_DOWN[2, 3] = 0.8
"""world_from_camera of a camera 0.8 m above the table."""
AT_REST = {"cloud_timeout": 30.0, "tf_timeout": 2.0, "cloud_max_age": 0.0}


def seen_from_above(points: np.ndarray) -> np.ndarray:
    """Points of the world in the frame of that camera."""
    return (points - LOOKING_DOWN[:3, 3]) @ LOOKING_DOWN[:3, :3]


def drawn(viewer: SceneViewer) -> np.ndarray:
    """The points in the page, in an order that does not depend on theirs."""
    handle: Any = viewer.server.scene.get_handle_by_name("/cloud")
    return np.sort(np.asarray(handle.points, np.float64), axis=0)


@dataclass
class FakeCell:
    """Serves `change_tool` and `execute_grasp`, and publishes clouds."""

    node: Node
    goals: list[ExecuteGrasp.Goal] = field(default_factory=list)
    tools: list[str] = field(default_factory=list)
    mounts: bool = True
    answer: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.service = self.node.create_service(ChangeTool, "change_tool", self._change)
        self.action = ActionServer(self.node, ExecuteGrasp, "execute_grasp", self._execute)

    def _change(self, request: ChangeTool.Request, response: ChangeTool.Response):
        self.tools.append(request.gripper_name)
        response.success, response.message = self.mounts, "" if self.mounts else "it is stuck"
        return response

    def _execute(self, handle) -> ExecuteGrasp.Result:
        self.goals.append(handle.request)
        handle.succeed()
        return ExecuteGrasp.Result(**self.answer)

    def publishing(self, points: np.ndarray, frame: str = "world"):
        """Clouds while the context lasts."""
        return camera(SimpleNamespace(node=self.node), points, frame=frame)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def cell() -> Iterator[FakeCell]:
    with spinning_node(DOMAIN, "fake_cell") as node:
        yield FakeCell(node)


@pytest.fixture(scope="module")
def client() -> Iterator[GraspClient]:
    with GraspClient.open("viewing", domain_id=DOMAIN, timeout=60.0) as made:
        yield made


@pytest.fixture(scope="module")
def synthesizer() -> GraspSynthesizer:
    return GraspSynthesizer.load(gripper="robotiq_2f85", threads=1)


@pytest.fixture
def page() -> Iterator[Any]:
    server = open_server(port=0)
    yield server
    server.stop()


@pytest.fixture
def alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands that find no server, and do not look for long."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setattr(view_module, "DISCOVERY", 0.2)


def by_default(client: GraspClient, monkeypatch: pytest.MonkeyPatch, **changes: Any):
    """Settings where no server runs."""
    monkeypatch.setattr(view_module, "DISCOVERY", 0.2)
    settings, gripper = as_the_server(client, "grasp_server", "")
    assert gripper == "robotiq_2f85"
    return replace(settings, **{**AT_REST, **changes})


def viewer_of(page, live: LiveCloud, synthesizer: GraspSynthesizer, **options) -> SceneViewer:
    def load(gripper) -> GraspSynthesizer:
        synthesizer.set_gripper(gripper)
        return synthesizer

    return live_viewer(page, live, "robotiq_2f85", load, mode="fast", seed=1, **options)


def test_it_is_as_the_server_is_set(server: Client, capsys) -> None:
    numbers = [0.0, 0.0, 0.8, 1.0, 0.0, 0.0, 0.0]
    assert not server.parameters(
        planning_frame="base", extrinsics=numbers, gravity=[0.0, 0.0, -2.0],
        region__size=[0.5, 0.4, 0.3],
    )  # fmt: skip
    assert server.set_gripper("franka_hand").success
    points = table_points()
    with (
        GraspClient.open("viewing", domain_id=own_domain(1), timeout=60.0) as client,
        camera(server, seen_from_above(points), frame="cam_optical_frame"),
    ):
        settings, gripper = as_the_server(client, "grasp_server", "")
        assert gripper == "franka_hand"
        live = LiveCloud(client, replace(settings, **AT_REST))
        cloud = live.read()
        elsewhere, _ = as_the_server(client, "grasp_server", "shelf")
    assert "as /grasp_server is set" in capsys.readouterr().out
    assert (live.name, live.header.frame_id) == ("/points", "base")
    np.testing.assert_allclose(cloud.points, points, atol=1e-6)
    np.testing.assert_allclose(cloud.viewpoint, [0.0, 0.0, 0.8], atol=1e-9)
    np.testing.assert_allclose(live.gravity, [0.0, 0.0, -1.0])
    assert live.settings.region is not None
    np.testing.assert_allclose(live.settings.region.size, [0.5, 0.4, 0.3])
    assert elsewhere.planning_frame == "shelf"
    assert elsewhere.region is elsewhere.gravity is elsewhere.extrinsics is None


class StubBuffer:
    """tf2 that knows where the camera is."""

    def lookup_transform(self, target, source, time, timeout):
        if (target, source) != ("base", "cam_optical_frame"):
            raise LookupError(f"{source} does not exist")
        found = TransformStamped()
        found.transform.translation.z = 0.8
        found.transform.rotation.x, found.transform.rotation.w = 1.0, 0.0
        return found


@pytest.mark.slow
def test_the_page_shows_the_topic_and_synthesizes(
    cell: FakeCell, client: GraspClient, synthesizer, page, monkeypatch
) -> None:
    monkeypatch.setattr(frames, "tf2_buffer", lambda node: StubBuffer())
    settings = by_default(client, monkeypatch, planning_frame="base")
    points = table_points()
    with cell.publishing(seen_from_above(points), "cam_optical_frame"):
        live = LiveCloud(client, settings, "/points")
        viewer = viewer_of(page, live, synthesizer, num_grasps=8)
        np.testing.assert_allclose(drawn(viewer), np.sort(points, axis=0), atol=1e-5)
        assert viewer.frame == "base"
        np.testing.assert_allclose(viewer.cloud.viewpoint, [0.0, 0.0, 0.8], atol=1e-9)
        found = viewer.synthesize()
        assert found is not None and found.grasps, viewer.status.content
        at = found.grasps[0].world_from_tcp[:3, 3]
        assert np.abs(at - [0.05, 0.0, 0.04]).max() < 0.05, "at the block"


@pytest.mark.slow
def test_grasps_are_executed_by_the_cell(
    cell: FakeCell, client: GraspClient, synthesizer, page, monkeypatch
) -> None:
    settings = by_default(client, monkeypatch, sensor_origin=np.array([0.0, 0.0, 0.8]))
    with cell.publishing(table_points()):
        live = LiveCloud(client, settings)
        assert until(lambda: live.executes)
        viewer = viewer_of(page, live, synthesizer, num_grasps=8)
        assert viewer.do.visible
        assert viewer.synthesize() and viewer.grasp is not None, viewer.status.content
        grasp, stamp = viewer.grasp, live.header.stamp

        cell.mounts = False
        viewer._guarded(viewer._carry_out)
        assert "not executed: robotiq_2f85 is not on: it is stuck" in viewer.status.content
        cell.mounts = True
        cell.answer = {"error_code": ErrorCode.STALE_CLOUD, "error_msg": "it is too old"}
        viewer._guarded(viewer._carry_out)
        assert "not executed: error 101: it is too old" in viewer.status.content
        assert viewer.grasp is grasp, "it is still there to be looked at"

        cell.answer = {"success": True, "removed": ["block"], "objects_left": 2}
        viewer._guarded(viewer._carry_out)
        assert viewer.status.content == "**it holds: took block; 2 objects left**"
        assert cell.tools[-1] == "robotiq_2f85"
        goal = cell.goals[-1]
        assert (goal.gripper, goal.header.frame_id) == ("robotiq_2f85", "world")
        assert goal.header.stamp == stamp
        pose = matrix_from_pose(goal.grasp.pregrasp, "pregrasp")
        np.testing.assert_allclose(pose, grasp.world_from_gripper, atol=1e-9)
        assert goal.grasp.pregrasp_posture.name
        after, before = live.header.stamp, live._not_before
        assert (after.sec, after.nanosec) > (before.sec, before.nanosec), "a cloud of afterwards"
        assert viewer.lists is None

        viewer.synthesize()
        cell.answer = {"error_msg": "it slipped", "objects_left": 2}
        viewer._guarded(viewer._carry_out)
        assert viewer.status.content == "**it fails: it slipped; 2 objects left**"


@pytest.mark.slow
def test_new_clouds_are_followed_while_nothing_else_is_shown(
    cell: FakeCell, client: GraspClient, synthesizer, page, monkeypatch
) -> None:
    settings = by_default(client, monkeypatch, sensor_origin=np.array([0.0, 0.0, 0.8]))
    live = LiveCloud(client, settings)
    first, second = table_points(), table_points(3000)
    with cell.publishing(first):
        viewer = viewer_of(page, live, synthesizer, num_grasps=4)
        live.follow()
        assert until(lambda: live.changed)
        viewer.follow()
        assert len(drawn(viewer)) == len(first)
    with cell.publishing(second):
        assert until(lambda: viewer.follow() or len(drawn(viewer)) == len(second))
        assert viewer.synthesize() is not None, viewer.status.content
        told = viewer.status.content
    with cell.publishing(first):
        assert until(lambda: live.changed)
        viewer.follow()
        assert (len(drawn(viewer)), viewer.status.content) == (len(second), told), "grasps stay"
        assert until(lambda: viewer.refresh() or len(drawn(viewer)) == len(first))
        assert viewer.lists is None
    # The camera has stopped.
    live.settings = replace(settings, cloud_timeout=0.5)
    assert until(lambda: live._source.silence > 0.5)
    viewer.refresh()
    assert "no cloud arrived on /points within 0.5 s" in viewer.status.content
    viewer.follow()
    assert "no cloud arrived" in viewer.status.content


def told(capsys, *options: str) -> tuple[int, str]:
    """Exit code and message of the command."""
    code = run(["view", "--port", "0", *options])
    return code, " ".join(capsys.readouterr().err.split())


def test_what_is_wrong_is_a_sentence(alone, cell: FakeCell, capsys, monkeypatch) -> None:
    with cell.publishing(table_points(), "cam_optical_frame"):
        assert until(lambda: cell.node.count_publishers("/points") == 1)
        # On a busy machine it takes longer until the others are seen.
        for seconds in ("1", "20"):
            code, text = told(capsys, "--topic", "/nobody", "--timeout", seconds)
            if "of that type: none" not in text:
                break
        assert code == 1 and f"no cloud arrived on /nobody within {seconds} s" in text
        assert "Other topics of that type: /points; --topic names one" in text
        code, text = told(capsys, "--timeout", "30")
        assert code == 2 and "gravity is not known" in text and "--gravity X Y Z" in text
        monkeypatch.setattr(frames, "tf2_buffer", lambda node: StubBuffer())
        code, text = told(capsys, "--frame", "table", "--timeout", "30")
        assert code == 2 and "no transform from 'cam_optical_frame'" in text
        assert "'table'" in text and "--frame names the frame" in text
    code, text = told(capsys, "--topic", "a b")
    assert code == 2 and "topic 'a b' was given" in text
    code, text = told(capsys, "--gripper", "vacuum")
    assert code == 2 and "unknown gripper 'vacuum'" in text
    code, text = told(capsys, "--floor", "1", "2")
    assert code == 2 and "expected a height" in text
    monkeypatch.setitem(sys.modules, "viser", None)
    code, text = told(capsys)
    assert code == 2 and "pip install 'megrasp-core[view]'" in text


def test_the_frame_must_not_change(cell: FakeCell, client, monkeypatch) -> None:
    live = LiveCloud(client, by_default(client, monkeypatch))
    with cell.publishing(table_points()):
        live.read()
    with (
        cell.publishing(table_points(), "elsewhere"),
        pytest.raises(CloudError, match="in 'elsewhere' now; expected 'world'"),
    ):
        live.read()


def test_closing_ends_a_wait(client: GraspClient, monkeypatch) -> None:
    live = LiveCloud(client, by_default(client, monkeypatch, cloud_timeout=600.0), "/silent")
    errors: list[Exception] = []

    def wait() -> None:
        try:
            live.read()
        except MegraspError as error:
            errors.append(error)

    waiting = threading.Thread(target=wait, daemon=True)
    waiting.start()
    assert until(lambda: client.node.count_subscribers("/silent") > 0)
    live.close()
    waiting.join(60.0)
    assert isinstance(errors[0], CancelledError)
    assert until(lambda: client.node.count_subscribers("/silent") == 0)


@pytest.mark.slow
@pytest.mark.skipif(chromium() is None, reason="no chromium: apt-get install chromium")
def test_the_executable_beside_sim_cell(tmp_path: Path) -> None:
    """In a browser: the cell's cloud, grasps, one of them executed; Ctrl-C."""
    program = Path(get_package_prefix("megrasp_ros")) / "lib" / "megrasp_ros" / "megrasp_call"
    options = ("--port", "0", "--sensor", "0", "0", "0.8", "--fast", "--threads", "1", "--follow")
    with processes(own_domain(7), tmp_path) as running:
        running.start("sim_cell", num_objects=2)
        assert until(lambda: "ready:" in running.log("sim_cell")), running.logs()
        command = [str(program), "view", *options, "--timeout", "120"]
        shown = running.start_command("view", command)
        address = partial(re.search, r"open (http://\S+)")
        assert until(lambda: bool(address(running.log("view"))) or shown.poll() is not None)
        found = address(running.log("view"))
        assert found, running.logs()
        with opened(found[1]) as page:
            assert eventually(lambda: page.press("Synthesize")), page.text()
            assert eventually(lambda: "grasps for robotiq_2f85" in page.text()), page.text()
            assert page.press("Execute it")
            assert eventually(lambda: "objects left" in page.text()), page.text()
        assert "removed" in running.log("sim_cell")
        assert running.stop("view", signal.SIGINT) == 0
        assert "Traceback" not in running.log("view")


def test_ctrl_c_while_it_waits_for_a_cloud(alone, client: GraspClient) -> None:
    program = Path(get_package_prefix("megrasp_ros")) / "lib" / "megrasp_ros" / "megrasp_call"
    running = subprocess.Popen(
        [program, "view", "--port", "0", "--topic", "/silent", "--timeout", "600"],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=os.environ,
        preexec_fn=default_signals,
    )  # fmt: skip
    assert until(lambda: client.node.count_subscribers("/silent") > 0)
    running.send_signal(signal.SIGINT)
    output = running.communicate(timeout=120)[0]
    assert running.returncode in (0, 130) and "Traceback" not in output, output
