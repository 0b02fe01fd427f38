"""A grasp_server in a process of its own, in a namespace of its own, and calls of it."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import rclpy
import yaml
from ament_index_python.packages import get_package_prefix
from diagnostic_msgs.msg import DiagnosticArray
from megrasp_msgs.srv import ListGrippers, ReloadGrippers, SetGripper, SynthesizeGrasps
from numpy.typing import NDArray
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter

from megrasp_core.errors import MegraspError
from megrasp_ros.spinning import spin
from megrasp_ros.waiting import wait_for_future

_PR_SET_PDEATHSIG = 1
"""Of sys/prctl.h."""

STARTING = 240.0
"""Longest wait (s) for the node to be active on a busy machine."""

SERVICES: dict[Any, str] = {
    SynthesizeGrasps: "synthesize_grasps",
    SetGripper: "set_gripper",
    ListGrippers: "list_grippers",
    ReloadGrippers: "reload_grippers",
    SetParameters: "grasp_server/set_parameters",
    GetParameters: "grasp_server/get_parameters",
}


class TrialError(MegraspError):
    """The server did not do what the trial needs to go on."""


class ServerProcess:
    """A running grasp_server.

    node: of the trial, in the server's namespace, spun by another thread.
    """

    def __init__(self, node: Node, process: subprocess.Popen[bytes], log: Path) -> None:
        self.node, self.process = node, process
        self._log = log
        self._clients: dict[type, Client] = {}
        self._status: dict[str, str] = {}
        self._told = threading.Condition()
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def client(self, kind: type, name: str = "") -> Client:
        """Return the client of a service, which is there."""
        if kind not in self._clients:
            client = self.node.create_client(kind, name or SERVICES[kind])
            end = time.monotonic() + STARTING
            while not client.wait_for_service(timeout_sec=1.0):
                if self.process.poll() is not None or time.monotonic() > end:
                    raise TrialError(
                        f"no service {client.srv_name}; expected grasp_server to offer it. The "
                        f"end of its log:\n{self.log_end()}"
                    )
            self._clients[kind] = client
        return self._clients[kind]

    def call(self, request: Any, seconds: float = 120.0) -> Any:
        """Return the answer to a request, None when none came in time."""
        kind = next(each for each in SERVICES if isinstance(request, each.Request))
        future = self.client(kind).call_async(request)
        return wait_for_future(future, seconds, context=self.node.context)

    def set_parameters(self, **values: Any) -> None:
        """Set parameters (`__` in a name stands for a dot). Raises TrialError."""
        parameters = [
            Parameter(name.replace("__", "."), value=value).to_parameter_msg()
            for name, value in values.items()
        ]
        answer = self.call(SetParameters.Request(parameters=parameters))
        refused = [each.reason for each in answer.results if not each.successful]
        if refused:
            raise TrialError(f"parameters were refused: {'; '.join(refused)}")

    def wait_until_active(self) -> None:
        """Wait until requests are served. Raises TrialError."""
        end = time.monotonic() + STARTING
        while True:
            answer = self.call(SetGripper.Request(gripper_name="robotiq_2f85", dry_run=True))
            if answer is not None and answer.success:
                return
            if time.monotonic() > end:
                raise TrialError(f"grasp_server is not active; its log ends\n{self.log_end()}")
            time.sleep(0.2)

    def diagnostics(self, seconds: float = 10.0) -> dict[str, str]:
        """Return the next line of the server on /diagnostics. Raises TrialError."""
        with self._told:
            self._status = {}
            if not self._told.wait_for(lambda: bool(self._status), seconds):
                raise TrialError(f"grasp_server sent no diagnostics for {seconds:g} s")
            return self._status

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        name = f"{self.node.get_namespace()}/grasp_server"
        for status in message.status:
            if status.name == name:
                with self._told:
                    self._status = {pair.key: pair.value for pair in status.values}
                    self._told.notify_all()

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self.process.poll() is None

    def memory(self) -> float:
        """Resident memory of the server (MiB)."""
        return psutil.Process(self.process.pid).memory_info().rss / 2**20

    def cpu_seconds(self) -> float:
        """CPU time of the server so far (s)."""
        times = psutil.Process(self.process.pid).cpu_times()
        return times.user + times.system

    def log_end(self, lines: int = 20) -> str:
        """Return the last lines of its output."""
        return "\n".join(self._log.read_text(errors="replace").splitlines()[-lines:])


@contextmanager
def server_process(
    parameters: Mapping[str, Any],
    *,
    command: list[str] | None = None,
    namespace: str = "",
    context: Context | None = None,
) -> Iterator[ServerProcess]:
    """Yield a server that has been started and will be active soon.

    Args:
        parameters: of the node.
        command: in place of the installed executable.
        namespace: of the server; by default one that nobody else has.
        context: of the trial's node; a command gives rclpy's default one, which its signals shut
            down, so that every wait ends. By default one of its own.
    """
    namespace = namespace or f"/trial_{os.getpid()}"
    with tempfile.TemporaryDirectory(prefix="megrasp_trial_") as folder:
        log = Path(folder) / "grasp_server.log"
        process = start_node(
            command or [str(executable("grasp_server"))], namespace, parameters, log
        )
        own = context is None
        if context is None:
            context = rclpy.Context()
            rclpy.init(context=context)
        node = Node("trial", namespace=namespace, context=context)
        # Of one thread: send_in_executor relies on it.
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        ended = threading.Event()
        spinner = threading.Thread(target=spin, args=(executor, ended.is_set))
        spinner.daemon = True
        spinner.start()
        try:
            yield ServerProcess(node, process, log)
        finally:
            stop(process)
            ended.set()
            executor.shutdown()
            spinner.join(5.0)
            node.destroy_node()
            if own:
                context.try_shutdown()


def executable(name: str) -> Path:
    """Return where an executable of this package is installed."""
    return Path(get_package_prefix("megrasp_ros")) / "lib" / "megrasp_ros" / name


def start_node(
    command: list[str], namespace: str, parameters: Mapping[str, Any], log: Path
) -> subprocess.Popen[bytes]:
    """Start a node; what it prints goes to `log`."""
    file = log.with_suffix(".yaml")
    file.write_text(yaml.safe_dump({"/**": {"ros__parameters": dict(parameters)}}))
    arguments = ["--ros-args", "-r", f"__ns:={namespace}", "--params-file", str(file)]
    with log.open("wb") as output:
        return subprocess.Popen(
            [*command, *arguments],
            stdout=output,
            stderr=subprocess.STDOUT,
            preexec_fn=_child,
        )


def _child() -> None:
    """Prepare a child: it hears SIGINT, which a shell's background job has ignored, and ends with
    its parent.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    prctl = getattr(ctypes.CDLL(None), "prctl", None)
    if prctl is not None:
        prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def stop(process: subprocess.Popen[bytes]) -> int:
    """End a node by SIGTERM, after half a minute by SIGKILL; return its exit code."""
    process.terminate()
    try:
        return process.wait(30.0)
    except subprocess.TimeoutExpired:
        process.kill()
        return process.wait()


@contextmanager
def camera_process(
    server: ServerProcess, points: NDArray[np.float32], *, rate: float, count: int = 0
) -> Iterator[Path]:
    """Yield the log of a camera that publishes (h, w, 3) to the server's `points`."""
    with tempfile.TemporaryDirectory(prefix="megrasp_trial_") as folder:
        file, log = Path(folder) / "points.npy", Path(folder) / "camera.log"
        np.save(file, points)
        command = [sys.executable, "-m", "megrasp_ros.trials.camera"]
        parameters = {"file": str(file), "rate": rate, "count": count}
        process = start_node(command, server.node.get_namespace(), parameters, log)
        try:
            yield log
        finally:
            stop(process)
