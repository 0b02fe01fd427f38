"""Models as strangers bring them: jaws, hulls, repeats, mocap, suction, empty limits."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from wizard_models import chain_fingers, couplings, mjcf, single_jaw, slides

from megrasp_core.cli import main
from megrasp_core.errors import DescriptionError
from megrasp_core.gripper_tools.check import check_gripper
from megrasp_core.gripper_tools.plain_jaws import JAW_KINDS, plain_jaw, write_plain_jaw
from megrasp_core.gripper_tools.wizard import (
    ModelRequest,
    NewGripper,
    Overrides,
    SourceOptions,
    new_gripper,
)
from megrasp_core.gripper_tools.wizard.score import compare_with_facts, within_limits
from megrasp_core.grippers import Gripper

SUCTION = r"suction tools are not supported; grippers need two fingers that close"
HULL = (
    '<link name="hull"><collision><geometry><box size="0.2 0.1 0.2"/></geometry></collision>'
    '</link><joint name="fix" type="fixed"><parent link="palm"/><child link="hull"/>'
    '<origin xyz="0 0 0.07"/></joint>'
)


def made(
    folder: Path, text: str, name: str = "model.urdf", overrides: Overrides | None = None,
    **source: object,
) -> NewGripper:  # fmt: skip
    """Write a model and run the wizard on it, without a picture."""
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(text)
    options = SourceOptions(**source)  # type: ignore[arg-type]
    request = ModelRequest(folder / name, folder / "out", options, overrides or Overrides())
    return new_gripper(request, picture=False)


@pytest.mark.parametrize("kind", JAW_KINDS)
def test_plain_jaws_are_understood(tmp_path, kind):
    """Axes and TCP of a drawn jaw of each kind, the same from one seed."""
    jaw = plain_jaw(kind, 5, seed=3)
    assert jaw.urdf == plain_jaw(kind, 5, seed=3).urdf != plain_jaw(kind, 5, seed=4).urdf
    model = write_plain_jaw(jaw, tmp_path / "in")
    result = new_gripper(ModelRequest(model, tmp_path / "out"), picture=False)
    angles = compare_with_facts(result.description, jaw.facts())
    assert within_limits(False, *angles), angles
    assert not result.errors


@pytest.mark.parametrize("high", [0.9, 1.92, 3.14])
def test_wide_limits_open_a_single_jaw_as_far_as_pads_look(tmp_path, high):
    """Beyond about a radian a pad no longer looks at the other: that is no open posture."""
    result = made(tmp_path, single_jaw(-0.17, high))
    axes = result.analysis.axes
    assert abs(axes.closing[0]) == pytest.approx(1.0, abs=0.02)
    assert axes.approach == pytest.approx([0, 0, 1], abs=0.02)
    assert result.analysis.tcp == pytest.approx([0, 0, 0.112], abs=0.01)
    opened, closed = result.description.open.joints, result.description.closed.joints
    assert opened is not None and closed is not None
    assert 0.7 < opened["turn"] < 1.0 and closed["turn"] < 0.0
    assert not result.errors


def test_given_postures_limit_the_motion(tmp_path):
    """The axes come from what lies between the given postures, not from the whole range."""
    given = Overrides(open={"turn": 0.5}, closed={"turn": -0.08})
    result = made(tmp_path, single_jaw(-0.17, 1.92), overrides=given)
    assert result.analysis.axes.approach == pytest.approx([0, 0, 1], abs=0.02)
    assert result.description.open.joints == {"turn": 0.5}
    assert result.description.closed.joints == {"turn": -0.08}
    one = made(tmp_path / "one", single_jaw(-0.17, 1.92), overrides=Overrides(open={"turn": 0.5}))
    assert one.description.open.joints == {"turn": 0.5}
    assert one.description.closed.joints is not None
    assert one.description.closed.joints["turn"] < 0.0


def test_same_postures_are_an_error(tmp_path):
    """Nothing closes between a posture and itself."""
    given = Overrides(open={"turn": 0.5}, closed={"turn": 0.5})
    with pytest.raises(DescriptionError, match="--open and --closed are the same posture"):
        made(tmp_path, single_jaw(-0.17, 0.9), overrides=given)


@pytest.mark.parametrize("stroke", [0.002, 0.04])
def test_new_and_check_say_the_same(tmp_path, capsys, stroke):
    """One function of findings: an opening under 5 mm is an error of both, a good one of none."""
    (tmp_path / "model.urdf").write_text(slides(stroke))
    out = tmp_path / "out"
    code = main(["gripper", "new", str(tmp_path / "model.urdf"), "--out", str(out), "--yes"])
    said = [line for line in capsys.readouterr().out.splitlines() if "finding: " in line]
    assert main(["gripper", "check", str(out)]) == code == int(stroke < 0.005)
    checked = capsys.readouterr()
    text = checked.out + checked.err
    assert [line for line in text.splitlines() if line.startswith("finding: ")] == said
    assert len(said) == int(stroke < 0.005)
    assert all("expected at least 5 mm" in line for line in said)


@pytest.mark.parametrize(
    ("old", "new", "note"),
    [
        ("<limit", '<limit lower="0" upper="0.04" effort="1" velocity="1"/><limit', "<limit>"),
        ("<axis", '<axis xyz="-1 0 0"/><axis', "<axis>"),
        ("<axis", '<dynamics damping="1"/><dynamics damping="2"/><axis', "<dynamics>"),
    ],
)
def test_repeated_elements_count_once(tmp_path, old, new, note):
    """The first is taken, as ROS parsers do, and that is said."""
    result = made(tmp_path, slides(0.04).replace(old, new, 1))
    assert result.notes == [f"joint 'left' has 2 {note}; the first is taken"]
    assert result.description.max_width == pytest.approx(0.08, abs=1e-3)


def test_same_names_are_named(tmp_path):
    """Two links of one name are no repeat: the name and the file are said."""
    text = slides(0.04).replace('"fr"', '"fl"')
    with pytest.raises(DescriptionError, match=r"model.urdf: two elements <link> have the name"):
        made(tmp_path, text)


@pytest.mark.parametrize("seen", [False, True])
def test_hull_around_the_fingers_is_left_out(tmp_path, seen):
    """A safety hull on the palm, whether it is shown or not; its note names it."""
    hull = HULL.replace("<collision>", "<visual>").replace("</collision>", "</visual>")
    both = HULL.replace("</link>", hull[hull.index("<visual>") : hull.index("</link>") + 7])
    text = slides(0.04).replace("</robot>", (both if seen else HULL) + "</robot>")
    result = made(tmp_path, text)
    assert "'hull'" in result.notes[0] and "encloses the fingers" in result.notes[0]
    assert not result.errors
    points = Gripper(result.description).clouds(200).open_points
    assert np.abs(points[:, 0]).max() < 0.07


def test_marker_is_left_out(tmp_path):
    """A cube at the TCP that is fastened to nothing."""
    cube = HULL.replace("hull", "cube").replace("0.2 0.1 0.2", "0.02 0.02 0.02")
    result = made(
        tmp_path, slides(0.04).replace("</robot>", cube.replace("0.07", "0.11") + "</robot>")
    )
    assert result.notes == ["link 'cube' touches nothing of the palm (a marker?): left out"]
    assert not result.errors


def test_drawn_axes_are_left_out(tmp_path):
    """Bars of any length at the TCP that are only seen, and touch nothing."""
    bars = ""
    for axis in np.eye(3):
        size, centre = (" ".join(map(str, v)) for v in (0.002 + 0.1 * axis, 0.05 * axis))
        bars += (
            f'<visual><origin xyz="{centre}"/><geometry><box size="{size}"/></geometry></visual>'
        )
    marker = HULL[HULL.index("</link>") :].replace("hull", "axes").replace("0.07", "0.11")
    text = slides(0.04).replace("</robot>", f'<link name="axes">{bars}{marker}</robot>')
    result = made(tmp_path, text)
    assert result.notes == ["link 'axes' touches nothing of the palm (a marker?): left out"]
    assert result.analysis.axes.approach == pytest.approx([0, 0, 1])


def test_links_are_left_out_by_option(tmp_path):
    """`without` names links whose shapes are no part; an unknown one is refused."""
    shield = HULL.replace("hull", "shield").replace("0.2 0.1 0.2", "0.1 0.1 0.01")
    text = slides(0.04).replace("</robot>", shield.replace("0.07", "0.13") + "</robot>")
    assert made(tmp_path / "a", text).errors
    assert not made(tmp_path / "b", text, without=("shield",)).errors
    with pytest.raises(DescriptionError, match=r"--without names the link 'door'.*valid links"):
        made(tmp_path / "c", text, without=("door",))


def without_collision(text: str) -> str:
    """Return a URDF without its collision geometry."""
    return re.sub(r"<collision>.*?</collision>", "", text)


def test_visual_shapes_stand_in_for_collision(tmp_path):
    """A model without any collision geometry touches with what is seen."""
    result = made(tmp_path, without_collision(slides(0.04)))
    assert "their visual shapes taken (meshes as hulls): palm, fl, fr" in result.notes[0]
    assert not result.errors
    assert not check_gripper(tmp_path / "out").errors


def test_gripper_without_surface_is_a_bad_description(tmp_path):
    """A description written by hand for a visual-only model: no traceback, and what to do."""
    made(tmp_path, slides(0.04))
    model = tmp_path / "out" / "model.xml"
    bare = re.sub(r' (contype|conaffinity)="\d"', "", model.read_text())
    model.write_text(bare.replace("<geom ", '<geom contype="0" conaffinity="0" '))
    with pytest.raises(DescriptionError, match=r"collision geometry.*`megrasp gripper new"):
        Gripper.from_path(model.parent).collision_points(0.004)
    assert any("takes the visual shapes" in error for error in check_gripper(model.parent).errors)


@pytest.mark.parametrize(("low", "high"), [(0.0, 0.0), (-2.0, 2.0)])
def test_limits_that_say_nothing(tmp_path, monkeypatch, capfd, low, high):
    """One note, and nothing of MuJoCo's on the terminal or in the folder."""
    monkeypatch.chdir(tmp_path)
    text = slides(0.04).replace('lower="0" upper="0.04"', f'lower="{low}" upper="{high}"')
    text = text.replace('<mimic joint="left"/>', "")
    result = made(tmp_path, text)
    if low == 0.0:
        assert result.notes == ["limits 0 to 0 taken as none: left, right"]
    assert result.description.max_width == pytest.approx(0.1, abs=1e-2)
    assert not result.errors
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()
    assert capfd.readouterr() == ("", "")


