"""The shipped grippers: frames, opening, clouds, tokens, registry."""

from __future__ import annotations

import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
from gripper_cases import OWN_JAWS

from megrasp_core.errors import DescriptionError, InvalidRequestError, UnknownGripperError
from megrasp_core.grippers import (
    Gripper,
    check_gripper,
    gripper_folders,
    gripper_picture,
    list_grippers,
    load_description,
    load_gripper,
    opening,
    save_description,
    symmetry_residual,
)
from megrasp_core.grippers.compare import pad_displacement, surface_distance

TCP = {
    "franka_hand": 0.1034,
    "google_gripper": 0.12,
    "rethink_gripper": 0.1034,
    "robotiq_2f140": 0.19,
    "robotiq_2f85": 0.15,
    "robotiq_3f": 0.185,
    "schunk_wsg32": 0.125,
    "vx300s_gripper": 0.105,
}
OPENING = {
    "franka_hand": 0.080,
    "google_gripper": 0.136,
    "rethink_gripper": 0.060,
    "robotiq_2f140": 0.129,
    "robotiq_2f85": 0.085,
    "robotiq_3f": 0.168,
    "schunk_wsg32": 0.056,
    "vx300s_gripper": 0.087,
}
# Motion of each pad towards the middle and along the approach while closing.
CLOSING = {
    "franka_hand": (0.040, 0.0),
    "google_gripper": (0.058, 0.017),
    "rethink_gripper": (0.023, 0.0),
    "robotiq_2f140": (0.063, 0.024),
    "robotiq_2f85": (0.0425, 0.013),
    "robotiq_3f": (0.084, 0.0),
    "schunk_wsg32": (0.028, 0.0),
    "vx300s_gripper": (0.036, 0.0),
}


@pytest.fixture(scope="module", params=OWN_JAWS)
def gripper(request: pytest.FixtureRequest) -> Gripper:
    """Every shipped gripper in turn."""
    return load_gripper(request.param)


def test_registry_lists_shipped() -> None:
    """The checkout's grippers are found by name; unknown names list them."""
    assert set(OWN_JAWS) <= set(list_grippers())
    with pytest.raises(UnknownGripperError) as error:
        load_gripper("robotiq_2f58")
    assert "robotiq_2f85" in str(error.value)
    assert error.value.code == 200


def test_registry_adds_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """MEGRASP_GRIPPER_PATH and extra paths add grippers, and come before the shipped ones."""
    source = gripper_folders()["franka_hand"]
    shutil.copytree(source, tmp_path / "franka_hand")
    shutil.copytree(source, tmp_path / "misnamed")
    assert gripper_folders([tmp_path])["franka_hand"] == tmp_path / "franka_hand"
    monkeypatch.setenv("MEGRASP_GRIPPER_PATH", str(tmp_path))
    assert "misnamed" in list_grippers()
    with pytest.raises(DescriptionError, match="registered name, is called 'misnamed'"):
        load_gripper("misnamed")
    assert load_gripper(tmp_path / "misnamed").name == "franka_hand"


def test_yaml_round_trip(gripper: Gripper, tmp_path: Path) -> None:
    """What is written is what was read; the hash depends on the contents, not on the place."""
    folder = tmp_path / gripper.name
    shutil.copytree(gripper.description.folder, folder)
    save_description(gripper.description, folder)
    again = load_description(folder)
    assert again.to_dict() == gripper.description.to_dict()
    assert Gripper(again).hash == gripper.hash
    model = folder / "model.xml"
    model.write_text(model.read_text().replace("</mujoco>", "<!-- other --></mujoco>"))
    assert Gripper(again).hash != gripper.hash


