"""An evaluation that was stopped goes on where it was, and with nothing else."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest

from megrasp_core.errors import InvalidRequestError
from megrasp_core.evaluation.kept_scenes import KeptScenes
from megrasp_core.evaluation.outcome import JudgedGrasp, SceneOutcome
from megrasp_core.evaluation.planners import AntipodalPlanner
from megrasp_core.evaluation.protocols import ProtocolSettings
from megrasp_core.evaluation.report import evaluate
from megrasp_core.grippers import Gripper, load_gripper
from megrasp_core.objects import ObjectModel, procedural_object

SETTINGS = ProtocolSettings(protocol="single", scenes=3, samples=3, judged=2)
OUTCOME = SceneOutcome(
    first=[(True, "success"), (False, "slipped")],
    targets=["box", ""],
    sampled=[(False, True, "no_contact")],
    counted=1,
    judged=[[JudgedGrasp(0.9, float("nan"), 0.1, 0.0, 0.004, True, "success", (3,))], []],
    seconds=[0.1 + 0.2],
)


@pytest.fixture(scope="module")
def gripper() -> Gripper:
    return load_gripper("robotiq_2f85")


@pytest.fixture(scope="module")
def pool() -> list[ObjectModel]:
    return [procedural_object(seed) for seed in range(6)]


def kept(out: Path, gripper: Gripper, pool: list[ObjectModel], **changes) -> KeptScenes:
    settings = dataclasses.replace(SETTINGS, **changes)
    return KeptScenes.beside(out, settings, gripper, AntipodalPlanner(gripper), pool, range(6))


def run(scenes: KeptScenes | None, gripper: Gripper, pool: list[ObjectModel], on_scene=None):
    content = evaluate(
        SETTINGS, gripper, AntipodalPlanner(gripper), pool, range(6), kept=scenes,
        on_scene=on_scene,
    ).to_json()  # fmt: skip
    del content["seconds"]
    return content


def test_an_outcome_comes_back_as_it_was() -> None:
    back = SceneOutcome.from_json(json.loads(json.dumps(OUTCOME.to_json())))
    # NaN equals nothing, itself included.
    assert repr(back) == repr(OUTCOME)


def test_a_stopped_evaluation_goes_on_to_the_same_result(gripper, pool, tmp_path) -> None:
    whole = run(None, gripper, pool)
    assert whole["judged_stages"]["any"]["trials"] > 0

    def stop(done: int, _) -> None:
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(kept(tmp_path / "out.json", gripper, pool), gripper, pool, stop)
    again = kept(tmp_path / "out.json", gripper, pool)
    assert list(again.outcomes) == [0, 1]
    done: list[int] = []
    assert run(again, gripper, pool, lambda count, _: done.append(count)) == whole
    assert done == [3]
    again.remove()
    assert not list(tmp_path.iterdir())


def test_what_a_kill_cut_short_is_made_again(gripper, pool, tmp_path) -> None:
    out = tmp_path / "there" / "out.json"
    first = kept(out, gripper, pool)
    for number in (0, 1):
        first.add(number, OUTCOME)
    text = first.path.read_text()
    first.path.write_text(text[:-20])
    second = kept(out, gripper, pool)
    assert list(second.outcomes) == [0]
    second.add(1, OUTCOME)
    assert second.path.read_text() == text


@pytest.mark.parametrize(
    ("change", "said"), [({"friction": 0.5}, "settings"), ({"seed": 2}, "settings")]
)
def test_scenes_of_another_run_are_refused(change, said, gripper, pool, tmp_path) -> None:
    kept(tmp_path / "out.json", gripper, pool).add(0, OUTCOME)
    with pytest.raises(InvalidRequestError, match=f"differs in {said}.*another --out"):
        kept(tmp_path / "out.json", gripper, pool, **change)
    # More scenes of the same kind go on.
    assert list(kept(tmp_path / "out.json", gripper, pool, scenes=9).outcomes) == [0]


def test_a_run_without_scenes_goes_on_and_gives_way(gripper, pool, tmp_path) -> None:
    out = tmp_path / "out.json"
    first = kept(out, gripper, pool)
    assert not first.begun
    first.begin()
    again = kept(out, gripper, pool)
    assert again.begun and not again.outcomes
    other = kept(out, gripper, pool, friction=0.5)
    assert not other.begun
    other.add(0, OUTCOME)
    assert list(kept(out, gripper, pool, friction=0.5).outcomes) == [0]


def test_another_file_is_not_written_into(gripper, pool, tmp_path) -> None:
    (tmp_path / "out.json.part").write_text("somebody's notes\n")
    with pytest.raises(InvalidRequestError, match="expected those of this run"):
        kept(tmp_path / "out.json", gripper, pool)
    assert (tmp_path / "out.json.part").read_text() == "somebody's notes\n"
