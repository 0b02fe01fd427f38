"""Mechanisms that look like grippers and those that do not: gears, two grippers, cups, arms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from wizard_models import INERTIAL, SINGLE, arm, mjcf, shape, slides

from megrasp_core.errors import DescriptionError
from megrasp_core.gripper_tools.wizard import ModelRequest, NewGripper, SourceOptions, new_gripper


def made(folder: Path, text: str, **source: object) -> NewGripper:
    """Write a URDF or MJCF and run the wizard on it, without a picture."""
    folder.mkdir(exist_ok=True)
    (folder / "model.xml").write_text(text)
    options = SourceOptions(**source)  # type: ignore[arg-type]
    return new_gripper(ModelRequest(folder / "model.xml", folder / "out", options), picture=False)


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


def pairs(places: tuple[str, str], palms: bool) -> str:
    """Return the URDF of two pairs of jaws on one base.

    Args:
        places: x y z (m) of each on the base.
        palms: whether each has a palm; else their fingers hang from the base.
    """
    parts = [f'<link name="base">{shape("0.1 0.1 0.02", "0 0 -0.01")}</link>']
    for side, place in zip("ab", places, strict=True):
        text = slides(0.04).removeprefix('<robot name="jaws">').removesuffix("</robot>")
        for name in ("palm", "fl", "fr", "left", "right"):
            text = text.replace(f'"{name}"', f'"{name}_{side}"')
        if not palms:
            x, y, _ = place.split()
            text = text[text.index("</link>") + len("</link>") :]
            text = text.replace(f'"palm_{side}"', '"base"')
            for sign in ("-", ""):
                moved = f"{float(x) + float(sign + '0.005'):g} {y} 0.0"
                text = text.replace(f'"{sign}0.005 0 0.06"', f'"{moved}"')
            parts.append(text)
            continue
        parts.append(
            f'{text}<joint name="mount_{side}" type="fixed"><parent link="base"/>'
            f'<child link="palm_{side}"/><origin xyz="{place}"/></joint>'
        )
    return "".join(['<robot name="two">', *parts, "</robot>"])


@pytest.mark.parametrize("places", [("-0.09 0 0", "0.09 0 0"), ("0 0 0", "0 0.3 0")])
def test_two_grippers_are_refused(tmp_path, places):
    """Each is named by the link that its fingers hang from, and that link alone is understood."""
    text = pairs(places, palms=True)
    with pytest.raises(DescriptionError, match=r"two grippers.*--root palm_a or --root palm_b"):
        made(tmp_path / "both", text)
    assert made(tmp_path / "one", text, root="palm_b").description.fingers == (
        ("fl_b",),
        ("fr_b",),
    )


def test_two_pairs_on_one_link(tmp_path):
    """No link holds one of them alone, so the other's fingers are to be left out."""
    text = pairs(("-0.09 0 0", "0.09 0 0"), palms=False)
    with pytest.raises(
        DescriptionError, match=r"two grippers.*--without f[lr]_b --without f[lr]_b"
    ):
        made(tmp_path / "both", text)
    alone = made(tmp_path / "one", text, without=("fl_b", "fr_b"))
    assert alone.description.max_width == pytest.approx(0.08, abs=1e-3)


def test_two_fingers_on_either_side_are_one_gripper(tmp_path):
    """Side by side, on drives of their own, they close on one place."""
    result = made(tmp_path, pairs(("0 -0.02 0", "0 0.02 0"), palms=False))
    sides = {frozenset(group) for group in result.description.fingers}
    assert sides == {frozenset({"fl_a", "fl_b"}), frozenset({"fr_a", "fr_b"})}
    assert np.abs(result.analysis.tcp[:2]).max() < 1e-3


CUP = (
    '<body name="cup_{0}" pos="{1} {2} 0.01"><joint name="j_{0}" {3}/>'
    '<geom type="cylinder" size="0.015 {4}" pos="0 0 {4}"/></body>'
)
IN_AND_OUT = 'type="slide" axis="0 0 -1" range="0 {}"'
TILTING = 'axis="0 1 0" range="-0.2 0.2"'


@pytest.mark.parametrize(
    ("places", "joint", "half"),
    [
        ([(-0.07, 0.0), (0.07, 0.0)], IN_AND_OUT.format(0.02), 0.015),
        ([(-0.03, 0.0), (0.03, 0.0)], IN_AND_OUT.format(0.05), 0.04),
        ([(x, y) for x in (-0.07, 0.07) for y in (-0.07, 0.07)], IN_AND_OUT.format(0.02), 0.015),
        ([(-0.07, 0.0), (0.07, 0.0)], TILTING, 0.025),
    ],
)
def test_cups_are_refused(tmp_path, places, joint, half):
    """Bellows that go into their plate one by one, and cups that tilt."""
    cups = "".join(CUP.format(k, x, y, joint, half) for k, (x, y) in enumerate(places))
    plate = '<geom type="box" size="0.1 0.1 0.01"/>'
    with pytest.raises(DescriptionError, match="suction tools are not supported"):
        made(tmp_path, mjcf(f'<body name="plate">{plate}{cups}</body>'))


def test_jaws_that_never_part_at_their_roots(tmp_path):
    """Near each other at the hinges, and closed all along: they do close, so they are no cups."""
    fingers = "".join(
        f'<body name="f{k}" pos="{x} 0 0.03"><joint name="j{k}" axis="0 {sign} 0" range="0 0.5"/>'
        '<geom type="box" size="0.004 0.01 0.03" pos="0 0 0.03"/></body>'
        for k, (x, sign) in enumerate([(-0.006, -1), (0.006, 1)])
    )
    palm = '<geom type="box" size="0.04 0.03 0.03"/>'
    result = made(tmp_path, mjcf(f'<body name="palm">{palm}{fingers}</body>'))
    assert result.analysis.axes.closing == pytest.approx([1, 0, 0])
    assert result.description.max_width is not None and result.description.max_width > 0.02
    assert not result.errors


LAST = (
    '<body name="last" pos="0 0 0.2"><joint name="wrist" axis="{}" range="{}"/>'
    '<geom type="capsule" size="0.04 0.06" pos="0 0 0.1"/>'
    '<geom type="box" size="0.005 0.01 0.03" pos="-0.03 0 0.22"/>'
    '<geom type="box" size="0.005 0.01 0.03" pos="0.03 0 0.22"/></body>'
)


@pytest.mark.parametrize(
    ("axis", "limits"), [("0 1 0", "-3 3"), ("0 1 0", "0 2.9"), ("0 0 1", "-1.5 1.5")]
)
def test_arm_without_a_gripper_is_refused(tmp_path, axis, limits):
    """Its last link bends back or turns about itself; its fingers do not move."""
    with pytest.raises(DescriptionError, match=r"no gripper found: 5 joints lead .*'last'"):
        made(tmp_path, arm(LAST.format(axis, limits), joints=5))


def test_single_jaw_on_an_arm(tmp_path):
    """One jaw that closes against its base is a gripper on an arm, too."""
    jaw = SINGLE[SINGLE.index("<body") : SINGLE.rindex("</worldbody>")]
    plain = made(tmp_path / "plain", SINGLE)
    carried = made(tmp_path / "arm", arm(jaw.replace('"base"', '"base" pos="0 0 0.23"', 1)))
    assert any("cut at link 'base'" in note for note in carried.notes)
    assert carried.analysis.tcp == pytest.approx(plain.analysis.tcp, abs=1e-3)
