"""The strict loader: every mistake has its own message, word for word."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from megrasp_core.errors import DescriptionError
from megrasp_core.grippers import Gripper, load_description, save_description

MODEL = """<mujoco><worldbody><body name="palm">
  <geom type="box" size="0.05 0.02 0.03"/>
  <body name="left" pos="-0.03 0 0.06">
    <joint name="slide_l" type="slide" axis="1 0 0" range="0 0.03"/>
    <geom type="box" size="0.004 0.01 0.03"/></body>
  <body name="right" pos="0.03 0 0.06">
    <joint name="slide_r" type="slide" axis="-1 0 0" range="0 0.03"/>
    <geom type="box" size="0.004 0.01 0.03"/></body>
</body></worldbody>
<actuator><position name="drive" joint="slide_l" kp="100" ctrlrange="0 0.03"/></actuator></mujoco>
"""
GOOD: dict[str, Any] = {
    "format": 1,
    "name": "tiny",
    "display_name": "Tiny",
    "kind": "parallel",
    "model": "model.xml",
    "mount_from_model": {"xyz": [0, 0, 0], "quat": [0, 0, 0, 1]},
    "tcp": [0, 0, 0.08],
    "postures": {
        "open": {"joints": {"slide_l": 0.0, "slide_r": 0.0}},
        "closed": {"joints": {"slide_l": 0.026, "slide_r": 0.026}},
    },
    "actuation": {"slide_r": {"kp": 2000, "force": 40}},
    "max_width": 0.052,
    "min_width": 0.0,
    "fingers": [["left"], ["right"]],
    "symmetry": 2,
    "licence": "Apache-2.0",
    "source": "test",
}
Edit = Callable[[dict[str, Any]], object]


def write(folder: Path, edit: Edit | None = None) -> Path:
    """Write the good gripper, changed by `edit`, into a folder."""
    data = copy.deepcopy(GOOD)
    if edit:
        edit(data)
    (folder / "gripper.yaml").write_text(yaml.safe_dump(data, sort_keys=False))
    (folder / "model.xml").write_text(MODEL)
    return folder


def put(path: str, value: Any) -> Edit:
    """Return an edit that sets the field at a dotted path."""

    def edit(data: dict[str, Any]) -> None:
        *outer, last = path.split(".")
        for key in outer:
            data = data[key]
        data[last] = value

    return edit


FIELDS = (
    "format, name, display_name, kind, model, mount_from_model, tcp, postures, actuation, "
    "max_width, "
    "min_width, fingers, symmetry, licence, source"
)
LOADER_CASES: list[tuple[Edit, str]] = [
    (
        put("tpc", [0, 0, 1]),
        f"the description has an unknown field 'tpc'; valid fields: {FIELDS}, flange_from_gripper",
    ),
    (
        lambda d: d.pop("tcp"),
        f"the description lacks the field 'tcp'; required fields: {FIELDS}",
    ),
    (put("format", 2), "'format' must be 1, got 2"),
    (put("name", "No Spaces"), "'name' must consist of a-z, 0-9 and _, got 'No Spaces'"),
    (put("kind", "claw"), "'kind' is 'claw'; valid choices: parallel, adaptive, hand"),
    (put("licence", ""), "'licence' must be a text that is not empty, got '' (str)"),
    (put("model", "m.stl"), "'model' must end in one of .urdf, .xml, .mjcf, got 'm.stl'"),
    (put("tcp", [0, 0]), "'tcp' must be a list of 3 finite numbers, got [0, 0]"),
    (put("tcp", [0, 0, "a"]), "'tcp' must be a list of 3 finite numbers, got [0, 0, 'a']"),
    (
        put("tcp", [0, 0, -0.1]),
        "'tcp' must lie in front of the palm (z > 0 in the gripper frame), got z = -0.1",
    ),
    (
        put("mount_from_model.quat", [0, 0, 0.7, 0.7]),
        "'mount_from_model.quat' must be a unit quaternion [x, y, z, w], got [0, 0, 0.7, 0.7] of "
        "norm 0.9899",
    ),
    (
        put("mount_from_model.rpy", [0, 0, 0]),
        "'mount_from_model' has an unknown field 'rpy'; valid fields: xyz, quat",
    ),
    (put("mount_from_model", 3), "'mount_from_model' must be a mapping of fields, got 3 (int)"),
    (
        put("postures.open.actuators", {"drive": 0}),
        "'postures.open' must hold exactly one of: joints, actuators; got joints and actuators",
    ),
    (
        put("postures.open", {}),
        "'postures.open' must hold exactly one of: joints, actuators; got neither",
    ),
    (
        put("postures.half", {}),
        "'postures' has an unknown field 'half'; valid fields: open, closed",
    ),
    (put("postures.open.joints", {}), "'postures.open.joints' must not be empty"),
    (
        put("postures.open.joints.slide_l", "far"),
        "'postures.open.joints.slide_l' must be a finite number, got 'far' (str)",
    ),
    (put("max_width", None), "'max_width' may be null for hands only; kind is 'parallel'"),
    (put("max_width", 0), "'max_width' must be greater than 0, got 0"),
    (put("min_width", 0.06), "'min_width' must be less than max_width 0.052, got 0.06"),
    (put("min_width", -1), "'min_width' must be at least 0, got -1"),
    (put("symmetry", 0), "'symmetry' must be a whole number of at least 1, got 0"),
    (
        put("fingers", [["left"]]),
        "'fingers' must be at least two lists of link names, opposing groups, the first on -X; "
        "got [['left']]",
    ),
    (put("fingers", [["left"], ["left"]]), "'fingers' names the link 'left' more than once"),
    (
        put("actuation.slide_r.kd", 1),
        "'actuation.slide_r' has an unknown field 'kd'; valid fields: kp, force, damping, "
        "armature",
    ),
    (
        put("actuation.slide_r", {"kp": 1}),
        "'actuation.slide_r' lacks the field 'force'; required fields: kp, force",
    ),
    (put("actuation.slide_r.kp", 0), "'actuation.slide_r.kp' must be greater than 0, got 0"),
]
MODEL_CASES: list[tuple[Edit, str]] = [
    (
        put("postures.open.joints", {"slide_l": 0.0}),
        "'postures.open.joints' lacks the joint slide_r; a posture gives every joint that no "
        "joint coupling "
        "(mimic) derives, or uses actuators",
    ),
    (
        put("postures.open.joints.wrist", 0.0),
        "'postures.open.joints' names the joint 'wrist', which the model does not have; valid "
        "joints: "
        "slide_l, slide_r",
    ),
    (
        put("postures.closed.joints.slide_l", 0.04),
        "'postures.closed.joints.slide_l' is 0.04, outside the joint's limits 0 to 0.03",
    ),
    (
        put("postures.closed", {"actuators": {"motor": 1}}),
        "'postures.closed.actuators' names the actuator 'motor', which the model does not have; "
        "valid "
        "actuators: drive, slide_r",
    ),
    (
        put("postures.closed", {"actuators": {"drive": 1}}),
        "'postures.closed.actuators.drive' is 1, outside the control range 0 to 0.03",
    ),
    (
        put("fingers", [["left"], ["thumb"]]),
        "'fingers' names the link 'thumb', which the model does not have; valid links: palm, "
        "left, right",
    ),
    (
        put("actuation.elbow", {"kp": 1, "force": 1}),
        "'actuation' names 'elbow', which is no joint or actuator of the model; valid joints: "
        "slide_l, "
        "slide_r; valid actuators: drive",
    ),
]


@pytest.mark.parametrize(("edit", "message"), LOADER_CASES)
def test_loader_message(tmp_path: Path, edit: Edit, message: str) -> None:
    """The file alone shows the mistake."""
    write(tmp_path, edit)
    with pytest.raises(DescriptionError) as error:
        load_description(tmp_path)
    assert str(error.value) == f"{tmp_path / 'gripper.yaml'}: {message}"
    assert error.value.code == 201


@pytest.mark.parametrize(("edit", "message"), MODEL_CASES)
def test_model_message(tmp_path: Path, edit: Edit, message: str) -> None:
    """The description is fine by itself but does not fit its model."""
    description = load_description(write(tmp_path, edit))
    with pytest.raises(DescriptionError) as error:
        Gripper(description)
    assert str(error.value) == f"{tmp_path / 'gripper.yaml'}: {message}"


def test_missing_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No description, no model, no assets folder."""
    with pytest.raises(
        DescriptionError, match=r"no gripper description at .*expected a gripper.yaml"
    ):
        load_description(tmp_path)
    write(tmp_path, put("model", "other.xml"))
    with pytest.raises(DescriptionError, match=r"'model' is 'other.xml', but there is no file"):
        Gripper.from_path(tmp_path)
    write(tmp_path, put("model", "asset:a/model.xml"))
    monkeypatch.delenv("MEGRASP_ASSETS", raising=False)
    with pytest.raises(DescriptionError, match="MEGRASP_ASSETS is not set"):
        Gripper.from_path(tmp_path)
    monkeypatch.setenv("MEGRASP_ASSETS", str(tmp_path))
    with pytest.raises(DescriptionError, match=r"no file .*grippers/a/model.xml"):
        Gripper.from_path(tmp_path)


def test_bad_yaml_and_bad_model(tmp_path: Path) -> None:
    """Broken YAML and broken XML are reported with the file's name."""
    write(tmp_path)
    (tmp_path / "model.xml").write_text(
        "<mujoco><worldbody><geom type='blob'/></worldbody></mujoco>"
    )
    with pytest.raises(DescriptionError, match=r"cannot read the model .*model.xml"):
        Gripper.from_path(tmp_path)
    (tmp_path / "gripper.yaml").write_text("name: [")
    with pytest.raises(DescriptionError, match="is not valid YAML"):
        load_description(tmp_path)


def test_asset_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`asset:` models are found below MEGRASP_ASSETS/grippers."""
    (tmp_path / "grippers" / "a").mkdir(parents=True)
    (tmp_path / "grippers" / "a" / "model.xml").write_text(MODEL)
    folder = tmp_path / "own"
    folder.mkdir()
    write(folder, put("model", "asset:a/model.xml"))
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
