"""`megrasp eval --without`: what is left out, and what the result file says of it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from megrasp_core.cli import main
from megrasp_core.evaluation.clutter_removal.report import ClutterResult
from megrasp_core.evaluation.outcome import SceneOutcome
from megrasp_core.evaluation.planners import AntipodalPlanner, Planner
from megrasp_core.evaluation.protocols import ProtocolSettings
from megrasp_core.evaluation.report import EvaluationResult

EVALUATION = "megrasp_core.evaluation"
BASELINE = ["eval", "--gripper", "robotiq_2f85", "--baseline", "--scenes", "1"]


@pytest.fixture
def planners(monkeypatch: pytest.MonkeyPatch) -> list[Planner]:
    """The planners that were evaluated; nothing is simulated."""
    asked: list[Planner] = []

    def evaluated(settings: ProtocolSettings, gripper, planner, pool, usable, **_):
        asked.append(planner)
        scenes = (SceneOutcome(first=[(True, "success")], targets=["box"]),)
        return EvaluationResult(settings, "g", "g", planner.name, 1, 1, "procedural", scenes)

    def cleared(settings, gripper, planner, pool, **_):
        asked.append(planner)
        return ClutterResult(settings, "g", "g", planner.name, 1, "procedural", ())

    monkeypatch.setattr(f"{EVALUATION}.object_pool.load_pool", lambda folder: [])
    monkeypatch.setattr(f"{EVALUATION}.object_pool.graspable_objects", lambda *_, **__: [])
    monkeypatch.setattr(f"{EVALUATION}.report.evaluate", evaluated)
    monkeypatch.setattr(f"{EVALUATION}.clutter_removal.object_files.clutter_pool", lambda _: [])
    monkeypatch.setattr(f"{EVALUATION}.clutter_removal.object_files.fitting", lambda *_: [])
    monkeypatch.setattr(f"{EVALUATION}.clutter_removal.report.evaluate_clutter", cleared)
    return asked


@pytest.mark.parametrize("protocol", ["binpick", "pile"])
def test_the_baseline_leaves_out_what_the_file_says(protocol, planners, tmp_path: Path) -> None:
    out, stages = tmp_path / "out.json", ["openings", "sweep", "back_off"]
    main([*BASELINE, "--protocol", protocol, "--without", *stages, "--out", str(out)])
    (planner,) = planners
    assert isinstance(planner, AntipodalPlanner)
    assert planner.options.ranking.sweep.steps == 0 and planner.options.probe.narrower == ()
    assert not planner.options.back_off
    assert json.loads(out.read_text())["config"]["without"] == stages


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--without", "polish", "sweep"], "expected some of openings, sweep, back_off"),
        (["--ceiling", "--without", "sweep"], "--ceiling; expected none of it"),
    ],
)
def test_stages_that_a_planner_does_not_have_are_refused(
    options, words, planners, tmp_path: Path, capsys
) -> None:
    assert main([*BASELINE, *options, "--out", str(tmp_path / "out.json")]) == 2
    assert words in capsys.readouterr().err
    assert not planners
