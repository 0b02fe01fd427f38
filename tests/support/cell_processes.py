"""Real processes over Fast DDS for the tests of the cell's nodes, on a domain of their own."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import rclpy
from ament_index_python.packages import get_package_prefix
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future

from megrasp_core.objects import ObjectModel, save_object
from megrasp_ros.waiting import wait_for_future

T = TypeVar("T")
WAIT = 240.0
"""Longest wait (s). Imports take 5 s of CPU, which is minutes on a very busy machine."""


def default_signals() -> None:
    """Lets a child be interrupted even where the tests themselves run in the background.

    A shell starts background jobs with SIGINT ignored, and children inherit that.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def own_domain(offset: int) -> int:
    """A ROS domain of this test session and worker, apart from those of others on the machine.

    Args:
        offset: 1 to 8, another one for everything that runs at the same time in one worker.
    """
    worker = os.environ.get("PYTEST_XDIST_WORKER")
    run = os.getpid() if worker is None else os.getppid()
    number = 0 if worker is None else int(worker.removeprefix("gw"))
    return 20 + (run * 16 + number * 8 + offset) % 180


class Processes:
    """Nodes of the package as processes that end with the test."""

    def __init__(self, domain: int, folder: Path) -> None:
        self.domain = domain
        self.folder = folder
        self.running: dict[str, subprocess.Popen[bytes]] = {}
        self.env = os.environ | {
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_LOG_DIR": str(folder / "ros_log"),
            "OMP_NUM_THREADS": "1",
            "PYTHONUNBUFFERED": "1",
        }

    def start(
        self, name: str, *, label: str = "", **parameters: object
    ) -> subprocess.Popen[bytes]:
        """Starts an executable of megrasp_ros; its output goes to LABEL.log or NAME.log."""
        executable = Path(get_package_prefix("megrasp_ros")) / "lib" / "megrasp_ros" / name
        return self.start_command(label or name, [str(executable)], **parameters)

    def start_command(
        self, name: str, command: list[str], **parameters: object
    ) -> subprocess.Popen[bytes]:
        """Starts any command with ROS parameters; `__` in a name stands for a dot."""
        arguments = ["--ros-args"]
        for key, value in parameters.items():
            text = (
                "[" + ", ".join(map(str, value)) + "]" if isinstance(value, list) else str(value)
            )
            arguments += ["-p", f"{key.replace('__', '.')}:={text}"]
        with self.log_file(name).open("wb") as log:
            process = subprocess.Popen(
                command + (arguments if parameters else []),
                env=self.env,
                stdout=log,
                stderr=subprocess.STDOUT,
                preexec_fn=default_signals,
            )
        self.running[name] = process
        return process

    def log_file(self, name: str) -> Path:
        return self.folder / f"{name}.log"

    def log(self, name: str) -> str:
        return self.log_file(name).read_text()

    def logs(self) -> str:
        """Every log, for the message of a failed assertion."""
        return "\n".join(
            f"--- {path.name}\n{path.read_text()}" for path in self.folder.glob("*.log")
        )

    def stop(self, name: str, number: int = signal.SIGINT) -> int:
        """Sends the signal and returns the exit code."""
        process = self.running.pop(name)
        if process.poll() is None:
            process.send_signal(number)
        try:
            return process.wait(timeout=WAIT)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            raise

    def stop_all(self) -> None:
        for name in list(self.running):
            self.stop(name)


@contextmanager
def processes(domain: int, folder: Path) -> Iterator[Processes]:
    """Processes that are stopped at the end, whatever happens."""
    started = Processes(domain, folder)
    try:
        yield started
    finally:
        started.stop_all()


@contextmanager
def spinning_node(domain: int, name: str = "test_client") -> Iterator[Node]:
    """A node in a context of its own, spun in the background."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    node = Node(name, context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    thread = threading.Thread(target=executor.spin, daemon=True)
    thread.start()
    try:
        yield node
    finally:
        executor.shutdown()
        thread.join(timeout=5.0)
        node.destroy_node()
        context.try_shutdown()


def in_executor(node: Node, call: Callable[[], T]) -> T:
    """What `call` returns, called by the node's executor.

    For every goal, cancellation and request: `megrasp_ros.waiting.send_in_executor` says why. That
    one waits for the answer as well; here a test can do something else meanwhile. And for what is
    destroyed: an executor that meets a destroyed handle while it collects what to wait for ends.
    """
    assert node.executor is not None
    outcome: list[T] = []
    errors: list[Exception] = []

    def attempt() -> None:
        # An exception in a task would end the thread that spins.
        try:
            outcome.append(call())
        except Exception as error:
            errors.append(error)

    wait_for_future(node.executor.create_task(attempt), WAIT, context=node.context)
    if errors:
        raise errors[0]
    assert outcome, "the node does not spin"
    return outcome[0]


def result(future: Future, seconds: float = WAIT) -> Any:
    """What a future brings; fails after `seconds`."""
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    assert done.wait(seconds), "no answer in time"
    return future.result()


def until(condition: Callable[[], bool], seconds: float = WAIT) -> bool:
    """Whether the condition came true in time."""
    turn = threading.Event()
    for _ in range(round(seconds / 0.02)):
        if condition():
            return True
        turn.wait(0.02)
    return condition()


def box_model(name: str, edges: tuple[float, float, float], density: float = 600.0) -> ObjectModel:
    """A solid box."""
    size = np.array(edges)
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * size / 2
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
    mass = density * float(size.prod())
    x, y, z = size**2
    inertia = np.diag([y + z, x + z, x + y]) * mass / 12
    return ObjectModel(name, corners, faces, ((corners, faces),), mass, inertia)


def save_boxes(folder: Path, count: int, edges: tuple[float, float, float]) -> None:
    """An object folder of `count` equal boxes."""
    for index in range(count):
        save_object(box_model(f"box_{index}", edges), folder / f"box_{index}")
