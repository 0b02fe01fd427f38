"""What `compare.py` runs in each of the two trees: fixed work through the public interfaces, with
its results as files below --out. Needs nothing of the tests, so that it runs in a tree of any age.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

GRIPPERS = ("robotiq_2f85", "robotiq_3f", "allegro_hand")
MODES = ("fast", "default")


def scene_cloud(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Points (M, 3) (m) and the camera's place (3,): heights of boxes, cylinders and balls, seen
    from above on a grid of 4 mm; `bin`: inside 40 x 30 cm walls, `camera`: in the optical frame.
    """
    rng = np.random.default_rng(7)
    x, y = np.meshgrid(np.arange(-0.26, 0.26, 0.004), np.arange(-0.2, 0.2, 0.004))
    z = np.zeros_like(x)
    for index in range(7):
        centre = rng.uniform((-0.14, -0.09), (0.14, 0.09))
        size, height = rng.uniform(0.015, 0.035), rng.uniform(0.03, 0.08)
        turn = rng.uniform(0.0, np.pi)
        along = (x - centre[0]) * np.cos(turn) + (y - centre[1]) * np.sin(turn)
        across = -(x - centre[0]) * np.sin(turn) + (y - centre[1]) * np.cos(turn)
        distance = np.hypot(along, across)
        if index % 3 == 0:
            top = np.where((abs(along) < 1.5 * size) & (abs(across) < size), height, 0.0)
        elif index % 3 == 1:
            top = np.where(distance < size, height, 0.0)
        else:
            top = np.where(
                distance < size, size + np.sqrt(np.maximum(size**2 - distance**2, 0)), 0
            )
        z = np.maximum(z, top)
    if kind == "bin":
        wall = (abs(x) > 0.2) | (abs(y) > 0.15)
        z = np.where(wall & (abs(x) < 0.21) & (abs(y) < 0.16), 0.15, z)
    points = np.stack([x, y, z], -1).reshape(-1, 3)
    points = points + rng.normal(0.0, 0.0003, points.shape)
    sensor = np.array([0.0, 0.0, 0.9])
    if kind == "camera":
        flip = np.diag([1.0, -1.0, -1.0])
        return (points - sensor) @ flip, np.zeros(3)
    return points, sensor


def synthesize(out: Path) -> None:
    """Three clouds, three grippers, both modes."""
    from megrasp_core.pointcloud import Cloud, OrientedBox
    from megrasp_core.synthesizer import GraspSynthesizer

    synthesizer = GraspSynthesizer.load()
    answers = {}
    for name in GRIPPERS:
        synthesizer.set_gripper(name)
        for kind in ("table", "bin", "camera"):
            points, sensor = scene_cloud(kind)
            region = None
            if kind == "bin":
                pose = np.eye(4)
                pose[2, 3] = 0.075
                region = OrientedBox(pose, np.array([0.4, 0.3, 0.15]))
            for mode in MODES:
                answer = synthesizer.synthesize(
                    Cloud(points),
                    num_grasps=10,
                    drawn=40 if mode == "default" else 10,
                    mode=mode,
                    gravity=(0.0, 0.0, 1.0 if kind == "camera" else -1.0),
                    sensor=sensor,
                    region=region,
                    seed=5,
                    keep_all=True,
                )
                answers[f"{name} {kind} {mode}"] = {
                    "rejected": answer.rejected,
                    "grasps": [_fields(grasp) for grasp in answer.grasps],
                }
    (out / "synthesize.json").write_text(json.dumps(answers))


def _fields(grasp: object) -> dict[str, object]:
    values = {f.name: getattr(grasp, f.name) for f in dataclasses.fields(grasp)}  # type: ignore[arg-type]
    return {
        name: value.tolist() if isinstance(value, np.ndarray) else value
        for name, value in values.items()
        if isinstance(value, (np.ndarray, float, int, bool, str))
    }


def _megrasp(*arguments: object) -> None:
    from megrasp_core.cli import main

    code = main([str(argument) for argument in arguments])
    if code:
        raise SystemExit(f"megrasp {' '.join(map(str, arguments))} ended with {code}")


def evaluate(out: Path) -> None:
    """Two bins."""
    _megrasp(
        "eval", "--gripper", "robotiq_2f85", "--scenes", 2, "--samples", 4, "--drawn", 20,
        "--returned", 5, "--seed", 3, "--out", out / "eval.json",
    )  # fmt: skip


def scenes(out: Path) -> None:
    """A table and a bin with their labels, and a table of objects for validation."""
    for name, seed, options in (
        ("table", 40, ("--bins", 0)),
        ("bin", 41, ("--bins", 1)),
        ("validation", 42, ("--bins", 0, "--validation")),
    ):
        _megrasp(
            "data", "scenes", "--out", out / f"scenes_{name}", "--library",
            Path("models") / "grasp_library", "-n", 1, "--gripper", "robotiq_2f85", "robotiq_3f",
            "--trials", 6, "--moved", 2, "--no-assets", "--procedural", 20, "--seed", seed,
            *options,
        )  # fmt: skip


