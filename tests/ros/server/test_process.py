"""grasp_server from its start to its end: the installed executable with a network, lifecycle,
signals.
"""

from __future__ import annotations

import dataclasses
import signal
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from cell_processes import WAIT, in_executor, own_domain, processes, result, until
from geometry_msgs.msg import PoseArray
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from megrasp_msgs.msg import ErrorCode, GraspArray, GripperInfo, OrientedBox
from megrasp_msgs.srv import SynthesizeGrasps
from server_client import (
    START,
    Client,
    Latest,
    running_server,
    stamped_cloud,
    table_points,
)

from megrasp_core.grippers import load_gripper
from megrasp_core.network import GraspModel, ModelConfig, save_model
from megrasp_ros.conversions import matrix_from_pose

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def model_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an untrained model, small enough for any machine."""
    torch.manual_seed(0)
    config = ModelConfig(
        fine_irreps="8x0e+4x1o+2x2e",
        coarse_irreps="8x0e+4x1o+2x2e",
        token_irreps="8x0e+4x1o+2x2e",
        blocks=(1, 1, 1),
        width=32,
        heads=2,
        decoder_blocks=1,
        scene_tokens=(16, 8, 8),
    )
    folder = tmp_path_factory.mktemp("models") / "untrained"
    trained = {"robotiq_2f85": load_gripper("robotiq_2f85").hash}
    model = GraspModel(config)
    model.info = dataclasses.replace(model.info, trained_grippers=trained)
    save_model(model, folder)
    return folder


def test_a_network_answers_and_damaged_weights_are_error_300(
    model_folder: Path, tmp_path: Path
) -> None:
    damaged = tmp_path / "damaged"
    damaged.mkdir()
    for file in model_folder.iterdir():
        data = file.read_bytes()
        (damaged / file.name).write_bytes(
            data[: len(data) // 2] if file.suffix == ".safetensors" else data
        )
    start = {
        "model": str(damaged),
        "device": "cpu",
        "threads": 1,
        "sensor_origin": [0.0, 0.0, 0.85],
    }
    with running_server(2, tmp_path, double=False, **start) as (client, running):
        request = {
            "num_grasps": 10,
            "cloud": stamped_cloud(client.node, table_points()),
            "seed": 3,
        }
        # Configuring fails, so that a manager sees it, and requests are told why.
        assert until(lambda: client.synthesize(**request).error_code == ErrorCode.MODEL_NOT_LOADED)
        refused = client.synthesize(**request)
        assert "configuring it failed" in refused.error_msg and "damaged" in refused.error_msg
        get = client.node.create_client(GetState, "grasp_server/get_state")
        state = result(in_executor(client.node, lambda: get.call_async(GetState.Request())))
        assert state.current_state.id == State.PRIMARY_STATE_UNCONFIGURED
        (reason,) = client.parameters(model="no_such_model")
        assert "no_such_model" in reason and "not found" in reason

        # A parameter that mends it starts the node that starts by itself.
        assert not client.parameters(model=str(model_folder))
        assert until(lambda: client.set_gripper("robotiq_3f").success)
        check_real_answers(client, request)
        # A second signal while it puts things in order; the other test sends SIGINT at work.
        process = running.running["grasp_server"]
        process.send_signal(signal.SIGINT)
        time.sleep(0.1)
        assert running.stop("grasp_server", signal.SIGINT) == 0
        assert "Traceback" not in running.log("grasp_server")


def check_real_answers(client: Client, request: dict) -> None:
    """Check what an untrained network answers: grasps or none are both right, but all has to fit
    together.
    """
    found_or_not = (ErrorCode.NONE, ErrorCode.NO_GRASP_FOUND)
    for name in ("robotiq_3f", "robotiq_2f85"):
        info = client.set_gripper(name).gripper
        assert info.seen_in_training == (name == "robotiq_2f85")
        first, again = client.synthesize(**request), client.synthesize(**request)
        assert first.error_code in found_or_not, first.error_msg
        assert first.grasps.grasps == again.grasps.grasps
        assert (first.grasps.model_id, first.grasps.gripper, first.grasps.seed) == (
            "untrained",
            name,
            3,
        )
        assert sum(each.count for each in first.rejected) + len(first.grasps.grasps) == 100
        assert first.timing.sample > 0
        for grasp in first.grasps.grasps:
            pregrasp, tcp = matrix_from_pose(grasp.pregrasp, "p"), matrix_from_pose(grasp.tcp, "t")
            np.testing.assert_allclose(
                pregrasp @ load_gripper(name).gripper_from_tcp, tcp, atol=1e-6
            )
    far = OrientedBox()
    far.pose.position.x = 5.0
    far.size.x = far.size.y = far.size.z = 0.1
    nothing = client.synthesize(**request, region=far)
    assert nothing.error_code == ErrorCode.EMPTY_REGION, nothing.error_msg
    camera_axes = table_points() * (1, -1, -1) + np.array([0.0, 0.0, 0.85])
    assert not client.parameters(sensor_origin=[0.0] * 3)
    cloud = stamped_cloud(client.node, camera_axes, "scanner_sensor")
    turned = client.synthesize(num_grasps=3, cloud=cloud)
    assert turned.error_code == ErrorCode.TRANSFORM_OR_GRAVITY_MISSING, turned.error_msg
    assert "seems to be a camera's" in turned.error_msg
    assert not client.parameters(gravity=[0.0, 0.0, 1.0])
    assert client.synthesize(num_grasps=3, cloud=cloud).error_code in found_or_not
    assert not client.parameters(gravity=[0.0] * 3, sensor_origin=[0.0, 0.0, 0.85])
    handle = client.goal(**request)
    finished = client.outcome(handle)
    client.cancel(handle)
    assert result(finished).result.error_code in (ErrorCode.CANCELLED, *found_or_not)


def segments(maps: str) -> set[str]:
    """Return the files of Fast DDS in shared memory that a process (its /proc/PID/maps) uses."""
    return {line.split()[5] for line in maps.splitlines() if "/dev/shm/fastrtps_" in line}


def test_a_wrong_parameter_ends_the_node_with_code_2(tmp_path: Path) -> None:
    with processes(own_domain(3), tmp_path) as running:
        process = running.start("grasp_server", gravity=[1.0, 2.0])
        assert process.wait(START) == 2
        log = running.log("grasp_server")
        assert "gravity" in log
        assert "expected 3 finite numbers" in log
        assert "Traceback" not in log


def test_a_lifecycle_manager_can_own_the_node_and_sigint_ends_it_at_work(tmp_path: Path) -> None:
    with running_server(4, tmp_path, autostart=False, model="slow", device="cpu") as (
        client,
        running,
    ):
        change = client.node.create_client(ChangeState, "grasp_server/change_state")
        get = client.node.create_client(GetState, "grasp_server/get_state")
        assert change.wait_for_service(timeout_sec=WAIT)
        assert get.wait_for_service(timeout_sec=WAIT)
        cloud = stamped_cloud(client.node, table_points())

        def go(transition: int) -> int:
            request = ChangeState.Request(transition=Transition(id=transition))
            assert result(in_executor(client.node, lambda: change.call_async(request))).success
            state = result(in_executor(client.node, lambda: get.call_async(GetState.Request())))
            return state.current_state.id

        def answer() -> int:
            return client.synthesize(num_grasps=1, cloud=cloud, timeout=0.3).error_code

        assert answer() == ErrorCode.NOT_ACTIVE
        refused = client.set_gripper("robotiq_3f")
        assert refused.error_code == ErrorCode.NOT_ACTIVE
        assert "ros2 lifecycle set /grasp_server configure" in refused.error_msg
        assert go(Transition.TRANSITION_CONFIGURE) == State.PRIMARY_STATE_INACTIVE
        assert answer() == ErrorCode.NOT_ACTIVE
        assert go(Transition.TRANSITION_ACTIVATE) == State.PRIMARY_STATE_ACTIVE
        assert answer() == ErrorCode.TIMEOUT
        working = client.start(SynthesizeGrasps.Request(num_grasps=1, cloud=cloud))
        assert go(Transition.TRANSITION_DEACTIVATE) == State.PRIMARY_STATE_INACTIVE
        assert result(working).error_code in (ErrorCode.CANCELLED, ErrorCode.NOT_ACTIVE)
        assert answer() == ErrorCode.NOT_ACTIVE
        assert go(Transition.TRANSITION_CLEANUP) == State.PRIMARY_STATE_UNCONFIGURED
        assert go(Transition.TRANSITION_CONFIGURE) == State.PRIMARY_STATE_INACTIVE
        assert go(Transition.TRANSITION_ACTIVATE) == State.PRIMARY_STATE_ACTIVE
        assert answer() == ErrorCode.TIMEOUT

        # What is impossible is answered, and changes nothing.
        for number in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE, 99, 255):
            request = ChangeState.Request(transition=Transition(id=number))
            answered = result(in_executor(client.node, lambda r=request: change.call_async(r)))
            assert not answered.success
        assert answer() == ErrorCode.TIMEOUT
        # Poses that were computed before it was off are taken back.
        assert not client.parameters(model="quick")
        assert client.synthesize(num_grasps=1, cloud=cloud).success
        poses, grasps = (
            Latest(client, PoseArray, "pregrasps"),
            Latest(client, GraspArray, "grasps"),
        )
        assert until(lambda: bool(poses.messages and grasps.messages))
        assert poses.last.poses and grasps.last.grasps
        assert go(Transition.TRANSITION_DEACTIVATE) == State.PRIMARY_STATE_INACTIVE
        assert until(lambda: not poses.last.poses and not grasps.last.grasps)
        assert go(Transition.TRANSITION_CLEANUP) == State.PRIMARY_STATE_UNCONFIGURED
        assert not client.parameters(gripper="robotiq_3f", model="slow")
        assert go(Transition.TRANSITION_CONFIGURE) == State.PRIMARY_STATE_INACTIVE
        assert go(Transition.TRANSITION_ACTIVATE) == State.PRIMARY_STATE_ACTIVE
        late, active = (
            Latest(client, GraspArray, "grasps"),
            Latest(client, GripperInfo, "active_gripper"),
        )
        assert until(lambda: bool(late.messages and active.messages))
        assert (late.last.grasps, active.last.name) == ([], "robotiq_3f")

        working = client.goal(num_grasps=1, cloud=cloud, timeout=60.0)
        outcome = client.outcome(working)
        maps = Path(f"/proc/{running.running['grasp_server'].pid}/maps").read_text()
        assert running.stop("grasp_server", signal.SIGINT) == 0
        # It did not sit the job out, which takes all its steps: the client was told.
        stopped = result(outcome, 30.0).result
        assert stopped.error_code in (ErrorCode.CANCELLED, ErrorCode.NOT_ACTIVE)
        # Shared memory of Fast DDS must not outlive the node; what is left is the client's own. A
        # port that both used goes when the client, too, has let go of it.
        assert segments(maps)

        def left() -> list[str]:
            mine = segments(Path("/proc/self/maps").read_text())
            return [file for file in segments(maps) - mine if Path(file).exists()]

        assert until(lambda: not left()), left()
        assert "Traceback" not in running.log("grasp_server")
