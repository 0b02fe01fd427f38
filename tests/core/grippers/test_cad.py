"""CAD descriptions: found where MEGRASP_ASSETS is set; the loader deals with what is wrong in the
files. What each of them has to do: tests/simulation/test_registered.py.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest
from gripper_cases import SENSIBLE, slide_pair

from megrasp_core.errors import DescriptionError, UnknownGripperError
from megrasp_core.gripper_tools.check import check_gripper
from megrasp_core.grippers import (
    Gripper,
    cad_folders,
    gripper_folders,
    list_grippers,
    load_gripper,
)

JAWS = {
    "franka_hand_cad",
    "google_gripper_cad",
    "rethink_gripper_cad",
    "robotiq_2f140_cad",
    "robotiq_2f140_mjcf_cad",
    "robotiq_2f85_cad",
    "robotiq_3f_cad",
    "schunk_wsg32_cad",
    "schunk_wsg50_cad",
    "vx300s_gripper_cad",
}

IMPOSSIBLE = {
    "micrograms": 'mass="3e-9" pos="0 0 0" diaginertia="1e-12 1e-12 1e-12"',
    "too heavy": 'mass="9" pos="0 0 0" diaginertia="3e-3 3e-3 5e-4"',
    "a square metre": 'mass="0.02" pos="0 0 0" diaginertia="1 1 1"',
    "a point": 'mass="0.02" pos="0 0 0" diaginertia="3e-10 2e-10 2e-10"',
    "another link's centre": 'mass="0.02" pos="0.06 0 0" diaginertia="7e-6 7e-6 1e-6"',
}


def pair(folder: Path, left: str = SENSIBLE, friction: float = 0.0) -> Gripper:
    """Load the pair of slides, the left one with the given inertia and joint friction."""
    return slide_pair(folder, left=left, friction=friction)


@pytest.mark.parametrize("inertial", IMPOSSIBLE.values(), ids=IMPOSSIBLE)
def test_impossible_masses_are_replaced(tmp_path: Path, inertial: str) -> None:
    """By that of a box around the geom; a mass that can be is kept."""
    gripper = pair(tmp_path, inertial)
    body = gripper.model.body("left")
    mass = float(body.mass[0])
    kept = 'mass="0.02"' in inertial
    assert mass == pytest.approx(0.02 if kept else 600 * 8 * 0.005 * 0.01 * 0.03)
    np.testing.assert_allclose(body.ipos, 0.0, atol=1e-9)
    expected = mass / 3 * np.array([0.01**2 + 0.03**2, 0.005**2 + 0.03**2, 0.005**2 + 0.01**2])
    np.testing.assert_allclose(body.inertia, expected, rtol=1e-6)
    again = gripper.spec().compile()
    np.testing.assert_allclose(again.body_mass, gripper.model.body_mass)
    assert gripper.model.body("right").mass[0] == pytest.approx(0.02)


def test_sensible_masses_are_kept(tmp_path: Path) -> None:
    """The numbers of the file, also in every own description."""
    body = pair(tmp_path).model.body("left")
    assert body.mass[0] == pytest.approx(0.02)
    np.testing.assert_allclose(np.sort(body.inertia), [1e-6, 7e-6, 7e-6])
    for name in set(list_grippers()) - set(cad_folders()):
        gripper = load_gripper(name)
        raw = mujoco.MjModel.from_xml_path(str(gripper.description.model_path))
        assert gripper.model.body_mass.sum() == pytest.approx(raw.body_mass.sum()), name


def test_friction_that_stops_the_drive_is_removed(tmp_path: Path) -> None:
    """A drive of 40 N cannot move a joint with 100 N of friction; less friction stays."""
    stuck = pair(tmp_path, friction=100.0)
    assert stuck.model.joint("left").frictionloss[0] == 0.0
    assert check_gripper(tmp_path).ok
    assert pair(tmp_path, friction=5.0).model.joint("left").frictionloss[0] == 5.0


def test_listed_with_assets_only(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Without MEGRASP_ASSETS they are not listed, and asking for one says what to set."""
    monkeypatch.setenv("MEGRASP_ASSETS", str(tmp_path))
    assert set(list_grippers()) >= JAWS
    monkeypatch.delenv("MEGRASP_ASSETS")
    assert not any(name.endswith("_cad") for name in list_grippers())
    assert set(cad_folders()) >= JAWS
    with pytest.raises(DescriptionError, match="MEGRASP_ASSETS is not set"):
        load_gripper("robotiq_2f85_cad")
    with pytest.raises(UnknownGripperError) as error:
        load_gripper("robotiq_2f99_cad")
    assert "robotiq_2f85_cad" not in str(error.value)


def test_cad_folder_of_a_search_path(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A folder `cad` beside one's own grippers is searched alike."""
    shutil.copytree(cad_folders()["franka_hand_cad"], tmp_path / "cad" / "franka_hand_cad")
    monkeypatch.setenv("MEGRASP_ASSETS", str(tmp_path))
    folder = gripper_folders([tmp_path])["franka_hand_cad"]
    assert folder == tmp_path / "cad" / "franka_hand_cad"
