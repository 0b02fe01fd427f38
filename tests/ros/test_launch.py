"""Launch files: their arguments, what reaches the node, and launch itself where it is there."""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
from pathlib import Path

import psutil
import pytest
import yaml
from ament_index_python.packages import get_package_share_directory
from cell_processes import WAIT, default_signals, own_domain, until
from rcl_interfaces.srv import GetParameters
from server_client import DOUBLE

from megrasp_ros.launching import ARGUMENTS, parameters_given, replaced
from megrasp_ros.server.parameter_table import TABLE
from megrasp_ros.trials.server_process import server_process

SHARE = Path(get_package_share_directory("megrasp_bringup"))
PARAMS = SHARE / "config" / "grasp_server.yaml"


def test_arguments_are_parameters() -> None:
    assert set(ARGUMENTS) <= {*TABLE, "use_sim_time"}
    for file in (SHARE / "launch").glob("*.launch.py"):
        compile(file.read_text(), str(file), "exec")


def test_what_is_not_given_is_left_out() -> None:
    given = {name: "" for name in ARGUMENTS}
    assert parameters_given(given) == {}
    given |= {"floor": "0.1", "gravity": "[0, 0, 1]", "autostart": "false", "gripper": "hook"}
    assert parameters_given(given) == {
        "floor": [0.1],
        "gravity": [0.0, 0.0, 1.0],
        "autostart": False,
        "gripper": "hook",
    }


@pytest.mark.parametrize(
    ("name", "text"),
    [("gravity", "down"), ("gravity", "[a, b]"), ("floor", "true"), ("autostart", "maybe")],
)
def test_an_argument_of_another_kind_is_refused(name: str, text: str) -> None:
    with pytest.raises(ValueError, match=rf"{name}:='{text}'".replace("[", r"\[")):
        parameters_given({name: text})


def test_what_an_argument_replaces_is_told(tmp_path: Path) -> None:
    (line,) = replaced({"gripper": "franka_hand", "model": "x"}, str(PARAMS))
    assert line == "launch argument gripper: franka_hand replaces robotiq_2f85 of " + PARAMS.name
    assert not replaced({"gripper": "robotiq_2f85"}, str(PARAMS))
    other = tmp_path / "cell.yaml"
    other.write_text("/**/sim_cell: {ros__parameters: {gripper: a}}\n")
    assert not replaced({"gripper": "b"}, str(other))


def test_arguments_go_over_the_file_and_leave_the_rest(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """With a node as launch starts it: the file first, then the arguments by the node's name."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(own_domain(3)))
    values = parameters_given({"gripper": "franka_hand", "region.size": "[0.3, 0.2, 0.1]"})
    file = tmp_path / "arguments.yaml"
    file.write_text(yaml.safe_dump({"/left/grasp_server": {"ros__parameters": values}}))
    command = [sys.executable, str(DOUBLE), "--ros-args", "--params-file", str(PARAMS)]
    command += ["--params-file", str(file)]
    with server_process({"autostart": False}, command=command, namespace="/left") as server:
        names = ["gripper", "region.size", "region.pose", "request_timeout"]
        answer = server.call(GetParameters.Request(names=names))
    gripper, size, pose, timeout = answer.values
    assert gripper.string_value == "franka_hand"
    assert list(size.double_array_value) == [0.3, 0.2, 0.1]
    shipped = yaml.safe_load(PARAMS.read_text())["/**"]["ros__parameters"]
    assert list(pose.double_array_value) == shipped["region.pose"]
    assert timeout.double_value == shipped["request_timeout"]


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("launch_ros") is None, reason="launch_ros is missing")
def test_a_launched_server_that_is_killed_comes_back(tmp_path: Path) -> None:
    code = f"""
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
service = LaunchService()
arguments = [("namespace", "left"), ("gripper", "franka_hand"), ("autostart", "false")]
file = {str(SHARE / "launch" / "grasp_server.launch.py")!r}
include = IncludeLaunchDescription(file, launch_arguments=arguments)
service.include_launch_description(LaunchDescription([include]))
sys.exit(service.run())
"""
    environment = os.environ | {
        "ROS_DOMAIN_ID": str(own_domain(4)), "ROS_LOG_DIR": str(tmp_path),
    }  # fmt: skip
    log = tmp_path / "launch.log"
    with log.open("wb") as output:
        launched = subprocess.Popen(
            [sys.executable, "-c", code], env=environment, stdout=output,
            stderr=subprocess.STDOUT, preexec_fn=default_signals,
        )  # fmt: skip

    def server() -> list[int]:
        children = psutil.Process(launched.pid).children()
        return [each.pid for each in children if "grasp_server" in " ".join(each.cmdline())]

    try:
        assert until(lambda: bool(server()), WAIT)
        (first,) = server()
        os.kill(first, signal.SIGKILL)
        assert until(lambda: bool(server()) and server() != [first], WAIT), log.read_text()
    finally:
        launched.send_signal(signal.SIGINT)
        launched.wait(WAIT)
    assert "launch argument gripper: franka_hand replaces robotiq_2f85" in log.read_text()
