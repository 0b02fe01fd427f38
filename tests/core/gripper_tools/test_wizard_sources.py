"""Models as strangers bring them: wrong units, missing meshes, whole robots, other formats."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from wizard_models import FINGER, arm, jaws, mjcf, two_arms, urdf

from megrasp_core.cli import main
from megrasp_core.cli.gripper.new import _Questions
from megrasp_core.errors import DescriptionError
from megrasp_core.gripper_tools.wizard import (
    Finding,
    ModelRequest,
    Overrides,
    SourceOptions,
    new_gripper,
)
from megrasp_core.gripper_tools.wizard.findings import GUESS
from megrasp_core.grippers import Gripper, load_description

WIDTH = 0.06
BALL = '<body name="a"><geom size=".02"/><body><joint type="ball" name="b"/></body></body>'


def make(model: Path, out: Path, **options: object):
    """Run the wizard with source options, without a picture."""
    source = SourceOptions(**options)  # type: ignore[arg-type]
    return new_gripper(ModelRequest(model, out, source=source), picture=False)


def test_urdf_with_mimic_and_meshes(tmp_path):
    """A plain URDF: the made folder is complete by itself."""
    model = urdf(tmp_path / "in")
    out = tmp_path / "my gripper"
    make(model, out)
    for file in (*model.parent.glob("meshes/*"), model):
        file.unlink()
    gripper = Gripper.from_path(out)
    assert gripper.name == "my_gripper"
    assert gripper.description.max_width == pytest.approx(WIDTH, abs=1e-3)
    assert gripper.closed_joints["right"] == pytest.approx(-gripper.closed_joints["left"])
    assert json.loads((out / "report.json").read_text())["errors"] == []


def test_meshes_in_millimetres_are_scaled(tmp_path):
    """Joints in metres and meshes in millimetres, as exporters leave it."""
    result = make(urdf(tmp_path / "in", mesh_unit=1000.0), tmp_path / "out")
    assert result.description.max_width == pytest.approx(WIDTH, abs=1e-3)
    assert any("scaled by 0.001" in note for note in result.notes)


def test_model_in_millimetres_is_refused_or_scaled(tmp_path):
    """Everything in millimetres: the message says the option, the option and consent work."""
    model = urdf(tmp_path / "in", mesh_unit=1000.0, unit=1000.0)
    with pytest.raises(DescriptionError, match=r"millimetres.*--scale 0.001"):
        make(model, tmp_path / "a")
    assert not (tmp_path / "a").exists()
    scaled = make(model, tmp_path / "b", scale=0.001).description
    assert scaled.max_width == pytest.approx(WIDTH, abs=1e-3)
    request = ModelRequest(model, tmp_path / "c")
    agreed = new_gripper(request, accept_scale=lambda factor: factor == 0.001, picture=False)
    assert agreed.description.max_width == pytest.approx(WIDTH, abs=1e-3)


def test_absurd_size_is_refused(tmp_path):
    """Neither metres nor millimetres: centimetres are not guessed but offered."""
    model = urdf(tmp_path / "in", mesh_unit=100.0, unit=100.0)
    with pytest.raises(DescriptionError, match=r"is 10.8 m large; expected.*0.01 for centimetres"):
        make(model, tmp_path / "out")


@pytest.mark.parametrize(
    ("units", "message"),
    [
        ({"mesh_unit": 100.0}, r"shapes are up to 10.8 units large.*scale=\"0.01 0.01 0.01\""),
        ({"unit": 100.0}, r"links lie up to 6 units apart.*shapes are at most 0.\d+ m large"),
    ],
)
def test_meshes_and_joints_in_different_units(tmp_path, units, message):
    """No factor for all lengths helps; what is said does."""
    model = urdf(tmp_path / "in", **units)
    with pytest.raises(DescriptionError, match=message):
        make(model, tmp_path / "out")
    if "mesh_unit" in units:
        text = model.read_text().replace('.stl"', '.stl" scale="0.01 0.01 0.01"')
        model.write_text(text)
        found = make(model, tmp_path / "out").description
        assert found.max_width == pytest.approx(WIDTH, abs=1e-3)


@pytest.mark.parametrize("root", [None, "palm"])
def test_gripper_far_from_the_origin(tmp_path, root):
    """Metres are those of the gripper, not of its place in a room; nor is that its frame."""
    model = urdf(tmp_path / "in")
    room = (
        '<link name="room"/><link name="base"/>'
        '<joint name="a" type="fixed"><parent link="room"/><child link="base"/>'
        '<origin xyz="5 3 1"/></joint>'
        '<joint name="b" type="fixed"><parent link="base"/><child link="palm"/></joint></robot>'
    )
    model.write_text(model.read_text().replace("</robot>", room))
    result = make(model, tmp_path / "out", root=root)
    assert result.description.max_width == pytest.approx(WIDTH, abs=1e-3)
    assert np.abs(result.analysis.tcp).max() < 0.2
    said = [note for note in result.notes if "far from its origin" in note]
    assert bool(said) == (root is None)


def test_missing_meshes_are_listed(tmp_path):
    """Every missing file with the link that uses it, and where to put it."""
    model = urdf(tmp_path / "in", prefix="nowhere/x_")
    with pytest.raises(DescriptionError, match=r"2 mesh files cannot be found: .*link 'palm'"):
        make(model, tmp_path / "out")


def test_meshes_in_other_letter_case_are_found(tmp_path):
    """As file systems that do not tell case apart leave them; the note says which was taken."""
    model = urdf(tmp_path / "in", prefix="Meshes/")
    (model.parent / "meshes" / "palm.stl").rename(model.parent / "meshes" / "PALM.STL")
    notes = make(model, tmp_path / "out").notes
    assert any("PALM.STL was taken" in note for note in notes)


def test_meshes_outside_the_root_are_not_looked_for(tmp_path):
    """Of an arm without its meshes, only what hangs from the named link is wanted."""
    model = urdf(tmp_path / "in")
    arm_link = (
        '<link name="arm"><visual><geometry><mesh filename="gone.stl"/></geometry></visual></link>'
        '<joint name="flange" type="fixed"><parent link="arm"/><child link="palm"/></joint>'
    )
    model.write_text(model.read_text().replace("</robot>", f"{arm_link}</robot>"))
    with pytest.raises(DescriptionError, match=r"gone.stl \(link 'arm'\).*--root LINK"):
        make(model, tmp_path / "a")
    assert not make(model, tmp_path / "b", root="palm").errors


def test_package_paths(tmp_path, monkeypatch):
    """An unreachable package names the option; the option, a prefix and a near folder help."""
    for variable in ("AMENT_PREFIX_PATH", "ROS_PACKAGE_PATH", "COLCON_PREFIX_PATH"):
        monkeypatch.delenv(variable, raising=False)
    model = urdf(tmp_path / "in" / "deep", prefix="package://some_gripper/parts/")
    with pytest.raises(DescriptionError, match=r"--package some_gripper=/folder/of/some_gripper"):
        make(model, tmp_path / "a")
    elsewhere = tmp_path / "elsewhere"
    (model.parent / "meshes").rename(elsewhere)
    package = tmp_path / "prefix" / "share" / "some_gripper"
    package.mkdir(parents=True)
    (package / "parts").symlink_to(elsewhere)
    assert make(model, tmp_path / "b", packages={"some_gripper": package}).notes == []
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "prefix"))
    assert make(model, tmp_path / "c").notes == []
    monkeypatch.delenv("AMENT_PREFIX_PATH")
    (model.parent / "parts").symlink_to(elsewhere)
    assert "is not where the model says" in make(model, tmp_path / "d").notes[0]


def test_link_of_the_loader_s_name_is_renamed(tmp_path):
    """A link `gripper` would clash with the frame the loader adds."""
    model = tmp_path / "a.xml"
    model.write_text(mjcf(jaws()).replace('"palm"', '"gripper"'))
    notes = make(model, tmp_path / "out").notes
    assert any("renamed to 'gripper_base'" in note for note in notes)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.urdf", "hello", "is no XML"),
        ("a.xml", "<sdf/>", r"outermost element is <sdf>; expected <robot> or <mujoco>"),
        ("a.xml", mjcf('<body><geom size="0.05"/></body>'), "has no moving joint"),
        ("a.xml", mjcf(BALL), "'b' is neither hinge nor slide"),
        ("a.xml", two_arms(), r"more than a gripper.*--root LINK.*: left_palm, palm"),
    ],
)
def test_what_is_no_gripper_is_refused(tmp_path, name, text, message):
    """Each with its own message."""
    (tmp_path / name).write_text(text)
    with pytest.raises(DescriptionError, match=message):
        make(tmp_path / name, tmp_path / "out")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('<mimic joint="left"', '<mimic joint="lef"', r"'right' mimics 'lef'.*remove the <mimic>"),
        ('<mimic joint="left"', '<mimic joint="right"', "mimics 'right', which is no other"),
        (
            '<child link="left_finger"/>',
            '<child link="l"/>',
            "child link 'l', which the model does",
        ),
        (
            '<child link="left_finger"/>',
            '<child link="right_finger"/>',
            "hangs from another joint",
        ),
        ('<parent link="palm"/>', '<parent link="left_finger"/>', "left_finger hang from each"),
        ("<limit", '<mimic joint="right"/><limit', "the joints left, right mimic each other"),
    ],
)
def test_trees_that_are_none(tmp_path, old, new, message):
    """Said in our words, with what was expected and what to do."""
    model = urdf(tmp_path / "in")
    model.write_text(model.read_text().replace(old, new, 1))
    with pytest.raises(DescriptionError, match=message):
        make(model, tmp_path / "out")


def test_gripper_is_cut_out_of_an_arm(tmp_path):
    """By itself at the link the fingers hang from, or at the link the user names."""
    hand = f'<body name="flange" pos="0 0 0.2">{jaws()}</body>'
    (tmp_path / "arm.xml").write_text(arm(hand))
    found = make(tmp_path / "arm.xml", tmp_path / "a")
    assert any("cut at link 'palm'" in note for note in found.notes)
    assert found.description.tcp[2] == pytest.approx(0.065, abs=0.003)
    named = make(tmp_path / "arm.xml", tmp_path / "b", root="flange")
    assert named.description.max_width == pytest.approx(found.description.max_width)
    with pytest.raises(
        DescriptionError, match=r"--root names the link 'hand'.*valid links: .*palm"
    ):
        make(tmp_path / "arm.xml", tmp_path / "c", root="hand")


def test_other_mesh_formats_are_converted(tmp_path):
    """Text STL, PLY and COLLADA, which MuJoCo does not read, and two files of one name."""
    model = urdf(tmp_path / "in")
    meshes = model.parent / "meshes"
    box = trimesh.creation.box(FINGER)
    (meshes / "finger.stl").write_text(trimesh.exchange.stl.export_stl_ascii(box))
    (meshes / "collision").mkdir()
    (meshes / "palm.stl").unlink()
    (meshes / "palm.dae").write_text(_collada())
    trimesh.creation.box((0.08, 0.04, 0.06)).export(meshes / "collision" / "palm.ply")
    text = model.read_text()
    visual, collision = text.split("meshes/palm.stl", 1)
    text = visual + "meshes/palm.dae" + collision.replace("palm.stl", "collision/palm.ply", 1)
    model.write_text(text)
    result = make(model, tmp_path / "out")
    assert {file.name for file in (tmp_path / "out" / "meshes").iterdir()} == {
        "finger.stl",
        "palm.stl",
        "palm_2.stl",
    }
    assert any("converted to STL" in note for note in result.notes)
    shown = Gripper(result.description).meshes("open", "visual")
    palm = max((vertices for vertices, _ in shown), key=lambda v: float(np.ptp(v[:, 0])))
    assert np.ptp(palm, axis=0) == pytest.approx([0.08, 0.04, 0.06], abs=1e-6)


def _collada() -> str:
    """A box of 80 x 40 x 60 in a file whose unit is the millimetre, half its size scaled up."""
    box = trimesh.creation.box((40.0, 20.0, 30.0))
    points = " ".join(f"{v:g}" for v in box.vertices.ravel())
    # Two inputs a corner, so that the index of the position is every second number.
    corners = " ".join(f"{v} 0" for v in box.faces.ravel())
    return (
        '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
        '<asset><unit meter="0.001"/></asset><library_geometries><geometry id="g"><mesh>'
        f'<source id="p"><float_array id="a">{points}</float_array></source>'
        '<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>'
        '<triangles count="12"><input semantic="VERTEX" source="#v" offset="0"/>'
        f'<input semantic="NORMAL" source="#n" offset="1"/><p>{corners}</p></triangles>'
        '</mesh></geometry></library_geometries><library_visual_scenes><visual_scene id="s">'
        '<node><scale>2 2 2</scale><node><instance_geometry url="#g"/></node></node>'
        "</visual_scene></library_visual_scenes></COLLADA>"
    )


def test_command_line(tmp_path, capsys):
    """Files, exit codes and messages of `megrasp gripper new`."""
    model, out = urdf(tmp_path / "in"), tmp_path / "made"
    assert main(["gripper", "new", str(model), "--out", str(out), "--licence", "MIT"]) == 0
    said = capsys.readouterr().out
    assert "closing" in said and "likely" in said and "picture.png" in said
    assert (out / "picture.png").stat().st_size > 10_000
    assert load_description(out).licence == "MIT"
    bad = ["gripper", "new", str(model), "--out", str(tmp_path / "b")]
    assert main([*bad, "--approach", "0", "0", "1", "--closing", "0", "0.5", "1"]) == 2
    assert "not perpendicular" in capsys.readouterr().err
    assert main([*bad, "--open", "left"]) == 2
    assert "expected name=value" in capsys.readouterr().err
    assert main([*bad, "--name", "My Gripper!"]) == 2
    assert "such as --name my_gripper" in capsys.readouterr().err
    assert not (tmp_path / "b").exists()
    assert main([*bad, "--kind", "claw"]) == 2
    assert "parallel, adaptive, hand" in capsys.readouterr().err


def test_score_command(tmp_path, capsys, monkeypatch):
    """A description is its own truth; a wrong one is found out; no folder is bad input."""
    made = tmp_path / "grippers" / "jaws"
    make(urdf(tmp_path / "in"), made)
    score = ["gripper", "score-wizard", "--folder", str(made.parent)]
    assert main([*score, "--out", str(tmp_path / "score.json")]) == 0
    row = json.loads((tmp_path / "score.json").read_text())["grippers"][0]
    assert row["right"] and row["tcp"] < 1e-3
    text = (made / "gripper.yaml").read_text()
    (made / "gripper.yaml").write_text(text.replace("tcp: [0.0, 0.0, 0.0", "tcp: [0.0, 0.0, 0.1"))
    assert main(score) == 1
    assert "WRONG" in capsys.readouterr().out
    drawn = ["gripper", "score-wizard", "--jaws", "1", "--out", str(tmp_path / "jaws.json")]
    assert main(drawn) == 0
    assert json.loads((tmp_path / "jaws.json").read_text())["right"] == 1
    assert main([*drawn, "--folder", str(made.parent)]) == 2
    assert "neither names nor --folder" in capsys.readouterr().err
    monkeypatch.delenv("MEGRASP_ASSETS", raising=False)
    assert main(["gripper", "score-wizard"]) == 2
    assert "--folder" in capsys.readouterr().err


def test_questions_are_asked_once_and_only_for_guesses(monkeypatch, capsys):
    """A wrong answer is asked again, Enter keeps what was found."""
    findings = [
        Finding("closing", [1.0, 0.0, 0.0], "sure", "seen", "--closing"),
        Finding("approach", [0.0, 0.0, 1.0], GUESS, "no palm", "--approach"),
        Finding("open", {"left": 0.0}, GUESS, "no limits", "--open"),
    ]
    answers = iter(["up", "0 1 0", ""])
    monkeypatch.setattr("builtins.input", lambda _: next(answers))
    ask = _Questions()
    changed = ask(findings, Overrides())
    assert changed is not None and list(changed.approach) == [0, 1, 0]
    assert ask(findings, changed) is None
    assert next(answers, None) is None
    assert "expected X Y Z" in capsys.readouterr().out
