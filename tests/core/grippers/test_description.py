"""The strict loader: assets, postures given as controls, drives, round trip.

What it says of mistakes: test_description_errors.py.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from tiny_gripper import MODEL, put, write

from megrasp_core.grippers import Gripper, load_description, save_description


def test_asset_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`asset:` models are found below MEGRASP_ASSETS/grippers."""
    (tmp_path / "grippers" / "a").mkdir(parents=True)
    (tmp_path / "grippers" / "a" / "model.xml").write_text(MODEL)
    folder = write(tmp_path / "own", put("model", "asset:a/model.xml"))
    (folder / "model.xml").unlink()
    monkeypatch.setenv("MEGRASP_ASSETS", str(tmp_path))
    assert Gripper.from_path(folder).open_joints == {"slide_l": 0.0, "slide_r": 0.0}


def test_round_trip_keeps_every_field(tmp_path: Path) -> None:
    """Saving and loading gives an equal description, with and without a flange."""
    flange = {"xyz": [0, 0, -0.01], "quat": [0.0, 0.0, 1.0, 0.0]}
    description = load_description(write(tmp_path, put("flange_from_gripper", flange)))
    save_description(description, tmp_path)
    assert load_description(tmp_path) == description
    assert description.to_dict()["flange_from_gripper"]["xyz"] == [0, 0, -0.01]


def test_actuators_settle_to_joints(tmp_path: Path) -> None:
    """A posture of controls is driven to and its joints are derived."""
    edit = put("postures.closed", {"actuators": {"drive": 0.02, "slide_r": 0.01}})
    gripper = Gripper.from_path(write(tmp_path, edit))
    assert gripper.closed_joints == pytest.approx({"slide_l": 0.02, "slide_r": 0.01}, abs=2e-4)
    assert gripper.control("closed") == pytest.approx([0.02, 0.01])


def test_actuation_restiffens_a_drive_of_the_model(tmp_path: Path) -> None:
    """Gain and bias change together, so that a control still means the same position."""
    edit = put("actuation.drive", {"kp": 5000, "force": 30})
    model = Gripper.from_path(write(tmp_path, edit)).model
    drive = model.actuator("drive")
    assert drive.gainprm[0] == pytest.approx(5000)
    assert drive.biasprm[1] == pytest.approx(-5000)
    assert list(drive.forcerange) == [-30, 30]
    added = model.actuator("slide_r")
    assert (added.gainprm[0], added.biasprm[1]) == (2000, -2000)
    assert list(added.ctrlrange) == [0, 0.03]


def test_drives_get_names_of_their_own(tmp_path: Path) -> None:
    """Where the model gives none, or gives a drive the name of another joint."""
    more = '<motor joint="slide_l"/><motor joint="slide_l"/><position name="slide_r" '
    text = MODEL.replace("<position ", more).replace('name="drive"', "")
    model = Gripper.from_path(write(tmp_path, model=text)).model
    names = [model.actuator(i).name for i in range(model.nu)]
    assert len(set(names)) == len(names)
    assert sorted(model.actuator_trnid[:, 0]) == [0, 1]
