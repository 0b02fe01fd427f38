"""The commands that call the server; `doctor` has a file of its own."""

from __future__ import annotations

import signal
import threading
import time
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from megrasp_msgs.msg import ErrorCode, GraspArray, GripperInfo

from megrasp_core.cli.common import Flag, emit, progress_bar, read_region, say
from megrasp_ros.client import GraspClient

from .as_json import answer_json, message_json

POLL = 0.05
"""Topics are looked at so often (s)."""


def synthesize(
    num_grasps: Annotated[int, tyro.conf.arg(aliases=["-n"])] = 20,
    gripper: str = "",
    cloud: Path | None = None,
    frame: str = "world",
    region: Path | None = None,
    seed: int = 0,
    target: int = -1,
    min_score: float = 0.0,
    prefer: Literal["", "score", "high", "clear"] = "",
    fast: Flag = False,
    preempt: Flag = False,
    namespace: str = "",
    timeout: float = 120.0,
    out: Path | None = None,
) -> int:
    """Ranked grasps for what the camera sees, or for a stored cloud. Ctrl-C cancels.

    Try:
      megrasp_call synthesize
      megrasp_call synthesize -n 5 --gripper franka_hand --seed 7 --out grasps.json
      megrasp_call synthesize --cloud bin.ply --frame world --region bin.yaml

    Args:
        num_grasps: most grasps to return.
        gripper: registered name, or auto; by default the active one.
        cloud: .ply .pcd .npz .npy in metres, instead of the topic `points`.
        frame: that the points of this file are in.
        region: JSON or YAML with pose and size in the planning frame, instead of the server's.
        seed: of everything drawn; 0: a random one.
        target: only grasps of the object with this number of the mask.
        min_score: grasps with a lower score are left out.
        prefer: what comes first; by default as the server is set.
        fast: less exact, in less time.
        preempt: take over from a request that runs.
        namespace: of the server.
        timeout: longest wait (s).
        out: file in the form of grasps.json.
    """
    fields: dict[str, Any] = {
        "gripper_name": gripper,
        "seed": seed,
        "target": target,
        "min_score": min_score,
        "prefer": prefer,
        "mode": "fast" if fast else "",
        "preempt": preempt,
    }
    if region is not None:
        from megrasp_ros.conversions import message_from_box

        fields["region"] = message_from_box(read_region(region)[0])
    stop = threading.Event()
    with GraspClient.open("megrasp_call", namespace=namespace, timeout=timeout) as client:
        points = None
        if cloud is not None:
            from megrasp_core.pointcloud import read_cloud

            points = read_cloud(cloud).points
        # One that was just started answers as soon as its model is loaded.
        client.wait_until_ready(timeout)
        if points is not None:
            from megrasp_ros.sensor_messages import cloud_message

            now = client.node.get_clock().now().to_msg()
            fields["cloud"] = cloud_message(points, frame=frame, stamp=now)

        def interrupted(number: int, _: object) -> None:
            stop.set()
            # The second one ends the program.
            signal.signal(number, signal.SIG_DFL)

        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, interrupted)
        with progress_bar(None, "synthesize") as bar:

            def show(feedback: Any) -> None:
                bar.total, bar.n = feedback.total_steps or None, feedback.step
                bar.set_description(feedback.phase)

            result = client.generate(num_grasps, on_feedback=show, cancelled=stop.is_set, **fields)
    if out is not None:
        emit(answer_json(result), out)
    if result.error_code == ErrorCode.CANCELLED:
        say("cancelled")
        return 1
    grasps = result.grasps
    say(
        f"{len(grasps.grasps)} grasps of {grasps.gripper} in {grasps.header.frame_id!r} by "
        f"{grasps.model_id}, seed {grasps.seed}, {result.timing.total:.2f} s"
    )
    say("rank  score  width mm  tilt  TCP x y z (m)")
    for grasp in grasps.grasps:
        at = grasp.tcp.position
        say(
            f"{grasp.id:4d}  {grasp.score:5.2f}  {1000 * grasp.width:8.1f}  {grasp.tilt:4.2f}  "
            f"{at.x:7.4f} {at.y:7.4f} {at.z:7.4f}"
        )
    for note in result.notes:
        say(f"note: {note}")
    return 0


