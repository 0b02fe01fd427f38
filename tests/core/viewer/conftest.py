"""A small scene, a synthesizer, and a viewer of both."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest

from megrasp_core.pointcloud import Cloud, OrientedBox
from megrasp_core.synthesizer import GraspSynthesizer, RankedGrasp, SynthesisRequest
from megrasp_core.viewer import Outcome, SceneViewer, open_server

REQUEST = SynthesisRequest(
    num_grasps=3, drawn=12, seed=1, region=OrientedBox.around((0, 0, 0.075), (0.24, 0.24, 0.17))
)


def scene(height: float) -> Cloud:
    """A box of this height (m) on a floor, seen from above."""
    x, y = np.meshgrid(np.arange(-0.1, 0.1, 0.004), np.arange(-0.1, 0.1, 0.004))
    z = np.where((abs(x) < 0.02) & (abs(y) < 0.03), height, 0.0)
    points = np.stack([x, y, z], -1).reshape(-1, 3)
    return Cloud(points, viewpoint=np.array([0.0, 0.0, 0.8]))


@dataclass
class Bench:
    """A viewer and what it was given."""

    viewer: SceneViewer
    heights: list[float]
    executed: list[tuple[RankedGrasp, str]] = field(default_factory=list)


@pytest.fixture(scope="module")
def bench() -> Iterator[Bench]:
    pytest.importorskip("viser", reason="viser is missing: pip install 'megrasp-core[view]'")
    heights, executed = [0.05], []

    def execute(grasp: RankedGrasp, gripper: str) -> Outcome:
        executed.append((grasp, gripper))
        heights[0] = 0.06
        return Outcome("it holds")

    server = open_server(port=0)
    viewer = SceneViewer(
        server,
        GraspSynthesizer.load(gripper="robotiq_2f85", threads=1),
        lambda: scene(heights[0]),
        REQUEST,
        grippers=["robotiq_2f85", "robotiq_3f"],
        execute=execute,
    )
    yield Bench(viewer, heights, executed)
    server.stop()
