"""Bin clearing without ROS: real cell, real pictures, a scripted synthesizer."""

from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from megrasp_core.cell.demo import clear_bin
from megrasp_core.cell.robot_cell import CellSettings, RobotCell
from megrasp_core.objects import procedural_object
from megrasp_core.simulation import Reason, Verdict
from megrasp_core.synthesizer import RankedGrasp

GRIPPERS = ("robotiq_2f85", "franka_hand")


class ScriptedSynthesizer:
    """Offers one grasp from above on every object that is left; remembers what it was asked."""

    def __init__(self, cell: RobotCell) -> None:
        self.cell = cell
        self.grippers: list[str] = []
        self.asked: list[dict] = []

    def set_gripper(self, gripper) -> None:
        self.grippers.append(gripper.name)

    def synthesize(self, cloud, **arguments):
        self.asked.append(arguments)
        assert cloud is self.cell.capture()
        poses = []
        for pose in self.cell.object_poses().values():
            tcp = np.diag([1.0, -1.0, -1.0, 1.0])
            tcp[:3, 3] = pose[:3, 3]
            poses.append(tcp)
        nan = float("nan")
        grasps = [RankedGrasp(tcp, tcp, tcp, tcp, 0.5, nan, 0.01, 0.0, True) for tcp in poses]
        return SimpleNamespace(grasps=grasps, rejected={"collision": 3})


@pytest.fixture
def cell(monkeypatch):
    """Four objects; by a scripted verdict the first attempt slips, the others lift the nearest."""
    made = RobotCell(
        [procedural_object(seed, "box") for seed in range(4)],
        GRIPPERS,
        settings=CellSettings(noise=None),
    )
    attempts = []

    def judge(world, pose, *, graspable, approach, opening, on_phase):
        attempts.append(pose)
        if len(attempts) == 1:
            return Verdict(False, Reason.SLIPPED)
        poses = world.object_poses()
        nearest = min(graspable, key=lambda i: np.linalg.norm(poses[i, :3, 3] - pose[:3, 3]))
        return Verdict(True, Reason.SUCCESS, (nearest,), nearest)

    monkeypatch.setattr("megrasp_core.cell.pick_cycle.judge", judge)
    return made


@pytest.mark.slow
def test_the_bin_is_emptied_and_drawn(cell, tmp_path):
    synthesizer = ScriptedSynthesizer(cell)
    seen = []
    summary = clear_bin(
        cell,
        synthesizer,
        grippers=GRIPPERS,
        seed=7,
        picture=tmp_path / "demo.png",
        on_pick=seen.append,
    )
    assert summary["cleared"]
    assert sorted(summary["removed"]) == sorted(cell.object_names)
    assert summary["attempts"] == len(seen) == 5
    assert [record.success for record in seen] == [False, True, True, True, True]
    assert [record.gripper for record in seen] == [GRIPPERS[0]] * 3 + [GRIPPERS[1]] * 2
    assert synthesizer.grippers == [record.gripper for record in seen]
    assert [len(asked["exclude"]) for asked in synthesizer.asked] == [0, 1, 0, 0, 0]
    assert [asked["seed"] for asked in synthesizer.asked] == [8, 9, 10, 11, 12]
    assert seen[0].reason == "slipped"
    assert seen[0].rejected == {"collision": 3}
    for record in seen:
        with Image.open(record.picture) as image:
            assert image.width > 400
    with Image.open(tmp_path / "demo.png") as sheet:
        assert sheet.width > 1000
