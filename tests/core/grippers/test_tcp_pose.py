"""The TCP frame and its inverse."""

from __future__ import annotations

import numpy as np
import pytest

from megrasp_core.grippers import load_gripper


@pytest.mark.parametrize("name", ["franka_hand", "shadow_hand"])
def test_the_gripper_in_the_tcp_frame_is_the_inverse(name: str) -> None:
    gripper = load_gripper(name)
    product = gripper.gripper_from_tcp @ gripper.tcp_from_gripper
    np.testing.assert_array_equal(product, np.eye(4))
