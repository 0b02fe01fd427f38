"""The search for postures: its directions, its halving, its memory, one true trial."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from megrasp_core.cli import main
from megrasp_core.errors import CancelledError, DataError, InvalidRequestError
from megrasp_core.gripper_tools import posture_search
from megrasp_core.gripper_tools.posture_search import PostureSearch, PostureSearchSettings
from megrasp_core.gripper_tools.posture_space import PostureSpace
from megrasp_core.gripper_tools.posture_trials import Tally, Task, measure
from megrasp_core.grippers import Gripper, load_gripper

SMALL = PostureSearchSettings(variants=9, rounds=2, objects=2, candidates=10, held_out=3)


def test_directions_of_the_allegro_hand() -> None:
    """Equal joints of the fingers go together; the outer fingers spread, the middle one stays."""
    hand = load_gripper("allegro_hand")
    space = PostureSpace(hand)
    joints = [dict(direction.joints) for direction in space.directions]
    assert {"ffj1": 1.0, "mfj1": 1.0, "rfj1": 1.0} in joints
    assert {"thj2": 1.0} in joints
    spread = next(found for found in joints if "ffj0" in found)
    assert set(spread) == {"ffj0", "rfj0"}
    offsets = [0.0] * len(space)
    offsets[joints.index(spread)] = 0.1
    moved = Gripper(space.describe(offsets))
    before, after = (
        [g.body_poses("open")[g.model.body(f"{f}_distal").id, 1, 3] for f in ("ff", "rf")]
        for g in (hand, moved)
    )
    assert abs(after[0] - after[1]) > abs(before[0] - before[1]) + 0.005
    assert moved.closed_joints == pytest.approx(hand.closed_joints, abs=1e-4)


def test_directions_of_the_shadow_hand() -> None:
    """Joints of one tendon go together; folded fingers and the wrist stay."""
    space = PostureSpace(load_gripper("shadow_hand_2f"))
    named = {joint for direction in space.directions for joint, _ in direction.joints}
    assert {"rh_FFJ1", "rh_FFJ2"} in [set(dict(d.joints)) for d in space.directions]
    assert not any(name.startswith(("rh_MF", "rh_RF", "rh_LF", "rh_WR")) for name in named)


def test_offsets_stay_within_the_limits() -> None:
    """However far they are, and no offset leaves the postures as they are."""
    hand = load_gripper("shadow_dexee")
    space = PostureSpace(hand)
    far = Gripper(space.describe([9.0] * len(space)))
    assert far.open_joints["F0/J1"] == pytest.approx(0.7854, abs=1e-4)
    same = Gripper(space.describe([0.0] * len(space)))
    assert same.open_joints == pytest.approx(hand.open_joints, abs=1e-4)
    drawn = [space.draw([0.0] * len(space), 0.1, np.random.default_rng(i)) for i in range(9)]
    assert len(set(drawn)) == 9
    with pytest.raises(InvalidRequestError, match="expected 16, one per direction and posture"):
        space.describe([0.0])


def test_jaws_are_refused() -> None:
    """They have one closing motion."""
    with pytest.raises(InvalidRequestError, match="is of kind 'parallel'; expected a hand"):
        PostureSpace(load_gripper("franka_hand"))


def planted(task: Task, gripper: str, seed: int) -> Tally:
    """Held grasps as they would be if the best posture lay 0.2 rad from the listed one."""
    away = np.linalg.norm(np.asarray(task.offsets) - 0.2 / np.sqrt(len(task.offsets)))
    held = round(task.candidates * float(np.exp(-4.0 * away)))
    return Tally(task.candidates, 0, held, 1, int(held > 0))


def test_search_finds_a_planted_optimum(monkeypatch: pytest.MonkeyPatch) -> None:
    """Better than the listed posture on the held-out objects, the same again with the seed."""
    monkeypatch.setattr(posture_search, "measure", planted)
    settings = PostureSearchSettings(variants=81, rounds=4, objects=1, candidates=1000, held_out=2)
    result = PostureSearch("allegro_hand", settings).run()
    rates = [result[name]["held_out"]["grasps"]["rate"] for name in ("listed", "found")]
    assert rates[1] > rates[0] + 0.05
    assert PostureSearch("allegro_hand", settings).run() == result
    assert result["found"]["search"]["grasps"]["trials"] == 27 * 1000


def test_rungs() -> None:
    """A third goes on, to three times the objects, down to one."""
    assert PostureSearch("allegro_hand", SMALL).rungs() == [(9, 2), (3, 6)]


def test_search_goes_on_where_it_was_stopped(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Stopped in the middle it says so; the second run does only what is missing."""
    file = tmp_path / "m.trials.jsonl"
    done: list[Task] = []

    def counted(task: Task, gripper: str, seed: int) -> Tally:
        if len(done) == 20:
            done.append(task)
            raise KeyboardInterrupt
        done.append(task)
        return planted(task, gripper, seed)

    monkeypatch.setattr(posture_search, "measure", counted)
    with pytest.raises(CancelledError, match="run the same command again"):
        PostureSearch("allegro_hand", SMALL, file).run()
    with file.open("a") as half:
        half.write("[[0.1, 0.2")
    seen: list[tuple[int, int]] = []
    search = PostureSearch(
        "allegro_hand", SMALL, file, on_progress=lambda n, all: seen.append((n, all))
    )
    result = search.run()
    assert seen[0][0] == 21 and seen[-1][0] <= seen[-1][1]
    assert len(set(done)) == len(done) - 1
    assert result == PostureSearch("allegro_hand", SMALL).run()
    again = len(done)
    assert PostureSearch("allegro_hand", SMALL, file).run() == result
    assert len(done) == again
    other = PostureSearchSettings(seed=5)
    with pytest.raises(DataError, match=r'expected \{"gripper_hash": .* "seed": 5\}'):
        PostureSearch("allegro_hand", other, file)