def test_fragment_names_the_model_that_includes_it(tmp_path):
    """An include file is no model."""
    (tmp_path / "whole.xml").write_text('<mujoco><include file="part.xml"/></mujoco>')
    with pytest.raises(DescriptionError, match=r"part.xml is an include file.*: whole.xml"):
        made(tmp_path, "<mujocoinclude/>", "part.xml")


def test_mocap_bodies(tmp_path):
    """What is dragged about in a viewer goes; the gripper itself stays, mounted."""
    palm = chain_fingers([(-0.035, 0.0, 0.0), (0.035, 0.0, np.pi)])
    free = palm.replace('<body name="palm">', '<body name="palm"><freejoint/>')
    target = (
        '<body name="target" mocap="true"><geom size="0.01" contype="0" conaffinity="0"/></body>'
    )
    weld = '<equality><weld body1="target" body2="palm"/></equality>'
    result = made(tmp_path / "a", mjcf(target + free, weld), "a.xml")
    assert "mocap bodies and what is welded to them left out: target" in result.notes
    carried = palm.replace('<body name="palm">', '<body name="palm" mocap="true">')
    result = made(tmp_path / "b", mjcf(carried), "a.xml")
    assert "mocap body 'palm' carries the fingers: taken as mounted" in result.notes


CUP = (
    '<body name="{0}" pos="{1} 0 0.03"><joint name="up_{0}" type="slide" axis="0 0 1" '
    'range="-0.01 0.01"/><geom type="cylinder" size="0.01 0.015" pos="0 0 0.015"/></body>'
)
PLATE = '<body name="plate"><geom type="box" size="0.06 0.03 0.028"/>{}</body>'


