"""xacro files read as the URDF that they expand to."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from wizard_models import urdf

from megrasp_core.cli import main
from megrasp_core.errors import DescriptionError
from megrasp_core.gripper_tools.wizard import ModelRequest, NewGripper, SourceOptions, new_gripper

REASON = "xacrodoc is missing: pip install 'megrasp-core[xacro]'"
HEAD = '<robot name="jaws" xmlns:xacro="http://www.ros.org/wiki/xacro">'


def write(folder: Path) -> Path:
    """Write a xacro of two jaws: one file with the fingers' macro in a package, one that needs the
    argument `stroke`; return the latter.
    """
    plain = urdf(folder)
    parts = plain.read_text().removeprefix('<robot name="jaws">').removesuffix("</robot>")
    parts = parts.replace('0.03"', '${stroke}"')
    package = folder / "my_parts"
    (package / "urdf").mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>my_parts</name></package>")
    (package / "urdf" / "jaws.xacro").write_text(
        f'{HEAD}<xacro:macro name="jaws" params="stroke">{parts}</xacro:macro></robot>'
    )
    plain.unlink()
    file = folder / "gripper.urdf.xacro"
    file.write_text(
        f'{HEAD}<xacro:arg name="stroke" default="0.03"/>'
        '<xacro:include filename="$(find my_parts)/urdf/jaws.xacro"/>'
        '<xacro:jaws stroke="$(arg stroke)"/></robot>'
    )
    return file


def make(model: Path, out: Path, **options: object) -> NewGripper:
    """Run the wizard without a picture."""
    source = SourceOptions(**options)  # type: ignore[arg-type]
    return new_gripper(ModelRequest(model, out, source=source), picture=False)


def test_arguments_and_packages(tmp_path):
    """Macros, files of packages and arguments are followed."""
    pytest.importorskip("xacrodoc", reason=REASON)
    model = write(tmp_path / "in")
    wide = make(model, tmp_path / "a").description.max_width
    assert wide == pytest.approx(0.06, abs=1e-3)
    narrow = make(model, tmp_path / "b", xacro={"stroke": "0.02"}).description.max_width
    assert narrow == pytest.approx(0.06, abs=1e-3)
    closed = make(model, tmp_path / "c", xacro={"stroke": "0.02"}).description.min_width
    assert closed == pytest.approx(0.02, abs=1e-3)


def test_files_beside_the_model_are_found_from_anywhere(tmp_path, monkeypatch):
    """Includes, those of an included file too, and values lie relative to the file that names
    them, as in ROS; not to the working folder.
    """
    pytest.importorskip("xacrodoc", reason=REASON)
    model = write(tmp_path / "in")
    (tmp_path / "in" / "inc" / "more").mkdir(parents=True)
    (tmp_path / "in" / "inc" / "all.xacro").write_text(
        f'{HEAD}<xacro:include filename="more/jaws.xacro"/></robot>'
    )
    (tmp_path / "in" / "my_parts" / "urdf" / "jaws.xacro").rename(
        tmp_path / "in" / "inc" / "more" / "jaws.xacro"
    )
    (tmp_path / "in" / "values.yaml").write_text("stroke: 0.02\n")
    model.write_text(
        f'{HEAD}<xacro:property name="values" value="${{xacro.load_yaml(\'values.yaml\')}}"/>'
        '<xacro:include filename="inc/all.xacro"/>'
        "<xacro:jaws stroke=\"${values['stroke']}\"/></robot>"
    )
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    for given in (model, Path("../in") / model.name):
        out = tmp_path / f"out_{given.is_absolute()}"
        assert make(given, out).description.min_width == pytest.approx(0.02, abs=1e-3)


def test_what_cannot_be_expanded_is_said(tmp_path):
    """An unknown package and a missing argument, each with the option that helps."""
    pytest.importorskip("xacrodoc", reason=REASON)
    model = write(tmp_path / "in")
    (tmp_path / "in" / "my_parts" / "package.xml").unlink()
    (tmp_path / "in" / "my_parts").rename(tmp_path / "elsewhere")
    with pytest.raises(
        DescriptionError, match=r"needs the ROS packages my_parts.*--package my_parts="
    ):
        make(model, tmp_path / "a")
    made = make(model, tmp_path / "b", packages={"my_parts": tmp_path / "elsewhere"})
    assert not made.errors
    model.write_text(model.read_text().replace('<xacro:arg name="stroke" default="0.03"/>', ""))
    with pytest.raises(DescriptionError, match=r"stroke.*--xacro-arg NAME:=VALUE"):
        make(model, tmp_path / "c", packages={"my_parts": tmp_path / "elsewhere"})


def test_command_takes_arguments(tmp_path, capsys):
    """`--xacro-arg` is repeatable; without `:=` it is refused."""
    pytest.importorskip("xacrodoc", reason=REASON)
    model, out = write(tmp_path / "in"), tmp_path / "out"
    line = ["gripper", "new", str(model), "--out", str(out), "--yes"]
    assert main([*line, "--xacro-arg", "stroke=0.02"]) == 2
    assert "--xacro-arg got 'stroke=0.02'; expected name:=value" in capsys.readouterr().err
    assert main([*line, "--xacro-arg", "stroke:=0.02", "--xacro-arg", "unused:=1"]) == 0
    assert "opens" not in capsys.readouterr().err


def test_without_xacro_the_message_says_how_to_get_it(tmp_path, monkeypatch):
    """Neither xacrodoc nor ROS's xacro: what to install, or what to run where ROS is."""
    for module in ("xacrodoc", "xacro"):
        monkeypatch.setitem(sys.modules, module, None)
    model = write(tmp_path / "in")
    message = r"pip install 'megrasp-core\[xacro\]'.*xacro gripper.urdf.xacro > gripper.urdf"
    with pytest.raises(DescriptionError, match=message):
        make(model, tmp_path / "out")


def test_argument_for_a_plain_urdf_is_refused(tmp_path):
    """It would do nothing."""
    with pytest.raises(DescriptionError, match=r"--xacro-arg is given, but .* is no xacro file"):
        make(urdf(tmp_path / "in"), tmp_path / "out", xacro={"a": "1"})