def test_frames(gripper: Gripper) -> None:
    """Fingers lie ahead along +Z, the first group on -X, and close along X towards each other."""
    np.testing.assert_allclose(gripper.tcp, [0, 0, TCP[gripper.name]])
    np.testing.assert_allclose(gripper.gripper_from_tcp[:3, 3], gripper.tcp)
    points, groups = gripper.collision_points()
    assert points[groups >= 0, 2].max() > gripper.tcp[2] > points[groups < 0, 2].max()
    for group, side in ((0, -1.0), (1, 1.0)):
        tips = points[(groups == group) & (np.abs(points[:, 2] - gripper.tcp[2]) < 0.01)]
        assert (side * tips[:, 0] > OPENING[gripper.name] / 2 - 0.003).all()
        moved = pad_displacement(gripper, group)
        inwards, forward = CLOSING[gripper.name]
        assert -side * moved[0] == pytest.approx(inwards, abs=0.003)
        assert abs(moved[1]) < 0.001
        assert moved[2] == pytest.approx(forward, abs=0.002)


def test_opening(gripper: Gripper) -> None:
    """The clear width is the data sheet's; max_width does not promise more."""
    width = opening(gripper)
    assert width == pytest.approx(OPENING[gripper.name], abs=0.002)
    assert gripper.description.max_width is not None
    assert width >= gripper.description.max_width - 1e-6


def test_clouds(gripper: Gripper) -> None:
    """Deterministic for a seed, on the surface, outer surface only, postures differ."""
    clouds = gripper.clouds(512, seed=3)
    fresh = load_gripper(gripper.name).clouds(512, seed=3)
    np.testing.assert_array_equal(clouds.open_points, fresh.open_points)
    np.testing.assert_array_equal(clouds.closed_normals, fresh.closed_normals)
    assert not np.array_equal(clouds.open_points, gripper.clouds(512, seed=4).open_points)
    assert clouds.open_points.shape == clouds.closed_points.shape == (512, 3)
    np.testing.assert_allclose(np.linalg.norm(clouds.open_normals, axis=1), 1.0, atol=1e-6)
    assert surface_distance(clouds.open_points, gripper.meshes("open")).max() < 1e-5
    assert surface_distance(clouds.closed_points, gripper.meshes("open")).max() > 0.02


def test_displacement_leads_to_the_closed_surface(gripper: Gripper) -> None:
    """Open points plus displacement lie on the closed gripper; the palm does not move."""
    clouds = gripper.clouds(512)
    there = clouds.open_points + clouds.displacement
    assert surface_distance(there, gripper.meshes("closed")).max() < 5e-5
    back = clouds.closed_points - clouds.closed_displacement
    assert surface_distance(back, gripper.meshes("open")).max() < 5e-5
    speed = np.linalg.norm(clouds.displacement, axis=1)
    assert (speed[clouds.open_points[:, 2] < 0.03] < 1e-9).all()
    assert speed.max() > 0.9 * CLOSING[gripper.name][0]


def test_normals_point_outwards(gripper: Gripper) -> None:
    """From a point a step along its normal, at least one direction leads out without a hit."""
    from megrasp_core.grippers.render import SurfaceSample, visible

    clouds = gripper.clouds(256)
    index = np.zeros(256, np.int64)
    stepped = clouds.open_points + 2e-4 * clouds.open_normals
    seen = visible(gripper.meshes("open"), SurfaceSample(stepped, clouds.open_normals, index))
    assert len(seen.points) >= 250
    buried = clouds.open_points - 5e-4 * clouds.open_normals
    hidden = visible(gripper.meshes("open"), SurfaceSample(buried, clouds.open_normals, index))
    assert len(hidden.points) < 10


def test_tokens(gripper: Gripper) -> None:
    """TCP coordinates, half of each posture within 8 cm of the TCP, flags in order."""
    tokens = gripper.tokens()
    assert tokens.points.shape == tokens.normals.shape == tokens.displacement.shape == (64, 3)
    np.testing.assert_array_equal(tokens.closed, np.repeat([0.0, 1.0], 32))
    for closed in (0.0, 1.0):
        # A wide gripper's open fingers are further away: half as far again as the nearest counts.
        radius = 0.08 if closed else max(0.08, 1.5 * 0.5 * OPENING[gripper.name])
        near = np.linalg.norm(tokens.points[tokens.closed == closed], axis=1) <= radius
        assert near.sum() >= 16
    first = tokens.points[tokens.closed == 0.0] + gripper.tcp
    assert surface_distance(first, gripper.meshes("open")).max() < 1e-5
    assert gripper.tokens() is tokens