@pytest.mark.parametrize(
    "body",
    [
        PLATE.format(""),
        PLATE.format(CUP.format("one", 0)),
        PLATE.format(CUP.format("one", -0.04) + CUP.format("two", 0.04)),
    ],
)
def test_suction_tools_are_refused(tmp_path, body):
    """Rigid, one bellows, several: each with the reason."""
    with pytest.raises(DescriptionError, match=SUCTION):
        made(tmp_path, mjcf(body), "a.xml")


THREE = [(-0.035, -0.022, 0.0), (-0.035, 0.022, 0.0), (0.035, 0.0, np.pi)]


def test_coupled_joints_stay_within_their_limits(tmp_path):
    """A drive goes only as far as the joints coupled to it may."""
    result = made(tmp_path, mjcf(chain_fingers(THREE), couplings(3)), "a.xml")
    assert {frozenset(group) for group in result.description.fingers} == {
        frozenset({"f0", "f1"}),
        frozenset({"f2"}),
    }
    opened = Gripper(result.description).open_joints
    assert all(opened[f"q{k}"] > -1e-3 for k in range(3))
    assert not result.errors
    assert result.analysis.axes.approach == pytest.approx([0, 0, 1], abs=0.02)


def test_joints_on_springs_get_no_drive(tmp_path):
    """Distal joints that only a spring holds rest where it does; fingers keep to their sides."""
    result = made(tmp_path, mjcf(chain_fingers(THREE, springs=True)), "a.xml")
    assert set(result.description.actuation) == {"p0", "p1", "p2"}
    assert result.description.open.joints is not None
    assert result.description.open.joints["q0"] == pytest.approx(0.1)
    assert len(min(result.description.fingers, key=len)) == 1
    assert result.analysis.axes.closing == pytest.approx([1, 0, 0], abs=0.02)
    assert result.analysis.tcp == pytest.approx([0, 0, 0.108], abs=0.01)


def test_finger_in_the_way_is_named(tmp_path):
    """A given closed posture that one finger keeps another from."""
    spec = [(-0.04, 0.0, 0.0), (-0.012, 0.0, 0.0), (0.04, 0.0, np.pi)]
    joints = {f"{kind}{k}": value for k in range(3) for kind, value in (("p", 0.0), ("q", 0.0))}
    given = Overrides(open=joints, closed={**joints, "p0": 1.0, "p2": 0.2})
    result = made(tmp_path, mjcf(chain_fingers(spec)), "a.xml", given)
    assert any("'f0' runs into finger 'f1' after" in note for note in result.notes)