def train(out: Path) -> None:
    """A few steps on the scenes."""
    if not (out / "scenes_validation").is_dir():
        scenes(out)
    _megrasp(
        "train", "--data", out / "scenes_table", out / "scenes_bin", "--validation",
        out / "scenes_validation", "--out", out / "run", "--preset", "tiny", "--total-poses", 128,
        "--seed", 2, "--gripper", "robotiq_2f85", "robotiq_3f", "--set", "poses_per_scene=16",
        "scenes_per_step=2",
    )  # fmt: skip


def wizard(out: Path) -> None:
    """Descriptions of two models."""
    for name in ("rethink_gripper", "robotiq_3f"):
        model = next(
            path
            for path in sorted((Path("gripper_descriptions") / name).iterdir())
            if path.suffix in (".xml", ".urdf")
        )
        _megrasp("gripper", "new", model, "--out", out / "wizard" / name, "--yes")


def ros(out: Path) -> None:
    """One answer of a grasp_server process of this tree."""
    import rclpy
    from megrasp_msgs.srv import SynthesizeGrasps

    os.environ["ROS_DOMAIN_ID"] = str(20 + os.getpid() % 180)
    entry = _console_script("grasp_server")
    module, function = entry.split(":")
    code = f"from {module} import {function}; {function}()"
    command = [sys.executable, "-c", code, "--ros-args", "-p", "gripper:=robotiq_2f85"]
    with (out / "grasp_server.log").open("wb") as log:
        server = subprocess.Popen(command, stdout=log, stderr=log)
    try:
        rclpy.init()
        node = rclpy.create_node("golden")
        client = node.create_client(SynthesizeGrasps, "synthesize_grasps")
        while not client.wait_for_service(1.0):
            if server.poll() is not None:
                raise SystemExit((out / "grasp_server.log").read_text())
        request = SynthesizeGrasps.Request(num_grasps=8, seed=11)
        request.cloud = _message(scene_cloud("table")[0], node)
        end, answer = time.monotonic() + 300.0, None
        while answer is None or answer.error_code in (1, 2, 300):
            if time.monotonic() > end:
                raise SystemExit(f"no answer but {answer}")
            request.cloud.header.stamp = node.get_clock().now().to_msg()
            future = client.call_async(request)
            rclpy.spin_until_future_complete(node, future, timeout_sec=120.0)
            answer = future.result()
        (out / "ros.json").write_text(json.dumps(_plain(answer)))
        node.destroy_node()
        rclpy.shutdown()
    finally:
        server.send_signal(signal.SIGINT)
        server.wait(60.0)


def _plain(value: Any) -> Any:
    """A ROS message as JSON; the stamp, which is that of now, is left out."""
    if hasattr(value, "get_fields_and_field_types"):
        names = value.get_fields_and_field_types()
        return {name: _plain(getattr(value, name)) for name in names if name != "stamp"}
    if hasattr(value, "tolist"):
        return value.tolist()
    return [_plain(one) for one in value] if isinstance(value, (list, tuple)) else value


def _message(points: np.ndarray, node: object) -> object:
    from sensor_msgs.msg import PointCloud2, PointField

    data = points.astype(np.float32)
    message = PointCloud2(height=1, width=len(data), point_step=12, row_step=12 * len(data))
    message.header.frame_id = "world"
    message.fields = [
        PointField(name=name, offset=4 * index, datatype=PointField.FLOAT32, count=1)
        for index, name in enumerate("xyz")
    ]
    message.is_dense = True
    message.data.frombytes(data.tobytes())
    return message


def _console_script(name: str) -> str:
    """`module:function` of an executable of this tree's megrasp_ros."""
    code = (
        "import setuptools, json; setuptools.setup = lambda **k: print(json.dumps("
        "k['entry_points']['console_scripts'])); exec(open('setup.py').read())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd="megrasp_ros", capture_output=True, text=True, check=True
    )
    scripts = dict(line.split(" = ") for line in json.loads(done.stdout))
    return scripts[name]


PARTS: dict[str, Callable[[Path], None]] = {
    "synthesize": synthesize,
    "eval": evaluate,
    "scenes": scenes,
    "train": train,
    "wizard": wizard,
    "ros": ros,
}


def main() -> None:
    """Run the parts that are named; the working directory is the tree."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("parts", nargs="+", choices=PARTS)
    options = parser.parse_args()
    torch.set_num_threads(1)
    for part in options.parts:
        PARTS[part](options.out)


if __name__ == "__main__":
    main()
