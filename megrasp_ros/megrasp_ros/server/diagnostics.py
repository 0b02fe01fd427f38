"""The node's line in /diagnostics: is the camera there, is the model loaded, what did the last
request cost.
"""

from __future__ import annotations

import math

import psutil
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from std_msgs.msg import Header


def diagnostics(
    *,
    name: str,
    stamp: Time,
    state: str,
    error: str,
    gripper: str,
    tool_id: str,
    model: str,
    device: str,
    clouds: int,
    cloud_rate: float,
    cloud_silence: float,
    transform: str,
    job: str,
    last_outcome: str,
    latency: float,
) -> DiagnosticArray:
    """Return the array with one status. Worst first: an error text, a tool mismatch, then OK."""
    level, message = DiagnosticStatus.OK, state
    if tool_id and gripper and tool_id != gripper:
        level, message = (
            DiagnosticStatus.WARN,
            f"tool_id reports {tool_id}, the active gripper is {gripper}",
        )
    if error:
        level, message = DiagnosticStatus.ERROR, error
    values = {
        "state": state,
        "active gripper": gripper or "none",
        "tool_id": tool_id or "not reported",
        "model": model or "none",
        "device": device or "none",
        "clouds received": str(clouds),
        "cloud rate (Hz)": f"{cloud_rate:.2f}",
        "last cloud (s ago)": "never" if math.isinf(cloud_silence) else f"{cloud_silence:.2f}",
        "transform": transform,
        "running job": job or "none",
        "last request": last_outcome or "none yet",
        "last latency (s)": f"{latency:.3f}",
        "memory (MiB)": f"{psutil.Process().memory_info().rss / 2**20:.0f}",
    }
    status = DiagnosticStatus(
        level=level,
        name=name,
        message=message,
        hardware_id=device,
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )
    return DiagnosticArray(header=Header(stamp=stamp), status=[status])