def test_wrong_settings() -> None:
    """Numbers that make no search are named."""
    with pytest.raises(InvalidRequestError, match="variants 0"):
        PostureSearchSettings(variants=0)
    with pytest.raises(InvalidRequestError, match="scale -1"):
        PostureSearchSettings(scale=-1)


@pytest.mark.slow
def test_true_trials() -> None:
    """One object, ten grasps: the same counts again; a hand that stays open holds nothing."""
    space = PostureSpace(load_gripper("shadow_dexee"))
    zero = (0.0,) * len(space)
    seed = posture_search.SEARCH_SEED
    first = measure(Task(zero, seed, 10, 0.004), "shadow_dexee", 0)
    assert first == measure(Task(zero, seed, 10, 0.004), "shadow_dexee", 0)
    assert first.drawn == 10 and first.objects == 1 and 0 < first.held <= 10 - first.blocked
    names = [direction.name for direction in space.directions]
    open_only = [0.0] * len(space)
    for name in ("F1/J1+F2/J1", "F0/J1"):
        open_only[len(names) + names.index(name)] = -0.85
    assert measure(Task(tuple(open_only), seed, 10, 0.004), "shadow_dexee", 0).held == 0


@pytest.mark.slow
def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Writes the file, prints both rates; says 1 where nothing better was found."""
    out = tmp_path / "found.json"
    size = ["--rounds", "0", "--held-out", "2"]
    code = main(["gripper", "postures", "shadow_dexee", "--out", str(out), *size])
    result = json.loads(out.read_text())
    assert code == 1 and result["found"] == result["listed"]
    assert result["listed"]["held_out"]["grasps"]["trials"] == result["trials"] == 20
    assert "of 20 grasps held (95 %" in capsys.readouterr().out
    assert main(["gripper", "postures", "franka_hand", "--out", str(out)]) == 2
