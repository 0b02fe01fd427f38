"""The shipped grippers: frames, opening, motion, tokens, registry. What every registered gripper
has to do: tests/simulation/test_registered.py.
"""

from __future__ import annotations

import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
from gripper_cases import OWN_JAWS

from megrasp_core.drawing.gripper_picture import gripper_picture
from megrasp_core.errors import DescriptionError, InvalidRequestError, UnknownGripperError
from megrasp_core.gripper_tools.check import check_gripper
from megrasp_core.gripper_tools.compare import opening, pad_displacement, surface_distance
from megrasp_core.gripper_tools.symmetry import symmetry_residual
from megrasp_core.grippers import Gripper, gripper_folders, list_grippers, load_gripper

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


def test_hash_depends_on_the_contents(tmp_path: Path) -> None:
    """Not on the place: a copy has the same, a copy with another model another."""
    gripper = load_gripper("franka_hand")
    folder = shutil.copytree(gripper.description.folder, tmp_path / "copy")
    assert Gripper.from_path(folder).hash == gripper.hash
    model = folder / "model.xml"
    model.write_text(model.read_text().replace("</mujoco>", "<!-- other --></mujoco>"))
    assert Gripper.from_path(folder).hash != gripper.hash


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


def test_tokens(gripper: Gripper) -> None:
    """TCP coordinates, half of each posture within 8 cm of the TCP."""
    tokens = gripper.tokens()
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


def test_picture(gripper: Gripper, tmp_path: Path) -> None:
    """The picture is a PNG that is not blank."""
    from PIL import Image

    file = gripper_picture(gripper, tmp_path / "out" / "g.png")
    pixels = np.asarray(Image.open(file).convert("L"))
    assert pixels.shape[0] > 500
    assert 0.02 < (pixels < 200).mean() < 0.6
