"""Unfiltered samples are those of the sampler alone; what is executed may have been moved."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from megrasp_core.evaluation.planners import AntipodalPlanner, ModelPlanner, Planner
from megrasp_core.evaluation.protocols import ProtocolSettings, run_scene
from megrasp_core.grippers import load_gripper
from megrasp_core.lie import PoseBatch
from megrasp_core.network import PRESETS, GraspModel
from megrasp_core.objects import procedural_object
from megrasp_core.pointcloud import Cloud
from megrasp_core.ranking import gripper_probe
from megrasp_core.synthesizer import GraspSynthesizer
from megrasp_core.synthesizer.run import SynthesisRun

NAME = "robotiq_2f85"
ASKED = {"num_grasps": 4, "drawn": 4, "mode": "fast", "keep_all": True, "seed": 1, "walls": False}


def thin_block() -> Cloud:
    """A block on a table, 20 mm wide along x, seen from above."""
    axis = np.arange(-0.2, 0.2, 0.002)
    x, y = np.meshgrid(axis, axis)
    height = np.where((np.abs(x) <= 0.01) & (np.abs(y) <= 0.03), 0.03, 0.0)
    points = np.column_stack([x.ravel(), y.ravel(), height.ravel()])
    return Cloud(points, None, np.array([0.0, 0.0, 2.0]))


@pytest.fixture
def low() -> np.ndarray:
    """A TCP pose (4, 4) from which the tips, which come forward, close into the table."""
    gripper = load_gripper(NAME)
    tcp = np.diag([1.0, -1.0, -1.0, 1.0])
    tcp[2, 3] = gripper_probe(gripper).points[:, 2].max() - gripper.tcp[2] + 0.003
    return tcp


@pytest.fixture
def model_planner(low: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> ModelPlanner:
    """Whose sampler draws that pose."""

    def drawn(self: SynthesisRun, field: object, starts: torch.Tensor) -> PoseBatch:
        pose = torch.tensor(low, dtype=starts.dtype).expand(len(starts), 4, 4)
        return PoseBatch(pose[:, :3, :3], pose[:, :3, 3] - torch.tensor(self.centroid).float())

    monkeypatch.setattr(SynthesisRun, "_descend", drawn)
    monkeypatch.setattr(SynthesisRun, "_refine", lambda self, field, poses: poses)
    torch.manual_seed(0)
    model = GraspModel(PRESETS["tiny"], model_id="random").eval().requires_grad_(False)
    return ModelPlanner(GraspSynthesizer(model, NAME, threads=1))


@pytest.fixture
def baseline(low: np.ndarray, monkeypatch: pytest.MonkeyPatch) -> AntipodalPlanner:
    """Whose candidates are that pose."""
    monkeypatch.setattr(AntipodalPlanner, "candidates", lambda *_: np.stack([low] * 4))
    return AntipodalPlanner(load_gripper(NAME))


@pytest.mark.parametrize("kind", ["model_planner", "baseline"])
def test_raw_samples_stay_where_they_were_drawn(kind, low, request) -> None:
    planner: Planner = request.getfixturevalue(kind)
    for grasp in planner.raw().plan(thin_block(), **ASKED).grasps:
        assert grasp.reason == "sweep"
        np.testing.assert_allclose(grasp.world_from_tcp, low, atol=1e-5)
    best = planner.plan(thin_block(), **ASKED).grasps[0]
    assert best.collision_free and best.world_from_tcp[2, 3] > low[2, 3] + 0.002


def test_the_rates_of_samples_are_those_of_the_raw_planner(low) -> None:
    asked = []

    class Noted(AntipodalPlanner):
        def raw(self) -> AntipodalPlanner:
            asked.append("raw")
            return super().raw()

    pool = [procedural_object(1, kind="box")]
    settings = ProtocolSettings(protocol="single", scenes=1, samples=2, drawn=40)
    outcome = run_scene(settings, load_gripper(NAME), Noted(load_gripper(NAME)), pool, [0], 0)
    assert asked == ["raw"] and len(outcome.sampled) == 2