def test_collision_points(gripper: Gripper) -> None:
    """On the collision surface, evenly spaced, all finger groups present, palm marked -1."""
    points, groups = gripper.collision_points(0.006)
    assert surface_distance(points, gripper.meshes("open", "collision")).max() < 1e-5
    assert set(groups) == {-1, 0, 1}
    assert len(points) > 800
    fewer, _ = gripper.collision_points(0.012)
    assert 2.5 < len(points) / len(fewer) < 5.5


def test_wrong_requests(gripper: Gripper) -> None:
    """Wrong arguments name the valid ones."""
    with pytest.raises(InvalidRequestError, match="expected one of open, closed"):
        gripper.control("ajar")
    with pytest.raises(InvalidRequestError, match="expected 'visual' or 'collision'"):
        gripper.meshes("open", "both")
    with pytest.raises(InvalidRequestError, match="finger group 7"):
        gripper.pad_points("open", 7)


def test_travels_between_processes(gripper: Gripper) -> None:
    """A pickled gripper is the same gripper."""
    again = pickle.loads(pickle.dumps(gripper))
    assert again.hash == gripper.hash
    assert again.closed_joints == gripper.closed_joints


def test_symmetry_residual(gripper: Gripper) -> None:
    """Some turn into themselves; the Franka's and Schunk's flange side and the Rethink's hump do
    not, and the check says so; the 3F claims nothing.
    """
    residual = symmetry_residual(gripper)
    warnings = check_gripper(gripper.description.folder).warnings
    if gripper.name == "robotiq_3f":
        assert residual == 0.0
        assert symmetry_residual(gripper, order=2) > 0.010
    elif gripper.name in ("franka_hand", "rethink_gripper", "schunk_wsg32"):
        assert 0.003 < residual < 0.010
        assert any("symmetry 2" in text for text in warnings)
    else:
        assert residual < 0.003
        assert not warnings


def test_check_passes(gripper: Gripper) -> None:
    """`gripper check` finds nothing wrong and measures the opening."""
    result = check_gripper(gripper.description.folder)
    assert result.ok, result.errors
    assert result.measures["opening"] == pytest.approx(OPENING[gripper.name], abs=0.002)


def test_check_finds_swapped_fingers_and_swapped_postures(tmp_path: Path) -> None:
    """Mistakes that load, but cannot be meant, are errors of the check."""
    shutil.copytree(gripper_folders()["franka_hand"], tmp_path / "a")
    file = tmp_path / "a" / "gripper.yaml"
    text = file.read_text()
    file.write_text(
        text.replace("[left_finger]", "[x]")
        .replace("[right_finger]", "[left_finger]")
        .replace("[x]", "[right_finger]")
    )
    assert any("the first group must be on -X" in error for error in check_gripper(file).errors)
    file.write_text(
        text.replace("open:", "x:").replace("closed:", "open:").replace("x:", "closed:")
    )
    assert any("approach each other by -80.0 mm" in error for error in check_gripper(file).errors)
    file.write_text(text.replace("tcp: [0, 0, 0.1034]", "tcp: [0, 0, 0.02]"))
    assert any("lies in front of the TCP" in error for error in check_gripper(file).errors)
    file.write_text(text.replace("format: 1", "format: 9"))
    assert check_gripper(file).errors == [f"{file}: 'format' must be 1, got 9"]


def test_picture(gripper: Gripper, tmp_path: Path) -> None:
    """The picture is a PNG that is not blank."""
    from PIL import Image

    file = gripper_picture(gripper, tmp_path / "out" / "g.png")
    pixels = np.asarray(Image.open(file).convert("L"))
    assert pixels.shape[0] > 500
    assert 0.02 < (pixels < 200).mean() < 0.6
