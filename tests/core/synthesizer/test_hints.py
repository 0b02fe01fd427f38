"""Hints name the reason that most poses fail for, and what to do."""

from __future__ import annotations

import numpy as np
import pytest

from megrasp_core.grippers import Gripper, load_gripper
from megrasp_core.pointcloud import Cloud, OrientedBox, surface_cloud
from megrasp_core.ranking import gripper_probe
from megrasp_core.synthesizer import RankingSettings, SynthesisRequest
from megrasp_core.synthesizer.hints import hints
from megrasp_core.synthesizer.poses import pose_set
from megrasp_core.synthesizer.scene_judge import SceneJudge

DOWN = np.array([0.0, 0.0, -1.0])


@pytest.fixture(scope="module")
def franka() -> Gripper:
    return load_gripper("franka_hand")


def block_on_a_floor() -> Cloud:
    axis = np.arange(-0.2, 0.2, 0.002)
    x, y = np.meshgrid(axis, axis)
    height = np.where((np.abs(x) <= 0.01) & (np.abs(y) <= 0.03), 0.05, 0.0)
    points = np.column_stack([x.ravel(), y.ravel(), height.ravel()])
    return Cloud(points, None, np.array([0.0, 0.0, 2.0]))


def told(gripper: Gripper, places: list[tuple[float, float, float]], **options) -> list[str]:
    request = SynthesisRequest(seed=0, **options)
    cloud = block_on_a_floor()
    surface = surface_cloud(cloud, gravity=DOWN, region=request.region)
    judge = SceneJudge(surface, request, RankingSettings())
    tcp = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (len(places), 1, 1))
    tcp[:, :3, 3] = places
    poses = pose_set(tcp, gripper, request)
    probe = gripper_probe(gripper)
    found = judge.assess(poses, probe, np.full(len(tcp), 0.9))
    parts = [(found, np.arange(len(found)))]
    return list(hints(parts, judge.observation, probe, request))


def test_a_good_grasp_needs_no_hint(franka: Gripper) -> None:
    assert told(franka, [(0.0, 0.0, 0.03)]) == []


def test_a_wall_in_the_way_is_named_by_its_side(franka: Gripper) -> None:
    narrow = OrientedBox.around((0.05, 0.0, 0.05), (0.14, 0.4, 0.1))
    (hint,) = told(franka, [(0.0, 0.0, 0.03), (0.0, 0.01, 0.03)], region=narrow)
    assert "2 of 2 poses hit the wall on the -x side" in hint
    assert "too small" in hint


def test_objects_higher_than_the_region(franka: Gripper) -> None:
    low = OrientedBox.around((0.0, 0.0, 0.02), (0.3, 0.3, 0.04))
    (hint,) = told(franka, [(0.0, 0.0, 0.11), (0.0, 0.0, 0.12)], region=low)
    assert "higher than the region, by 80 mm" in hint


def test_the_most_frequent_reason_comes_first(franka: Gripper) -> None:
    places = [(0.1, 0.1, 0.03)] * 3 + [(0.0, 0.0, -0.05)] * 2
    first, *others = told(franka, places)
    assert "3 of 5 poses close on nothing" in first
    assert any("below the floor" in text for text in others)
    many = [(0.1, 0.1, 0.03)] * 9 + [(0.0, 0.0, -0.05)]
    assert len(told(franka, many)) == 1