def set_gripper(
    name: tyro.conf.Positional[str],
    dry_run: Flag = False,
    namespace: str = "",
    timeout: float = 120.0,
    out: Path | None = None,
) -> int:
    """Make another gripper the active one.

    Try:
      megrasp_call set_gripper franka_hand
      megrasp_call set_gripper robotiq_3f --dry-run

    Args:
        name: registered name, see `megrasp_call list`.
        dry_run: only check that it could be.
        namespace: of the server.
        timeout: longest wait (s).
        out: file with the gripper's facts (JSON).
    """
    with GraspClient.open("megrasp_call", namespace=namespace, timeout=timeout) as client:
        client.wait_until_ready(timeout)
        info = client.set_gripper(name, dry_run=dry_run)
    if out is not None:
        emit(message_json(info), out)
    say(f"{'could be active' if dry_run else 'active'}: {_line(info)}")
    return 0


def change_tool(
    name: tyro.conf.Positional[str], namespace: str = "", timeout: float = 120.0
) -> int:
    """Let the tool changer (or the simulated cell) mount a gripper: its service `change_tool`. The
    server is told by the changer's `tool_id`; `set_gripper` makes the gripper the active one.

    Try:
      megrasp_call change_tool robotiq_3f
      megrasp_call change_tool robotiq_2f85 --namespace /cell_2

    Args:
        name: as in the changer's rack.
        namespace: of the changer.
        timeout: longest wait (s).
    """
    with GraspClient.open("megrasp_call", namespace=namespace, timeout=timeout) as client:
        answer = client.change_tool(name)
    say(
        f"mounted: {answer.mounted or 'nothing'}{f' ({answer.message})' if answer.message else ''}"
    )
    return 0 if answer.success else 1


def list_grippers(namespace: str = "", timeout: float = 60.0, out: Path | None = None) -> int:
    """The registered grippers; * marks the active one.

    Try:
      megrasp_call list
      megrasp_call list --namespace /cell_2 --out grippers.json

    Args:
        namespace: of the server.
        timeout: longest wait (s).
        out: file with all there is to know of them (JSON).
    """
    with GraspClient.open("megrasp_call", namespace=namespace, timeout=timeout) as client:
        answer = client.list_grippers()
    if out is not None:
        emit(message_json(answer), out)
    for info in answer.grippers:
        say(f"{'*' if info.name == answer.active else ' '} {_line(info)}")
    return 0 if answer.grippers else 1


def watch(
    count: int | None = None,
    seconds: float | None = None,
    namespace: str = "",
    out: Path | None = None,
) -> int:
    """A line for each message on `grasps` and `active_gripper`, until Ctrl-C.

    Try:
      megrasp_call watch
      megrasp_call watch --count 2 --seconds 10 --out heard.json

    Args:
        count: end after so many messages.
        seconds: end after this time; exit code 1 if nothing was heard.
        namespace: of the server.
        out: file with the messages (JSON).
    """
    end = None if seconds is None else time.monotonic() + seconds
    heard: list[dict[str, Any]] = []
    last: dict[str, Any] = {}
    with GraspClient.open("megrasp_call", namespace=namespace) as client:
        try:
            while (count is None or len(heard) < count) and (
                end is None or time.monotonic() < end
            ):
                for topic, message in (
                    ("active_gripper", client.active_gripper),
                    ("grasps", client.grasps),
                ):
                    if message is not None and message is not last.get(topic):
                        last[topic] = message
                        heard.append({"topic": topic, "message": message_json(message)})
                        say(f"{topic}: {_told(message)}")
                time.sleep(POLL)
        except KeyboardInterrupt:
            pass
    if out is not None:
        emit(heard, out)
    return 0 if heard else 1


def _told(message: GraspArray | GripperInfo) -> str:
    if isinstance(message, GripperInfo):
        return _line(message)
    grasps = list(message.grasps)
    if not grasps:
        return "none"
    stamp = message.header.stamp
    return (
        f"{len(grasps)} of {message.gripper} in {message.header.frame_id!r}, best "
        f"{grasps[0].score:.2f}, cloud of {stamp.sec}.{stamp.nanosec // 10**6:03d}"
    )


def _line(info: GripperInfo) -> str:
    width = "" if info.max_width != info.max_width else f", {1000 * info.max_width:.0f} mm"
    seen = "trained with" if info.seen_in_training else "never trained with"
    return f"{info.name:<18} {info.kind}{width}, {seen}  ({info.display_name})"
