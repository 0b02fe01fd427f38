"""Grippers of the procedural family in simulation, and the check that says whether they hold."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from megrasp_core.gripper_tools.family_check import (
    FamilyCheck,
    check_family_gripper,
    suitable_object,
    summary,
    text,
)
from megrasp_core.grippers import load_gripper, sample_gripper, write_gripper
from megrasp_core.grippers.family import FAMILY_KINDS, build_gripper, draw_parameters


def test_most_kinds_hold(tmp_path: Path) -> None:
    results = [
        check_family_gripper(write_gripper(tmp_path, *sample_gripper(1, kind)))
        for kind in FAMILY_KINDS
    ]
    assert all(result.sound for result in results), [r for r in results if not r.sound]
    assert sum(result.holds for result in results) >= 5


@pytest.mark.parametrize("motion", ["slide", "linkage", "hinge"])
def test_a_drive_without_force_holds_nothing(tmp_path: Path, motion: str) -> None:
    """The check tells what holds: the same gripper with a thousandth of the force does not."""
    kind = {"slide": "parallel_slide", "linkage": "parallel_linkage", "hinge": "angular"}[motion]
    seed = 1
    p = draw_parameters(seed, kind)
    weak = dataclasses.replace(p, force=p.force / 1000)
    assert check_family_gripper(write_gripper(tmp_path / "a", *build_gripper(p))).holds
    assert not check_family_gripper(write_gripper(tmp_path / "b", *build_gripper(weak))).holds


def test_a_broken_gripper_is_unsound(tmp_path: Path) -> None:
    folder = write_gripper(tmp_path, *sample_gripper(1))
    model = folder / "model.xml"
    model.write_text(model.read_text().replace('type="position"', "").replace("<position", "<x"))
    result = check_family_gripper(folder)
    assert not result.sound and result.error is not None and "model" in result.error


def test_suitable_objects_fit_between_the_pads(tmp_path: Path) -> None:
    gripper = load_gripper(write_gripper(tmp_path, *sample_gripper(4)))
    d = gripper.description
    assert d.max_width is not None
    for kind in ("box", "cylinder"):
        extent = suitable_object(gripper, kind).vertices[:, 0]
        assert d.min_width < extent.max() - extent.min() < d.max_width


def test_summary_counts_by_kind() -> None:
    results = [
        FamilyCheck("angular_000001", None, 0.01, "success"),
        FamilyCheck("angular_000002", None, 0.01, "slipped", "success"),
        FamilyCheck("angular_000003", None, 0.001, "success"),
        FamilyCheck("four_finger_000004", "does not load"),
    ]
    content = summary(results)
    assert content["sound"]["successes"] == 2 and content["holds"]["successes"] == 2
    assert content["kinds"]["angular"]["trials"] == 3
    assert [f["name"] for f in content["failures"]] == ["angular_000003", "four_finger_000004"]
    assert "2/4" in text(content) and "50.0%" in text(content)
