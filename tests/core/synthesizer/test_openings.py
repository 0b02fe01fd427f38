"""Grasps that start less than fully open, fingers that sweep, the way out, which object it is."""

from __future__ import annotations

import numpy as np
import pytest

from megrasp_core.errors import InvalidRequestError
from megrasp_core.grippers import Gripper, load_gripper
from megrasp_core.pointcloud import Cloud, OrientedBox, surface_cloud
from megrasp_core.ranking import GripperProbe, gripper_probe
from megrasp_core.synthesizer import RankingSettings, SynthesisRequest
from megrasp_core.synthesizer.objects import LabelledObjects
from megrasp_core.synthesizer.poses import pose_set
from megrasp_core.synthesizer.repairs import backed_off, turned_over
from megrasp_core.synthesizer.scene_judge import Assessment, SceneJudge

DOWN = np.array([0.0, 0.0, -1.0])
SENSOR = np.array([0.0, 0.0, 2.0])
Box = tuple[float, float, float, float, float]
"""Middle x, y, edges along x, y, height (m)."""


def heap(boxes: list[Box]) -> Cloud:
    """What a camera far above sees of boxes on a table: a height for each place, with labels."""
    axis = np.arange(-0.2, 0.2, 0.002)
    x, y = np.meshgrid(axis, axis)
    height, label = np.zeros_like(x), np.zeros(x.shape, dtype=np.int32)
    for number, (middle_x, middle_y, wide, long, top) in enumerate(boxes, start=1):
        on = (np.abs(x - middle_x) <= wide / 2) & (np.abs(y - middle_y) <= long / 2)
        height[on], label[on] = top, number
    points = np.column_stack([x.ravel(), y.ravel(), height.ravel()])
    return Cloud(points, None, SENSOR, label.ravel())


def judge_of(cloud: Cloud, request: SynthesisRequest | None = None) -> SceneJudge:
    request = request or SynthesisRequest(seed=0)
    surface = surface_cloud(cloud, gravity=DOWN, region=request.region)
    objects = LabelledObjects.of(surface, request.target)
    return SceneJudge(surface, request, RankingSettings(), objects)


def from_above(x: float, y: float, z: float) -> np.ndarray:
    """TCP pose (1, 4, 4) that looks down, closing along x."""
    tcp = np.diag([1.0, -1.0, -1.0, 1.0])
    tcp[:3, 3] = x, y, z
    return tcp[None]


def assessed(judge: SceneJudge, gripper: Gripper, tcp: np.ndarray) -> Assessment:
    poses = pose_set(tcp, gripper, judge.request)
    return judge.assess(poses, gripper_probe(gripper), np.full(len(tcp), 0.9))


@pytest.fixture(scope="module")
def franka() -> Gripper:
    return load_gripper("franka_hand")


@pytest.fixture(scope="module")
def adaptive() -> Gripper:
    return load_gripper("robotiq_2f85")


@pytest.fixture(scope="module")
def probe(adaptive: Gripper) -> GripperProbe:
    return gripper_probe(adaptive)


NEIGHBOURS = [(-0.062, 0.0, 0.036, 0.2, 0.05), (0.062, 0.0, 0.036, 0.2, 0.05)]
"""Blocks that leave 88 mm between them: less than an open hand with its fingers needs."""


def test_a_grasp_between_neighbours_starts_less_open(franka: Gripper) -> None:
    one = (0.0, 0.0, 0.02, 0.06, 0.05)
    found = assessed(judge_of(heap([one, *NEIGHBOURS])), franka, from_above(0, 0, 0.03))
    assert found.check.reason[0] == ""
    assert 0.3 < found.share[0] < 0.7
    assert 0.02 < found.opening[0] < 0.05
    free = assessed(judge_of(heap([one])), franka, from_above(0, 0, 0.03))
    assert free.share[0] == 0.0
    assert free.opening[0] == pytest.approx(0.08, abs=0.002)


def test_the_opening_leaves_room_for_what_it_is_to_grasp(franka: Gripper) -> None:
    one = (0.0, 0.0, 0.05, 0.06, 0.05)
    found = assessed(judge_of(heap([one, *NEIGHBOURS])), franka, from_above(0, 0, 0.03))
    assert found.check.reason[0] == "collision"


def test_openings_follow_the_stroke(adaptive: Gripper, probe: GripperProbe) -> None:
    openings = [one.opening for one in (probe, *probe.narrower)]
    assert openings == sorted(openings, reverse=True)
    assert openings[0] == pytest.approx(0.085, abs=0.003)
    # The links of the 2F-85 carry its tips forward while they close.
    tips = [one.points[:, 2].max() for one in (probe, *probe.narrower)]
    assert tips == sorted(tips)
    assert tips[-1] > tips[0] + 0.008
    half = adaptive.posture_at(0.5)
    assert adaptive.share_of(half) == pytest.approx(0.5, abs=0.01)
    assert adaptive.posture_at(0.0) == adaptive.open_joints


