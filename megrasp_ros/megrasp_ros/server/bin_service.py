"""The service detect_bin: where the bin is, how large and how full."""

from __future__ import annotations

from collections.abc import Awaitable
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from builtin_interfaces.msg import Time
from megrasp_msgs.srv import DetectBin
from rclpy.callback_groups import CallbackGroup

from megrasp_ros.conversions import message_from_box
from megrasp_ros.errors import describe
from megrasp_ros.lifecycle import GuardedLifecycleNode
from megrasp_ros.pacing import paced
from megrasp_ros.qos import CALLS

from . import parameters
from .parameters import Settings
from .sensing import Sensing
from .worker import Job

if TYPE_CHECKING:
    from megrasp_core.pointcloud import FoundBin


class RunJob(Protocol):
    """Runs work in the worker thread of an active node."""

    def __call__(
        self, what: str, work: Any, *, timeout: float, preemptible: bool
    ) -> Awaitable[Any]:
        """Return what the work returns, or raise what it raises; `timeout` in seconds."""
        ...


class BinService:
    """Serves detect_bin."""

    def __init__(
        self,
        node: GuardedLifecycleNode,
        sensing: Sensing,
        run_job: RunJob,
        group: CallbackGroup,
    ) -> None:
        self._node, self._sensing, self._run_job = node, sensing, run_job
        node.create_service(
            DetectBin,
            "detect_bin",
            paced(self._on_request, node),
            callback_group=group,
            qos_profile=CALLS,
        )

    async def _on_request(
        self, request: DetectBin.Request, response: DetectBin.Response
    ) -> DetectBin.Response:
        settings = parameters.read(self._node)
        log = self._node.get_logger()
        try:
            found = await self._run_job(
                "detect_bin",
                lambda job: self._find(request, settings, job),
                timeout=settings.request_timeout,
                preemptible=True,
            )
        except Exception as error:
            response.error_code, response.error_msg = describe(error)
            log.warning(f"detect_bin: error {response.error_code}: {response.error_msg}")
            return response
        log.info(
            f"detect_bin: {' x '.join(f'{edge:.3f}' for edge in found.box.size)} m, "
            f"fill level {found.fill_level:.2f}, depth from: {found.depth_from}"
        )
        return _fill(response, found)

    def _find(self, request: DetectBin.Request, settings: Settings, job: Job) -> FoundBin:
        size = np.array([request.size.x, request.size.y, request.size.z])
        sensed = self._sensing.sense(
            job,
            settings,
            given=request.cloud if request.cloud.width else None,
            not_before=Time(),
        )
        from megrasp_core.pointcloud import find_bin

        with sensed.placed():
            found = find_bin(sensed.cloud, sensed.gravity, size=size if size.any() else None)
        job.check()
        return found


def _fill(response: DetectBin.Response, found: FoundBin) -> DetectBin.Response:
    response.success = True
    response.bin = message_from_box(found.box)
    response.fill_level = float(found.fill_level)
    response.rows, response.columns = found.cells.shape
    # The message has 1 for what stands over the rim as well.
    response.cells = np.clip(found.cells, 0.0, 1.0).astype(np.float32).ravel().tolist()
    return response
