"""The page in a headless Chromium: it loads, synthesize is pressed, grasps appear."""

from __future__ import annotations

import io

import numpy as np
import pytest
from browser import chromium, eventually, opened
from PIL import Image

from .conftest import Bench

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(chromium() is None, reason="no chromium: apt-get install chromium"),
]


def test_grasps_appear(bench: Bench) -> None:
    server = bench.viewer.server
    with opened(f"http://127.0.0.1:{server.get_port()}") as page:
        assert eventually(lambda: "Read the cloud again" in page.text()), page.text()
        assert "grasps for" not in page.text()

        def shades() -> int:
            # What is left of the panel: the drawing.
            pixels = np.asarray(Image.open(io.BytesIO(page.picture())).convert("RGB"))
            return len(np.unique(pixels[150:, :900].reshape(-1, 3), axis=0))

        assert eventually(lambda: shades() > 20), "the cloud is not drawn"
        assert page.press("Synthesize")
        assert eventually(lambda: "grasps for robotiq_2f85" in page.text()), page.text()
        assert eventually(lambda: "1 of " in page.text())
        assert eventually(lambda: server.scene.get_handle_by_name("/gripper").visible)
