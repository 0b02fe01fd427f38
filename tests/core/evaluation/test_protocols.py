"""The protocols with planners whose answers are known."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
import torch

from megrasp_core.errors import InvalidRequestError, SimulationError
from megrasp_core.evaluation.ceiling import CeilingPlanner
from megrasp_core.evaluation.object_pool import graspable_objects, load_pool
from megrasp_core.evaluation.planners import AntipodalPlanner, ModelPlanner, Planner
from megrasp_core.evaluation.protocols import ProtocolSettings, run_scene
from megrasp_core.evaluation.report import EvaluationResult, evaluate
from megrasp_core.evaluation.search import GraspSearch, SearchSettings
from megrasp_core.grippers import load_gripper
from megrasp_core.jobs import ExecutorConfig
from megrasp_core.network import PRESETS, GraspModel
from megrasp_core.objects import procedural_object
from megrasp_core.pointcloud import Cloud
from megrasp_core.synthesizer import GraspSynthesizer, RankedGrasp, Synthesis


@pytest.fixture(scope="module")
def gripper():
    return load_gripper("robotiq_2f85")


@pytest.fixture(scope="module")
def pool():
    return [procedural_object(seed, kind="box") for seed in range(8)]


class Scripted(Planner):
    """Answers with one fixed pose, or with nothing."""

    name = "scripted"

    def __init__(self, pose: np.ndarray | None) -> None:
        self.pose, self.asked = pose, []

    def plan(self, cloud, **options):
        self.asked.append(options)
        grasps = []
        if self.pose is not None:
            back = self.pose.copy()
            back[:3, 3] -= 0.1 * back[:3, 2]
            grasps = [RankedGrasp(self.pose, self.pose, back, back, 0.5, 0.04, 0.01, 0.0, True)]
        return Synthesis(grasps, {}, {"total": 0.0}, 0, 100, 20, "robotiq_2f85", self.name)


def test_empty_answers_end_a_bin_after_three_failures(gripper, pool):
    settings = ProtocolSettings(scenes=1, graspable=3, obstacles=0)
    outcome = run_scene(settings, gripper, Scripted(None), pool, range(8), 0)
    assert [reason for _, reason in outcome.first] == ["no_answer"] * 3
    assert outcome.answered == 0 and outcome.removed == 0 and outcome.objects == 3


def test_a_grasp_in_the_air_fails_and_is_excluded_next_time(gripper, pool):
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 0.6
    planner = Scripted(pose)
    outcome = run_scene(
        ProtocolSettings(scenes=1, graspable=2, obstacles=1), gripper, planner, pool, range(8), 0
    )
    assert [reason for _, reason in outcome.first] == ["no_contact"] * 3
    assert [len(options["exclude"]) for options in planner.asked] == [0, 1, 2]
    assert planner.asked[0]["walls"] and planner.asked[0]["region"] is not None


@pytest.mark.slow
def test_antipodal_baseline_lifts_single_boxes(gripper, pool):
    """Boxes alone on a table are the baseline's home ground."""
    graspable = graspable_objects(gripper, pool)
    assert graspable
    settings = ProtocolSettings(protocol="single", scenes=6, samples=4)
    result = evaluate(settings, gripper, AntipodalPlanner(gripper), pool, graspable)
    content = result.to_json()
    assert content["first"]["trials"] == 6
    assert content["first"]["successes"] >= 2
    assert content["unfiltered"]["trials"] > 0
    assert {"kept_share", "answered_share", "hardware", "config", "drawn", "returned"} <= set(
        content
    )
    json.dumps(content)


def test_the_ceiling_names_only_grasps_that_succeed(gripper, pool):
    settings = ProtocolSettings(scenes=1, graspable=3, obstacles=1)
    planner = CeilingPlanner(gripper, SearchSettings(candidates=200, moved=30, rounds=4))
    outcome = run_scene(settings, gripper, planner, pool, range(8), 0)
    assert outcome.removed > 0
    assert {reason for _, reason in outcome.first} <= {"success", "no_answer"}


def test_the_ceiling_needs_a_world(gripper):
    with pytest.raises(InvalidRequestError, match="look_inside first"):
        CeilingPlanner(gripper).plan(Cloud(np.zeros((1, 3))))


def test_ranked_grasps_are_judged_and_the_state_is_restored(gripper, pool):
    settings = ProtocolSettings(protocol="single", scenes=1, judged=3, drawn=400)
    judged = run_scene(settings, gripper, AntipodalPlanner(gripper), pool, range(8), 0)
    plain = dataclasses.replace(settings, judged=0)
    assert run_scene(plain, gripper, AntipodalPlanner(gripper), pool, range(8), 0).first == (
        judged.first
    )
    (stage,) = judged.judged
    assert 0 < len(stage) <= 3
    assert (stage[0].success, stage[0].reason) == judged.first[0]


class NothingFound(GraspSearch):
    """A search that finds nothing."""

    def find(self, world, goals, rng):
        return None


class WrongOrder(Scripted):
    """Knows a grasp that holds and puts one in the air before it."""

    def __init__(self, search: GraspSearch) -> None:
        super().__init__(AIR)
        self.search = search

    def look_inside(self, world, models):
        self.stage = world, models

    def plan(self, cloud, **options):
        result = super().plan(cloud, **options)
        found = self.search.find(*self.stage, np.random.default_rng(0))
        assert found is not None
        good = dataclasses.replace(
            result.grasps[0],
            world_from_gripper=found,
            world_from_gripper_approach=self.search.stand_off(found),
        )
        return dataclasses.replace(result, grasps=[*result.grasps, good])


