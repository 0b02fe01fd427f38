"""`megrasp gripper`: results, exit codes, messages."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image


def test_gripper_list_show_and_render(capsys, tmp_path):
    code, said, _ = run(capsys, "gripper", "list")
    assert code == 0 and "robotiq_2f85" in said and "85 mm" in said
    code, _, _ = run(capsys, "gripper", "list", "--out", tmp_path / "g.json")
    assert code == 0
    names = [entry["name"] for entry in json.loads((tmp_path / "g.json").read_text())]
    assert {"robotiq_2f85", "franka_hand"} <= set(names)
    code, said, _ = run(capsys, "gripper", "show", "robotiq_2f85")
    facts = json.loads(said)
    assert code == 0 and facts["tcp"][2] == pytest.approx(0.15) and facts["hash"]
    assert set(facts["open_joints"]) == set(facts["closed_joints"])
    code, _, _ = run(capsys, "gripper", "render", "franka_hand", "--out", tmp_path / "f.png")
    with Image.open(tmp_path / "f.png") as image:
        assert code == 0 and len(np.unique(np.asarray(image))) > 30


def test_gripper_check_against_itself_finds_no_difference(capsys):
    args = ("gripper", "check", "robotiq_2f85", "--against", "robotiq_2f85", "--points", 500)
    code, said, _ = run(capsys, *args)
    report = json.loads(said[: said.rindex("}") + 1])
    assert code == 0 and report["findings"] == []
    measures = report["against"]["measures"]
    assert measures["surface_open"]["value"] == measures["tcp"]["value"] == 0.0
    assert "pad motion                0.00     3.0  pass" in said


def test_gripper_check_against_another_names_what_differs(capsys, tmp_path):
    args = ("gripper", "check", "franka_hand", "--against", "robotiq_2f85", "--points", 500)
    code, said, _ = run(capsys, *args, "--out", tmp_path / "c.json")
    report = json.loads((tmp_path / "c.json").read_text())
    assert code == 1 and not report["against"]["passed"]
    assert "finding: against robotiq_2f85: tcp is 46.60 mm; expected at most 2.0 mm" in said
    assert "TCP                      46.60     2.0  FAIL" in said
    code, _, told = run(capsys, *args[:-1], 0)
    assert code == 2 and "--points is 0; expected at least 1" in told


def test_gripper_fidelity_writes_file_and_page(capsys, tmp_path, assets):
    out, page = tmp_path / "f.json", tmp_path / "page.md"
    args = ("gripper", "fidelity", "--out", out, "--page", page)
    page.write_text("no marks\n")
    code, _, told = run(capsys, *args, "schunk_wsg32")
    assert code == 2 and "<!-- fidelity -->" in told and not out.exists()
    page.write_text("before\n<!-- fidelity -->\nold\n<!-- /fidelity -->\nafter\n")
    for name in ("schunk_wsg32", "franka_hand"):
        code, said, _ = run(capsys, *args, name)
        assert code == 0 and f"| {name} |" in said
    entries = json.loads(out.read_text())
    assert [entry["gripper"] for entry in entries] == ["franka_hand", "schunk_wsg32"]
    assert all(entry["passed"] and entry["points"] == 20000 for entry in entries)
    text = page.read_text()
    assert text.startswith("before\n<!-- fidelity -->\n| gripper |") and "old" not in text
    assert text.endswith("<!-- /fidelity -->\nafter\n") and "| franka_hand |" in text
