"""Mechanisms that look like grippers and those that do not: gears, two grippers, cups, arms."""

from __future__ import annotations

from pathlib import Path

import pytest
from wizard_models import INERTIAL, shape, slides

from megrasp_core.gripper_tools.wizard import ModelRequest, NewGripper, SourceOptions, new_gripper


def made(folder: Path, text: str, **source: object) -> NewGripper:
    """Write a URDF and run the wizard on it, without a picture."""
    folder.mkdir(exist_ok=True)
    (folder / "model.urdf").write_text(text)
    options = SourceOptions(**source)  # type: ignore[arg-type]
    return new_gripper(ModelRequest(folder / "model.urdf", folder / "out", options), picture=False)


def driven(kind: str, limits: tuple[float, float] | None, gain: float, seen: bool) -> str:
    """Return the URDF of `slides(0.04)` with both fingers on the joint `drive`.

    Args:
        kind: of the drive.
        limits: of the drive, None for none.
        gain: metres of a finger per unit of the drive.
        seen: whether the part that the drive moves has a shape.
    """
    limit = "" if limits is None else f'<limit lower="{limits[0]}" upper="{limits[1]}"/>'
    part = shape("0.02 0.02 0.01", "0 0 0") if seen else ""
    drive = (
        f'<link name="gear">{INERTIAL}{part}</link><joint name="drive" type="{kind}">'
        '<parent link="palm"/><child link="gear"/><origin xyz="0 0 0.02"/><axis xyz="0 0 1"/>'
        f"{limit}</joint></robot>"
    )
    text = slides(0.04).replace('<mimic joint="left"/>', "")
    text = text.replace("</joint>", f'<mimic joint="drive" multiplier="{gain}"/></joint>')
    return text.replace("</robot>", drive)


@pytest.mark.parametrize(
    ("kind", "limits", "gain", "seen"),
    [
        ("revolute", (0.0, 2.0), 0.02, False),
        ("revolute", (0.0, 4.0), 0.01, True),
        ("continuous", None, 0.01, True),
        ("prismatic", (0.0, 40.0), 0.001, False),
        ("prismatic", (0.0, 0.08), 0.5, True),
    ],
)
def test_jaws_on_a_gear(tmp_path, kind, limits, gain, seen):
    """Slides that a gear, a spindle or a piston drives: it is no finger, and they are."""
    result = made(tmp_path, driven(kind, limits, gain, seen))
    assert result.description.fingers == (("fl",), ("fr",))
    assert result.analysis.axes.closing == pytest.approx([1, 0, 0])
    assert result.analysis.axes.approach == pytest.approx([0, 0, 1])
    assert result.description.max_width == pytest.approx(0.08, abs=1e-3)
    opened = result.description.open.joints
    assert opened is not None and opened["drive"] == pytest.approx(0.04 / gain)
    assert not result.errors
    if kind != "prismatic":
        # The fingers push as ones with drives of their own do.
        assert result.description.actuation["drive"].force / gain == pytest.approx(40.0)
