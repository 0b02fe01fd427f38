"""The rules of bin clearing: shares, tries, giving up, the end."""

import json

import numpy as np
import pytest

from megrasp_core.cell.clearing import FAILURES, ClearingPlan, PickRecord
from megrasp_core.errors import InvalidRequestError


def pose_at(x: float, y: float = 0.0) -> np.ndarray:
    pose = np.eye(4)
    pose[:2, 3] = x, y
    return pose


def attempt(plan: ClearingPlan, success: bool, left: int, pose: np.ndarray | None = None) -> None:
    removed = (f"object_{left}",) if success else ()
    plan.record(
        PickRecord(
            attempt=len(plan.records) + 1,
            gripper=str(plan.gripper),
            success=success,
            reason="" if success else "slipped",
            removed=removed,
            objects_left=left,
        ),
        pose,
    )


def test_every_gripper_takes_its_share():
    plan = ClearingPlan(["a", "b"], 5)
    used = []
    for left in (4, 3, 2, 1, 0):
        used.append(plan.gripper)
        attempt(plan, True, left, pose_at(0))
    assert used == ["a", "a", "a", "b", "b"]
    assert plan.gripper is None
    summary = plan.summary()
    assert summary["cleared"] and summary["ended"] == "the bin is empty"
    assert summary["per_gripper"]["b"] == {"attempts": 2, "successes": 2, "removed": 2}
    assert json.loads(json.dumps(summary))["picks"][0]["removed"] == ["object_4"]


def test_failures_are_excluded_until_something_beside_them_is_lifted():
    plan = ClearingPlan(["a"], 3)
    attempt(plan, False, 3, pose_at(0.1))
    attempt(plan, False, 3, pose_at(0.2))
    np.testing.assert_array_equal([pose[0, 3] for pose in plan.failures.excluded], [0.1, 0.2])
    attempt(plan, True, 2, pose_at(0.25))
    np.testing.assert_array_equal([pose[0, 3] for pose in plan.failures.excluded], [0.1])


def test_three_failures_in_a_row_give_the_object_up():
    plan = ClearingPlan(["a"], 2)
    poses = np.stack([pose_at(0.11), pose_at(0.17), pose_at(0.4)])
    assert plan.choose(poses) == 0
    for _ in range(3):
        assert plan.gripper == "a"
        attempt(plan, False, 2, pose_at(0.1))
    assert plan.gripper == "a"
    assert plan.failures.recent == [] and len(plan.failures.excluded) == 3
    assert plan.choose(poses) == 1
    assert plan.choose(poses[:1]) is None
    assert plan.choose(np.zeros((0, 4, 4))) is None
    for _ in range(3):
        attempt(plan, False, 2, pose_at(0.17))
    assert plan.gripper is None
    assert "2 objects were given up" in plan.summary()["ended"]
    assert plan.summary()["first_grasp_rate"] == 0.0


def test_a_success_in_between_starts_the_count_again():
    plan = ClearingPlan(["a"], 4)
    for left in (4, 4, 3, 3, 3, 2):
        attempt(plan, left < plan.objects_left, left, pose_at(0.1))
    assert plan.gripper == "a"
    assert plan.choose(np.stack([pose_at(0.1)])) == 0


def test_the_next_gripper_may_try_what_the_first_gave_up():
    plan = ClearingPlan(["a", "b"], 1, tries=2)
    attempt(plan, False, 1, pose_at(0.1))
    attempt(plan, False, 1, pose_at(0.1))
    assert plan.gripper == "b"
    assert plan.choose(np.stack([pose_at(0.1)])) == 0
    attempt(plan, True, 0, pose_at(0.1))
    assert plan.gripper is None


def test_no_grasp_counts_as_a_try_and_ends_the_turn():
    plan = ClearingPlan(["a", "b"], 5)
    for _ in range(3):
        assert plan.gripper == "a"
        attempt(plan, False, 5, None)
    assert plan.gripper == "b"


@pytest.mark.parametrize("seed", range(5))
def test_every_run_ends_within_the_tries(seed):
    rng = np.random.default_rng(seed)
    plan = ClearingPlan(["a", "b"], 8)
    left = 8
    while plan.gripper is not None:
        success = bool(rng.random() < 0.2)
        left -= success
        attempt(
            plan,
            success,
            left,
            pose_at(*rng.uniform(-0.2, 0.2, 2)) if rng.random() < 0.8 else None,
        )
        assert len(plan.records) <= 2 * 3 * 8
    per_gripper = plan.summary()["per_gripper"]
    assert all(row["attempts"] <= 3 * 8 for row in per_gripper.values())


def test_two_objects_in_one_grasp_count_as_two():
    plan = ClearingPlan(["a", "b"], 4)
    attempt(plan, True, 2, pose_at(0))
    assert plan.gripper == "b"


def test_stopping_keeps_the_first_reason():
    plan = ClearingPlan(["a"], 2)
    plan.stop("the camera is gone")
    plan.stop("something else")
    assert plan.gripper is None
    assert plan.summary()["ended"] == "the camera is gone"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(([], 3), "no gripper"), ((["a"], -1), "objects = -1")],
)
def test_bad_plans_are_refused(arguments, message):
    with pytest.raises(InvalidRequestError, match=message):
        ClearingPlan(*arguments)
    with pytest.raises(InvalidRequestError, match="tries = 0"):
        ClearingPlan(["a"], 3, tries=0)


def test_undefined_numbers_become_null():
    plan = ClearingPlan(["a"], 1)
    record = PickRecord(1, "a", True, "", ("x",), 0, score=0.5, width=float("nan"))
    plan.record(record, pose_at(0))
    pick = json.loads(json.dumps(plan.summary(), allow_nan=False))["picks"][0]
    assert pick["width"] is None
    assert pick["score"] == 0.5


def test_a_record_prints_on_one_line():
    record = PickRecord(3, "robotiq_2f85", False, "slipped", (), 4, score=0.5, returned=20)
    line = record.line()
    assert "\n" not in line
    for part in ("pick  3", "robotiq_2f85", "0.50", "slipped", "4 left"):
        assert part in line


@pytest.mark.parametrize(
    ("success", "reason", "closed", "failure"),
    [
        (True, "", 0.031, ""),
        (True, "", 0.045, "unexpected_width"),
        (True, "", float("nan"), ""),
        (False, "no_contact", 0.0, "no_contact"),
        (False, "slipped (fell out of the bin: cup)", 0.03, "slipped"),
        (False, "start_collision", None, "start_collision"),
        (False, "the vacuum is off", 0.0, "unexpected_width"),
        (False, "the arm did not come", None, "other"),
    ],
)
def test_a_record_says_what_went_wrong(success, reason, closed, failure):
    record = PickRecord(
        1, "a", success, reason, (), 3, width=0.03, width_tolerance=0.004, closed_width=closed
    )
    assert record.failure == failure
    if failure == "other":
        assert reason in record.line()
    elif not success:
        assert FAILURES[failure] in record.line()
    plan = ClearingPlan(["a"], 4)
    plan.record(record, None)
    assert plan.summary()["failures"] == ({failure: 1} if failure else {})
    assert json.loads(json.dumps(plan.summary()))["picks"][0]["failure"] == failure
