"""What is told of a scene beside what is seen in it."""

from __future__ import annotations

import numpy as np

from megrasp_core.pointcloud import Cloud, OrientedBox
from megrasp_core.synthesizer import SynthesisRequest
from megrasp_core.synthesizer.perception import perceive


def test_a_region_far_wider_than_what_lies_in_it_is_told() -> None:
    x, y = np.meshgrid(np.arange(-0.15, 0.15, 0.003), np.arange(-0.15, 0.15, 0.003))
    z = np.where((abs(x) < 0.02) & (abs(y) < 0.03), 0.05, 0.0)
    block = Cloud(np.stack([x, y, z], -1).reshape(-1, 3), viewpoint=np.array([0.0, 0.0, 0.8]))
    for size, told in (((0.4, 0.3, 0.15), False), ((40.0, 30.0, 15.0), True)):
        region = OrientedBox.around((0.0, 0.0, size[2] / 2 - 0.01), size)
        notes = perceive(block, SynthesisRequest(region=region, walls=False)).notes
        assert any("check that it is in metres" in note for note in notes) is told
