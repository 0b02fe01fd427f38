"""The commands of megrasp_call, against a running server."""

from __future__ import annotations

import json
import os
import subprocess
import threading
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix
from cell_processes import own_domain, until
from server_client import Client, camera, table_points

from megrasp_core.pointcloud import Cloud, write_cloud
from megrasp_ros.call.app import run


@pytest.fixture(autouse=True)
def domain(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", str(own_domain(1)))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


def test_synthesize_a_stored_cloud(server: Client, tmp_path: Path, capsys) -> None:
    write_cloud(tmp_path / "cloud.ply", Cloud(table_points()))
    (tmp_path / "bin.yaml").write_text("pose: [0, 0, 0.1, 0, 0, 0, 1]\nsize: [0.5, 0.4, 0.3]\n")
    out = tmp_path / "grasps.json"
    code = run(
        ["synthesize", "-n", "3", "--cloud", str(tmp_path / "cloud.ply"), "--seed", "7",
         "--region", str(tmp_path / "bin.yaml"), "--out", str(out)]
    )  # fmt: skip
    assert code == 0
    told = capsys.readouterr().out
    assert "3 grasps of robotiq_2f85 in 'world'" in told and "seed 7" in told
    content = json.loads(out.read_text())
    assert (content["frame"], content["gripper"], content["seed"]) == ("world", "robotiq_2f85", 7)
    assert len(content["grasps"]) == 3
    best = content["grasps"][0]
    assert best["score"] == pytest.approx(0.9) and best["object"] is None
    assert len(best["world_from_tcp"]) == len(best["world_from_gripper_retreat"]) == 7
    assert content["rejected"] and content["timing"]["total"] > 0


def test_synthesize_what_the_camera_sees(server: Client, capsys) -> None:
    assert not server.parameters(cloud_timeout=30.0)
    try:
        with camera(server, table_points()):
            assert run(["synthesize", "-n", "2", "--gripper", "franka_hand"]) == 0
    finally:
        assert not server.parameters(cloud_timeout=0.7)
    assert "2 grasps of franka_hand" in capsys.readouterr().out


def test_exit_codes(server: Client, tmp_path: Path, capsys) -> None:
    assert run(["synthesize"]) == 1, "no camera"
    assert "error 100" in capsys.readouterr().err
    assert run(["synthesize", "-n", "0"]) == 2
    assert run(["synthesize", "--cloud", str(tmp_path / "gone.ply")]) == 2
    assert run(["synthesize", "--region", str(tmp_path / "gone.yaml")]) == 2
    assert run(["set_gripper", "vacuum"]) == 2
    assert "unknown gripper 'vacuum'" in capsys.readouterr().err
    assert run(["list", "--namespace", "/nowhere", "--timeout", "0.3"]) == 1
    assert "nowhere/list_grippers is not there" in capsys.readouterr().err
    assert run(["fly"]) == 2
    assert run(["list", "--colour"]) == 2


def test_set_gripper_and_list(server: Client, tmp_path: Path, capsys) -> None:
    assert run(["set_gripper", "franka_hand", "--dry-run"]) == 0
    assert "could be active: franka_hand" in capsys.readouterr().out
    assert run(["set_gripper", "franka_hand", "--out", str(tmp_path / "one.json")]) == 0
    assert json.loads((tmp_path / "one.json").read_text())["name"] == "franka_hand"
    assert run(["list", "--out", str(tmp_path / "all.json")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert next(line for line in lines if line.startswith("* ")).split()[1] == "franka_hand"
    content = json.loads((tmp_path / "all.json").read_text())
    assert content["active"] == "franka_hand"
    hand = next(each for each in content["grippers"] if each["name"] == "allegro_hand")
    assert hand["max_width"] is None, "NaN is no JSON"


def test_watch(server: Client, tmp_path: Path, capsys) -> None:
    codes: list[int] = []
    arguments = ["watch", "--count", "2", "--seconds", "60", "--out", str(tmp_path / "w.json")]
    thread = threading.Thread(target=lambda: codes.append(run(arguments)))
    thread.start()
    thread.join(120)
    assert codes == [0]
    heard = json.loads((tmp_path / "w.json").read_text())
    assert {each["topic"] for each in heard} == {"grasps", "active_gripper"}
    assert "active_gripper: robotiq_2f85" in capsys.readouterr().out
    assert run(["watch", "--seconds", "0.3", "--namespace", "/nowhere"]) == 1


def test_the_executable(server: Client) -> None:
    """As it is installed; help with examples, and Ctrl-C ends a synthesis at the server, too."""
    program = Path(get_package_prefix("megrasp_ros")) / "lib" / "megrasp_ros" / "megrasp_call"
    told = subprocess.run([program, "--help"], capture_output=True, text=True, env=os.environ)
    assert told.returncode == 0
    for name in (
        "synthesize",
        "set_gripper",
        "change_tool",
        "list",
        "watch",
        "doctor",
        "view",
        "Exit codes",
    ):
        assert name in told.stdout.replace("-", "_") + told.stdout
    assert not server.parameters(cloud_timeout=600.0)
    try:
        running = subprocess.Popen(
            [program, "synthesize", "--timeout", "600"],
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ,
        )
        asks = lambda: server.node.count_subscribers("/points") > 0  # noqa: E731
        assert until(asks), "the server waits for a cloud"
        running.send_signal(2)
        assert running.communicate(timeout=120)[0].strip().endswith("cancelled")
        assert running.returncode == 1
        assert until(lambda: not asks()), "the server has given up, too"
    finally:
        assert not server.parameters(cloud_timeout=0.7)
