"""Every own description against the CAD model of the same gripper (at equal joint
values). Limits: `megrasp_core.gripper_tools.fidelity`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gripper_cases import OWN_JAWS

from megrasp_core.gripper_tools.compare import outer_points, surface_distance
from megrasp_core.gripper_tools.fidelity import fidelity, markdown_table, text_table
from megrasp_core.grippers import Gripper, Pose, cad_twins, load_gripper
from megrasp_core.meshes import Mesh


@pytest.mark.slow
@pytest.mark.parametrize(("name", "twin"), cad_twins().items())
def test_like_the_cad(name: str, twin: str, assets: Path) -> None:
    """Surfaces, TCP, opening and pad motion are within the limits, 20 000 points a posture."""
    result = fidelity(load_gripper(name), load_gripper(twin))
    assert result.points == 20000
    assert {"surface_open", "surface_closed", "tcp", "pad_motion"} <= {
        m.quantity for m in result.measures
    }
    assert result.passed, text_table(result)


def test_every_jaw_has_a_twin() -> None:
    """The table of twins comes from the folders."""
    assert set(cad_twins()) >= set(OWN_JAWS)


def test_differences_are_found(assets: Path) -> None:
    """Another gripper fails; a moved one fails by as much as it was moved."""
    own = load_gripper("schunk_wsg32")
    other = fidelity(own, load_gripper("robotiq_2f140_cad"), points=1000)
    failed = {m.quantity for m in other.measures if not m.passed}
    assert failed == {"surface_open", "surface_closed", "tcp", "opening", "pad_motion"}
    assert "FAIL" in text_table(other)
    assert "**" in markdown_table([other.to_dict()])
    tcp = (0.0, 0.0, own.description.tcp[2] + 0.02)
    moved = Gripper(replace(own.description, mount_from_model=_shifted(own, 0.02), tcp=tcp))
    found = {m.quantity: m for m in fidelity(moved, own, points=1000).measures}
    assert found["tcp"].value == pytest.approx(0.02)
    assert not found["tcp"].passed and not found["surface_open"].passed
    # The opening is taken at the TCP, which has moved along.
    assert found["opening"].value == pytest.approx(0.0, abs=1e-4)
    assert found["pad_motion"].value == pytest.approx(0.0, abs=1e-4)


def _shifted(gripper: Gripper, forward: float) -> Pose:
    mount = gripper.description.mount_from_model
    return Pose((mount.xyz[0], mount.xyz[1], mount.xyz[2] + forward), mount.quat)


def test_a_description_is_like_itself() -> None:
    """No measure is over zero, and the surfaces are the same."""
    own = load_gripper("robotiq_2f140")
    result = fidelity(own, own, points=1000)
    assert max(abs(m.value) for m in result.measures) < 1e-6
    assert result.to_dict()["measures"]["surface_open"] == {
        "value": 0.0,
        "limit": 0.003,
        "passed": True,
    }


def test_outer_points_follow_the_area() -> None:
    """Points lie on the surface, each part has its share, what is inside has none."""
    side = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    faces = np.array(
        [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
         [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    )  # fmt: skip
    large, small, hidden = 0.1 * side, 0.05 * side + [0.2, 0, 0], 0.02 * side + 0.04
    meshes = [Mesh(part, faces) for part in (large, small, hidden)]
    points = outer_points(meshes, 2000, seed=1)
    assert points.shape == (2000, 3)
    assert surface_distance(points, meshes[:2]).max() < 1e-6
    assert (points[:, 0] > 0.15).mean() == pytest.approx(0.2, abs=0.04)