AIR = np.diag([1.0, -1.0, -1.0, 1.0])
AIR[2, 3] = 0.6
QUICK = SearchSettings(candidates=200, moved=30, rounds=4)
POSSIBLE = ProtocolSettings(scenes=1, graspable=1, obstacles=0, possible_only=True)


def test_attempts_where_nothing_can_be_lifted_do_not_count(gripper, pool):
    search = NothingFound(gripper)
    outcome = run_scene(POSSIBLE, gripper, Scripted(AIR), pool, range(8), 0, search=search)
    assert (outcome.counted, outcome.unreachable) == (0, 1)
    # The old counting goes on to the third failure.
    assert len(outcome.first) == 3


def test_attempts_where_the_search_finds_a_grasp_count(gripper, pool):
    search = GraspSearch(gripper, QUICK)
    outcome = run_scene(POSSIBLE, gripper, Scripted(AIR), pool, range(8), 1, search=search)
    assert len(outcome.first) == 3
    assert (outcome.counted, outcome.unreachable) == (None, 0)


def test_a_returned_grasp_that_holds_makes_an_attempt_count(gripper, pool):
    planner = WrongOrder(GraspSearch(gripper, QUICK))
    search = NothingFound(gripper)
    outcome = run_scene(POSSIBLE, gripper, planner, pool, range(8), 1, search=search)
    assert outcome.counted is None and len(outcome.first) == 3


def test_the_report_tells_counted_attempts_from_all(gripper, pool, monkeypatch):
    monkeypatch.setattr("megrasp_core.evaluation.report.GraspSearch", NothingFound)
    content = evaluate(POSSIBLE, gripper, Scripted(AIR), pool, range(8)).to_json()
    assert content["first"]["trials"] == 0 and content["first_all"]["trials"] == 3
    assert content["unreachable"] == 1 and content["cleared_of_all"] == 0.0
    (attempts,) = content["attempts"]
    assert attempts["counted"] == 0 and len(attempts["of"]) == 3
    names = {model.name for model in pool}
    assert all(one.partition(": ")[2] in names for one in attempts["of"]), attempts


def test_one_model_plans_and_another_executes(gripper, pool):
    settings = ProtocolSettings(protocol="single", scenes=1, drawn=400, judged=2)
    other = load_gripper("rethink_gripper")
    planner = AntipodalPlanner(gripper)
    result = evaluate(settings, other, planner, pool, range(8), planned_for=gripper.name)
    content = result.to_json()
    assert (content["gripper"], content["executed_with"]) == (gripper.name, other.name)
    assert content["judged"]["trials"] == 2 and "score_auc" in content


def test_same_seed_same_run(gripper, pool):
    settings = ProtocolSettings(scenes=1, graspable=3, obstacles=1, drawn=60)
    runs = [
        run_scene(settings, gripper, AntipodalPlanner(gripper), pool, range(8), 4).first
        for _ in range(2)
    ]
    assert runs[0] == runs[1]


def without_time(result: EvaluationResult) -> dict:
    content = result.to_json()
    for name in ("executor", "workers"):
        del content["config"][name]
    return {name: value for name, value in content.items() if name not in ("seconds", "hardware")}


FEW = ProtocolSettings(protocol="single", scenes=2, samples=2, drawn=4, returned=2)


@pytest.fixture(scope="module")
def model_planner(gripper) -> ModelPlanner:
    """A network of chance, which is enough to be sent to other processes."""
    torch.manual_seed(1)
    model = GraspModel(PRESETS["tiny"]).eval()
    return ModelPlanner(GraspSynthesizer(model, gripper, threads=1))


@pytest.fixture(scope="module")
def done_here(gripper, pool, model_planner) -> dict:
    return without_time(evaluate(FEW, gripper, model_planner, pool, range(8)))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["local", "ray"])
def test_scenes_run_elsewhere_with_the_same_result(
    gripper, pool, model_planner, done_here, kind, request
):
    if kind == "ray":
        request.getfixturevalue("ray_cluster")
    told: list[int] = []
    there = evaluate(
        FEW, gripper, model_planner, pool, range(8),
        executor=ExecutorConfig(kind, workers=2), on_scene=lambda done, _: told.append(done),
    )  # fmt: skip
    assert without_time(there) == done_here
    assert there.to_json()["config"]["executor"] == kind
    assert told == [1, 2]


def test_a_scene_that_fails_elsewhere_ends_the_run(gripper, pool):
    settings = ProtocolSettings(protocol="single", scenes=2)
    with pytest.raises(SimulationError, match="a scene failed after 0 of 2"):
        evaluate(
            settings, gripper, CeilingPlanner(gripper), pool, range(90, 95),
            executor=ExecutorConfig(),
        )  # fmt: skip


def test_bad_settings_are_named():
    with pytest.raises(
        InvalidRequestError, match=r"'juggling' is unknown.*binpick, declutter, single"
    ):
        ProtocolSettings(protocol="juggling")  # type: ignore[arg-type]
    with pytest.raises(InvalidRequestError, match="scenes 0"):
        ProtocolSettings(scenes=0)


def test_default_pool_is_fixed():
    first, again = load_pool(None), load_pool(None)
    assert [m.name for m in first] == [m.name for m in again]
    assert len({m.mass for m in first}) > 10
