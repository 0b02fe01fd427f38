"""Duplicates, exclusions, counts and the score."""

from __future__ import annotations

import numpy as np
import pytest

from megrasp_core.ranking import (
    Calibration,
    Contacts,
    GraspCheck,
    RankSettings,
    excluded,
    rejection_counts,
    score_grasps,
    suppress_duplicates,
)


def turned(axis: str, degrees: float, xyz=(0.0, 0.0, 0.0), base: np.ndarray | None = None):
    """A pose (4, 4), turned about its own axis."""
    a = np.deg2rad(degrees)
    c, s = np.cos(a), np.sin(a)
    rotations = {
        "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
        "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
    }
    pose = np.eye(4)
    pose[:3, :3] = (np.eye(3) if base is None else base) @ np.array(rotations[axis])
    pose[:3, 3] = xyz
    return pose


def suppressed(*poses: np.ndarray, symmetry: int = 1, score=None) -> list[bool]:
    values = np.linspace(1.0, 0.5, len(poses)) if score is None else np.asarray(score)
    return suppress_duplicates(np.stack(poses), values, symmetry).tolist()


def test_near_poses_are_duplicates_and_the_better_one_stays():
    near = turned("x", 5, (0.004, 0, 0))
    assert suppressed(np.eye(4), near) == [False, True]
    assert suppressed(np.eye(4), near, score=[0.2, 0.9]) == [True, False]


@pytest.mark.parametrize(
    "other", [turned("x", 0, (0.012, 0, 0)), turned("x", 18), turned("z", 180), turned("z", 90)]
)
def test_poses_beyond_1_cm_or_15_degrees_are_not(other):
    assert suppressed(np.eye(4), other) == [False, False]


def test_half_turns_are_duplicates_modulo_the_symmetry():
    assert suppressed(np.eye(4), turned("z", 180), symmetry=2) == [False, True]
    assert suppressed(np.eye(4), turned("z", 190), symmetry=2) == [False, True]
    assert suppressed(np.eye(4), turned("z", 90), symmetry=2) == [False, False]
    assert suppressed(np.eye(4), turned("z", 120), symmetry=3) == [False, True]
    tilted = turned("x", 40)
    both = tilted, turned("z", 180, base=tilted[:3, :3])
    assert suppressed(*both, symmetry=2) == [False, True]


def test_a_suppressed_pose_suppresses_nothing():
    chain = [turned("x", 0, (0.008 * i, 0, 0)) for i in range(3)]
    assert suppressed(*chain) == [False, True, False]


def test_excluded_poses_are_those_near_a_failed_one():
    failed = np.stack([turned("z", 0)])
    poses = np.stack(
        [
            turned("z", 5, (0.015, 0, 0)),
            turned("z", 180),
            turned("x", 60),
            turned("z", 0, (1, 0, 0)),
        ]
    )
    assert excluded(poses, failed, 0.02, symmetry=2).tolist() == [True, True, False, False]
    assert excluded(poses, failed, 0.02, symmetry=1).tolist() == [True, False, False, False]
    assert not excluded(poses, np.zeros((0, 4, 4)), 0.02).any()


def test_counts_per_reason():
    reasons = np.array(["", "collision", "collision", "empty", ""])
    assert rejection_counts(reasons) == {
        "collision": 2,
        "unseen": 0,
        "workspace": 0,
        "tilt": 0,
        "duplicate": 0,
        "empty": 1,
    }


def some_check(unseen=0.0, clearance=0.01, n: int = 1) -> GraspCheck:
    zeros = np.zeros(n)
    return GraspCheck(
        reason=np.full(n, "", dtype="<U12"),
        collision_depth=zeros,
        inside=zeros,
        approach_inside=zeros,
        structure=zeros,
        unseen_share=np.full(n, unseen),
        hidden_share=zeros.copy(),
        clearance=np.full(n, clearance),
        tilt=zeros,
    )


def some_contacts(quality: float) -> Contacts:
    one = np.ones(1)
    return Contacts(one.astype(int), 0.03 * one, 0 * one, 0.01 * one, one, quality * one, 0 * one)


def test_without_a_calibration_the_score_is_the_confidence():
    score = score_grasps(some_check(unseen=0.1, clearance=0.0), None, np.array([0.83]))
    assert score[0] == pytest.approx(0.83)


def test_a_calibrated_score_falls_with_what_speaks_against_a_grasp():
    settings = RankSettings(calibration=Calibration(tilt=-3.0, hidden=-1.0, clearance=80.0))
    best = score_grasps(some_check(), None, np.array([0.8]), settings)[0]
    hidden, tight, tilted = some_check(), some_check(clearance=0.0), some_check()
    hidden.hidden_share += 0.002
    tilted.tilt = np.full(1, 0.4)
    for check in (hidden, tight, tilted):
        assert 0 < score_grasps(check, None, np.array([0.8]), settings)[0] < best - 0.02
    assert score_grasps(some_check(), None, np.array([0.4]), settings)[0] < best


def test_without_a_confidence_the_score_falls_too():
    best = score_grasps(some_check(), some_contacts(1.0), None)[0]
    for check, contacts in (
        (some_check(unseen=0.1), some_contacts(1.0)),
        (some_check(clearance=0.0), some_contacts(1.0)),
        (some_check(), some_contacts(0.2)),
    ):
        assert 0 < score_grasps(check, contacts, None)[0] < best


def test_without_a_confidence_the_contact_quality_makes_the_score():
    good = score_grasps(some_check(), some_contacts(0.9), None)[0]
    poor = score_grasps(some_check(), some_contacts(0.3), None)[0]
    assert good == pytest.approx(0.9) and poor == pytest.approx(0.3)
    assert 0 < score_grasps(some_check(), None, None)[0] < 1
