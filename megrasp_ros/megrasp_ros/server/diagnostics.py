"""The node's line in /diagnostics: is the camera there, is the model loaded, what did the last
request cost.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping

import psutil
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from std_msgs.msg import Header

UNREPORTED = "not reported"
"""Value of `tool_id` as long as nobody has published it."""


def diagnostics(
    *,
    name: str,
    stamp: Time,
    state: str,
    error: str,
    gripper: str,
    reported: str | None,
    tool_version: int,
    model: str,
    device: str,
    clouds: int,
    cloud_rate: float,
    cloud_silence: float,
    planning_frame: str,
    transform: str,
    transform_missing: bool,
    job: str,
    last_outcome: str,
    latency: float,
    topics: Mapping[str, str],
) -> DiagnosticArray:
    """Return the array with one status. Worst first: an error text, a tool mismatch, a transform
    that was not there, then OK.

    topics: name -> the one it is remapped to.
    """
    level, message = DiagnosticStatus.OK, state
    if transform_missing:
        level, message = DiagnosticStatus.WARN, f"the transform {transform}"
    if gripper and reported is not None and reported != gripper:
        level, message = (
            DiagnosticStatus.WARN,
            f"the changer reports {reported or 'no tool'}, the active gripper is {gripper}",
        )
    if error:
        level, message = DiagnosticStatus.ERROR, error
    values = {
        **{f"topic {name}": full for name, full in topics.items()},
        "state": state,
        "active gripper": gripper or "none",
        "tool_id": UNREPORTED if reported is None else reported or "no tool",
        "tool changes": str(tool_version),
        "model": model or "none",
        "device": device or "none",
        "clouds received": str(clouds),
        "cloud rate (Hz)": f"{cloud_rate:.2f}",
        "last cloud (s ago)": "never" if math.isinf(cloud_silence) else f"{cloud_silence:.2f}",
        "planning frame": planning_frame,
        "transform": transform or "not asked for yet",
        "running job": job or "none",
        "last request": last_outcome or "none yet",
        "last latency (s)": f"{latency:.3f}",
        "memory (MiB)": f"{psutil.Process().memory_info().rss / 2**20:.0f}",
        "memory left (MiB)": f"{psutil.virtual_memory().available / 2**20:.0f}",
        "GPU memory (MiB)": _gpu_memory(device),
    }
    status = DiagnosticStatus(
        level=level,
        name=name,
        message=message,
        hardware_id=device,
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )
    return DiagnosticArray(header=Header(stamp=stamp), status=[status])


def _gpu_memory(device: str) -> str:
    """Return what torch holds on the device, and at most held, "none" on a CPU."""
    torch = sys.modules.get("torch")
    if torch is None or not device.startswith("cuda"):
        return "none"
    now, most = torch.cuda.memory_allocated(device), torch.cuda.max_memory_allocated(device)
    return f"{now / 2**20:.0f}, at most {most / 2**20:.0f}"