def test_tips_that_would_close_into_the_floor_are_moved_back(adaptive: Gripper) -> None:
    thin = (0.0, 0.0, 0.02, 0.06, 0.03)
    judge = judge_of(heap([thin]))
    reach = gripper_probe(adaptive).points[:, 2].max() - adaptive.tcp[2]
    low = from_above(0, 0, reach + 0.003)
    found = assessed(judge, adaptive, low)
    assert found.check.reason[0] == "sweep"
    saved = backed_off(found, lambda tcp: assessed(judge, adaptive, tcp), judge.settings.sweep)
    assert saved.check.reason[0] == ""
    raised = saved.poses.tcp[0, 2, 3] - low[0, 2, 3]
    assert 0.003 <= raised <= 0.015 + 1e-9
    high = assessed(judge, adaptive, from_above(0, 0, reach + 0.02))
    assert high.check.reason[0] == ""


def test_straight_fingers_close_along_the_floor(franka: Gripper) -> None:
    thin = (0.0, 0.0, 0.02, 0.06, 0.03)
    reach = gripper_probe(franka).points[:, 2].max() - franka.tcp[2]
    found = assessed(judge_of(heap([thin])), franka, from_above(0, 0, reach + 0.003))
    assert found.check.reason[0] == ""


def test_a_grasp_from_below_is_turned_over(franka: Gripper) -> None:
    judge = judge_of(heap([(0.0, 0.0, 0.03, 0.06, 0.05)]))
    below = from_above(0, 0, 0.03) @ np.diag([1.0, -1.0, -1.0, 1.0])
    found = assessed(judge, franka, below)
    assert found.check.reason[0] != ""
    turned, rows = turned_over(found, lambda tcp: assessed(judge, franka, tcp))
    assert rows.tolist() == [0]
    assert turned.check.reason[0] == ""
    np.testing.assert_allclose(turned.poses.tcp[0, :3, 3], below[0, :3, 3])
    np.testing.assert_allclose(turned.poses.tcp[0, :3, 2], [0, 0, -1], atol=1e-12)


def test_the_way_out_is_up_or_back_along_the_approach(franka: Gripper) -> None:
    block = (0.0, 0.0, 0.03, 0.06, 0.05)
    free = assessed(judge_of(heap([block])), franka, from_above(0, 0, 0.03))
    step = free.poses.retreat[0, :3, 3] - free.poses.gripper[0, :3, 3]
    np.testing.assert_allclose(step, [0, 0, 0.2], atol=1e-9)
    # From the side, under the rim of a bin that leans over: up ends in the wall.
    side = np.array([[[0, 1, 0, 0], [0, 0, -1, 0], [-1, 0, 0, 0], [0, 0, 0, 1.0]]])
    leaning = np.eye(4)
    angle = np.deg2rad(40)
    leaning[:3, :3] = [
        [np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)],
    ]  # fmt: skip
    leaning[2, 3] = 0.1
    region = OrientedBox(leaning, np.array([0.5, 0.4, 0.4]))
    request = SynthesisRequest(seed=0, region=region, approach_distance=0.05)
    judge = judge_of(heap([block]), request)
    side[0, :3, 3] = 0.0, 0.0, 0.03
    poses = pose_set(side, franka, request)
    assert np.isfinite(poses.retreat).all()
    up = pose_set(side, franka, request).retreat[0, :3, 3] - poses.gripper[0, :3, 3]
    np.testing.assert_allclose(up, [0, 0, 0.2], atol=1e-9)
    found = assessed(judge, franka, side)
    if found.check.reason[0] == "":
        np.testing.assert_allclose(found.poses.retreat, found.poses.approach)


def test_which_object_is_grasped(franka: Gripper) -> None:
    boxes = [(-0.08, 0.0, 0.03, 0.06, 0.05), (0.08, 0.0, 0.03, 0.06, 0.04)]
    poses = np.concatenate(
        [from_above(-0.08, 0, 0.03), from_above(0.08, 0, 0.03), from_above(0, 0.1, 0.03)]
    )
    found = assessed(judge_of(heap(boxes)), franka, poses)
    assert found.object.tolist() == [1, 2, 0]
    wanted = assessed(judge_of(heap(boxes), SynthesisRequest(seed=0, target=2)), franka, poses)
    assert wanted.check.reason.tolist()[:2] == ["object", ""]


def test_a_target_without_points_is_refused() -> None:
    cloud = heap([(0.0, 0.0, 0.03, 0.06, 0.05)])
    with pytest.raises(InvalidRequestError, match=r"target 4 .* labels of the mask: 1"):
        judge_of(cloud, SynthesisRequest(seed=0, target=4))
    unlabelled = Cloud(cloud.points, None, SENSOR)
    with pytest.raises(InvalidRequestError, match="none"):
        judge_of(unlabelled, SynthesisRequest(seed=0, target=4))


def test_grasps_below_the_least_score_are_rejected(franka: Gripper) -> None:
    cloud = heap([(0.0, 0.0, 0.03, 0.06, 0.05)])
    request = SynthesisRequest(seed=0, min_score=0.95)
    found = assessed(judge_of(cloud, request), franka, from_above(0, 0, 0.03))
    assert found.check.reason[0] == "score"
