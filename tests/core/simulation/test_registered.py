"""Every registered gripper: it checks out, renders, holds a box, and its gripper.yaml survives
being written.

Our own always; those that are CAD models where MEGRASP_ASSETS is set.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from megrasp_core.gripper_tools.check import check_gripper
from megrasp_core.gripper_tools.compare import surface_distance
from megrasp_core.gripper_tools.family_check import DENSITY, suitable_object
from megrasp_core.grippers import (
    Gripper,
    cad_folders,
    gripper_folders,
    load_description,
    load_gripper,
    save_description,
)
from megrasp_core.library import antipodal
from megrasp_core.objects import ObjectModel, box, mass_properties
from megrasp_core.simulation import FreeSpaceRig, Reason

FOLDERS = {**cad_folders(), **gripper_folders()}
POINTS = 256
CUBE = (0.04, 0.04, 0.04)
CANDIDATES = 8
NEAR = 1e-4
"""Points lie on the meshes within this (m), single precision rays being what they are."""


@pytest.fixture(scope="module", params=sorted(FOLDERS))
def gripper(request: pytest.FixtureRequest) -> Gripper:
    """Every registered gripper in turn."""
    description = load_description(FOLDERS[request.param])
    if description.model.startswith("asset:") and not os.environ.get("MEGRASP_ASSETS"):
        pytest.skip("a CAD model; MEGRASP_ASSETS is not set")
    return load_gripper(request.param)


def test_checks_out(gripper: Gripper) -> None:
    """`megrasp gripper check` has nothing against it; closing on nothing, it gets to the closed
    posture.
    """
    result = check_gripper(gripper.description.folder)
    assert result.ok, result.errors
    assert result.measures["closing_error_2ms"] < 0.05
    assert not any("closed posture" in text for text in result.warnings)


def test_renders(gripper: Gripper, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both clouds lie on the surface, normals are unit vectors, the postures differ."""
    monkeypatch.setenv("MEGRASP_CACHE", "off")
    clouds = gripper.clouds(POINTS)
    for name, points, normals, moved in (
        ("open", clouds.open_points, clouds.open_normals, clouds.displacement),
        ("closed", clouds.closed_points, clouds.closed_normals, clouds.closed_displacement),
    ):
        assert points.shape == normals.shape == moved.shape == (POINTS, 3)
        assert np.isfinite(points).all() and np.isfinite(moved).all()
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-6)
        assert surface_distance(points, gripper.meshes(name)).max() < NEAR
        assert 0.03 < np.ptp(points, axis=0).max() < 0.6
        assert 0.005 < np.linalg.norm(moved, axis=1).max() < 0.3
    assert surface_distance(clouds.closed_points, gripper.meshes("open")).max() > 0.01
    tokens = gripper.tokens()
    assert tokens.points.shape == tokens.normals.shape == tokens.displacement.shape == (64, 3)
    assert np.isfinite(tokens.points).all() and np.isfinite(tokens.displacement).all()
    np.testing.assert_array_equal(tokens.closed, np.repeat([0.0, 1.0], 32))


def test_holds_a_box(gripper: Gripper) -> None:
    """One of a few antipodal grasps holds a box that suits it through the free-space trial."""
    model = cube() if gripper.description.max_width is None else suitable_object(gripper, "box")
    rig = FreeSpaceRig(gripper, model, timestep=0.004)
    poses = antipodal(model, gripper, CANDIDATES, np.random.default_rng(0)).object_from_gripper
    reasons = []
    for pose in poses:
        reasons.append(rig.trial(pose).reason)
        if reasons[-1] is Reason.SUCCESS:
            break
    assert Reason.SUCCESS in reasons, reasons
    assert Reason.UNSTABLE not in reasons, reasons


def test_survives_being_written(gripper: Gripper, tmp_path: Path) -> None:
    """What is written is what was read, and loads as the same gripper."""
    description = gripper.description
    folder = tmp_path / gripper.name
    save_description(description, folder)
    again = load_description(folder)
    assert again.to_dict() == description.to_dict()
    if not description.model.startswith("asset:"):
        (model,) = gripper.model_files()
        copied = folder / description.model
        copied.parent.mkdir(exist_ok=True)
        shutil.copyfile(model, copied)
    assert Gripper(again).hash == gripper.hash


def cube() -> ObjectModel:
    """Return a cube for hands, which state no width."""
    solid = box(CUBE)
    whole = mass_properties(solid.pieces)
    return ObjectModel(
        "cube",
        solid.vertices,
        solid.faces,
        solid.pieces,
        DENSITY * whole.volume,
        DENSITY * whole.inertia,
    )
