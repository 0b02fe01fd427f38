"""Scenes with a known mistake: the explanation names it first."""

from __future__ import annotations

import dataclasses
import json
import re
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest
import torch
from bin_clouds import bin_meshes, block, pose, seen, table
from PIL import Image

from megrasp_core.explanation import Explanation, explain, setup_findings, write_explanation
from megrasp_core.lie import PoseBatch
from megrasp_core.network import PRESETS, GraspModel
from megrasp_core.pointcloud import Cloud, OrientedBox
from megrasp_core.ranking import Calibration, PointState
from megrasp_core.synthesizer import GraspSynthesizer, SynthesisRequest, SynthesizerSettings
from megrasp_core.synthesizer.run import SynthesisRun

DRAWN = 16
BLOCKS = ((-0.08, -0.05), (0.0, 0.06), (0.09, -0.03))
Explained = Callable[..., Explanation]


@pytest.fixture(scope="module")
def synthesizer() -> GraspSynthesizer:
    torch.manual_seed(0)
    model = GraspModel(PRESETS["tiny"], model_id="random").eval()
    settings = SynthesizerSettings().without(["polish", "turns"])
    return GraspSynthesizer(model, "franka_hand", settings=settings, threads=1)


@pytest.fixture
def explained(synthesizer: GraspSynthesizer, monkeypatch: pytest.MonkeyPatch) -> Explained:
    """Explains a synthesis that draws poses as a trained model does: from above, closing along x,
    on objects at `places`; all tilted about x by `tilt` (rad).
    """
    lean, at = [0.0], [np.zeros((0, 3))]

    def from_above(self: SynthesisRun, field: object, starts: torch.Tensor) -> PoseBatch:
        c, s = np.cos(lean[0]), np.sin(lean[0])
        turn = np.array([[1, 0, 0], [0, -c, -s], [0, s, -c]])
        rotation = torch.tensor(turn, dtype=starts.dtype).expand(len(starts), 3, 3)
        places = np.resize(at[0], (len(starts), 3)) - self.centroid
        places[:, 1] += np.linspace(-0.01, 0.01, len(places))
        return PoseBatch(rotation, torch.tensor(places, dtype=starts.dtype))

    def as_they_are(self: SynthesisRun, field: object, poses: PoseBatch) -> PoseBatch:
        return poses

    monkeypatch.setattr(SynthesisRun, "_descend", from_above)
    monkeypatch.setattr(SynthesisRun, "_refine", as_they_are)

    def run(
        cloud: Cloud,
        tilt: float = 0.0,
        places: Iterable[tuple[float, ...]] = BLOCKS,
        **options: object,
    ) -> Explanation:
        lean[0] = tilt
        at[0] = np.array([(*place, 0.045)[:3] for place in places])
        request = SynthesisRequest.of(num_grasps=4, drawn=DRAWN, seed=1, **options)
        return explain(synthesizer, cloud, request)

    return run


@pytest.fixture(scope="module")
def bin_scene() -> tuple[Cloud, OrientedBox]:
    """A bin on a table with three blocks that stand apart."""
    walls, inside = bin_meshes(pose())
    stand = [block((x - 0.015, y - 0.025, 0.0), (x + 0.015, y + 0.025, 0.06)) for x, y in BLOCKS]
    return seen([*walls, *stand, table().moved(pose(z=-0.005))]), inside


def moved(box: OrientedBox, x: float = 0.0, z: float = 0.0) -> OrientedBox:
    return box.transformed(pose(x=x, z=z))


def cause(explanation: Explanation) -> str:
    assert explanation.causes
    return explanation.causes[0]


def test_a_right_region_is_not_doubted(explained: Explained, bin_scene) -> None:
    cloud, inside = bin_scene
    assert explained(cloud, region=inside).setup.told == ()


@pytest.mark.parametrize(
    ("shift", "words"),
    [
        ({"x": 0.03}, r"(29|30|31) mm to -x of the region"),
        ({"x": -0.05}, r"(49|50|51) mm to \+x of the region"),
        ({"z": 0.03}, r"floor (29|30|31) mm under the region's bottom"),
        ({"z": -0.03}, r"floor (29|30|31) mm over the region's bottom"),
    ],
)
def test_a_region_off_the_bin_is_the_first_cause(bin_scene, shift, words) -> None:
    cloud, inside = bin_scene
    request = SynthesisRequest(region=moved(inside, **shift))
    told = setup_findings(cloud, request).told
    assert re.search(words, told[0])


def test_the_region_that_is_proposed_fits(bin_scene) -> None:
    cloud, inside = bin_scene
    request = SynthesisRequest(region=moved(inside, x=0.03))
    found = setup_findings(cloud, request).found
    assert found is not None
    np.testing.assert_allclose(found.centre, inside.centre, atol=0.003)
    assert setup_findings(cloud, SynthesisRequest(region=found)).told == ()


def test_a_region_beside_everything_is_refused_and_drawn(
    explained: Explained, bin_scene, tmp_path: Path
) -> None:
    cloud, inside = bin_scene
    explanation = explained(cloud, region=moved(inside, x=3.0))
    assert explanation.answer is None
    assert "none of the" in cause(explanation) and "region" in cause(explanation)
    write_explanation(explanation, tmp_path)
    content = json.loads((tmp_path / "explanation.json").read_text())
    assert content["refused"] and content["cause"] == cause(explanation)
    assert (tmp_path / "map.png").is_file()


def test_a_floor_that_is_said_to_be_higher_than_it_is(explained: Explained) -> None:
    stand = [block((x - 0.015, y - 0.025, 0.0), (x + 0.015, y + 0.025, 0.06)) for x, y in BLOCKS]
    cloud = seen([table(0.3), *stand])
    explanation = explained(cloud, floor=0.03)
    assert "the floor was given where" in cause(explanation)
    assert any("30 mm under the given floor: lower it" in text for text in explanation.causes)
    low = setup_findings(cloud, SynthesisRequest(floor=-0.04)).told
    assert "40 mm over the given floor: raise it" in low[0]
    assert setup_findings(cloud, SynthesisRequest(floor=0.0)).told == ()


def test_a_sensor_below_the_scene(explained: Explained, bin_scene) -> None:
    cloud, inside = bin_scene
    explanation = explained(cloud, region=inside, sensor=(0.03, -0.02, -0.6))
    assert "sensor at 0.03 -0.02 -0.6 lies below" in cause(explanation)


def test_a_sensor_that_was_elsewhere(explained: Explained, bin_scene) -> None:
    cloud, inside = bin_scene
    explanation = explained(cloud, region=inside, sensor=(0.9, 0.0, 0.35))
    assert "cannot have been seen from the sensor at 0.90 0.00 0.35" in cause(explanation)


def test_a_wall_too_near(explained: Explained) -> None:
    walls, inside = bin_meshes(pose())
    against = [block((-0.196, y - 0.025, 0.0), (-0.166, y + 0.025, 0.06)) for y in (-0.06, 0.06)]
    cloud = seen([*walls, *against, table().moved(pose(z=-0.005))])
    explanation = explained(cloud, places=[(-0.181, -0.06), (-0.181, 0.06)], region=inside)
    assert re.search(r"16 of 16 poses hit the wall on the -x side", cause(explanation))
    (miss,) = (one for one in explanation.misses if one.reason == "collision")
    assert "points in the -x wall" in miss.how
    wall = miss.points[miss.state == PointState.WALL]
    assert len(wall) and (wall[:, 0] < -0.2).all()


def test_a_gripper_wider_than_the_bin(explained: Explained) -> None:
    walls, inside = bin_meshes(pose(), inner=(0.15, 0.30, 0.15))
    stand = [block((-0.015, y - 0.025, 0.0), (0.015, y + 0.025, 0.03)) for y in (-0.06, 0.06)]
    cloud = seen([*walls, *stand, table().moved(pose(z=-0.005))])
    places = [(0.0, -0.06, 0.02), (0.0, 0.06, 0.02)]
    first = cause(explained(cloud, places=places, region=inside))
    assert "hit the walls on both sides along x" in first and "is 150 mm" in first


def test_limits_that_forbid_everything(explained: Explained, bin_scene) -> None:
    cloud, inside = bin_scene
    first = cause(explained(cloud, region=inside, tilt=0.3, max_tilt=0.1))
    assert "steeper than max_tilt 0.10 rad, the least of them by 0.20" in first
    unsure = explained(cloud, region=inside, min_score=0.999)
    assert any("less than min_score 0.999, the best with 0." in text for text in unsure.causes)


def test_the_page_has_what_happened_to_every_pose(
    explained: Explained, bin_scene, tmp_path: Path
) -> None:
    cloud, inside = bin_scene
    explanation = explained(cloud, region=moved(inside, x=0.16))
    page = write_explanation(explanation, tmp_path, "cell")
    content = json.loads((tmp_path / "explanation.json").read_text())
    assert content["frame"] == "cell" and len(content["poses"]) == DRAWN
    reasons = Counter(one["reason"] for one in content["poses"])
    assert reasons.pop("", 0) == len(content["grasps"])
    assert reasons == {name: one["count"] for name, one in content["reasons"].items()}
    html = page.read_text()
    for name, one in content["reasons"].items():
        assert name in html
        if "near_miss" in one:
            with Image.open(tmp_path / one["near_miss"]["picture"]) as picture:
                assert picture.width > 800
            assert one["near_miss"]["picture"] in html
    assert any(one.get("near_miss", {}).get("points") for one in content["reasons"].values())


def test_far_from_the_origin_poses_are_told_in_the_frame_of_the_cloud(
    explained: Explained, bin_scene, tmp_path: Path
) -> None:
    cloud, inside = bin_scene
    far = np.array([400.0, -200.0, 0.0])
    explanation = explained(cloud.moved(far), region=moved(inside).transformed(pose(*far)))
    assert explanation.setup.told == ()
    write_explanation(explanation, tmp_path)
    content = json.loads((tmp_path / "explanation.json").read_text())
    starts = np.array([one["start"] for one in content["poses"]])
    ends = np.array([one["world_from_tcp_drawn"][:3] for one in content["poses"]])
    assert (np.abs(ends - far - inside.centre) < inside.size / 2).all()
    assert (np.abs(starts - far - inside.centre) < inside.size / 2 + 0.12).all()


def test_terms_make_the_score_of_a_calibrated_model(
    synthesizer: GraspSynthesizer, explained: Explained, bin_scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    stated = Calibration(bias=0.7, confidence=1.6, tilt=-0.4, hidden=-0.2, clearance=90.0)
    info = dataclasses.replace(synthesizer.model.info, heads=("confidence",), calibration=stated)
    monkeypatch.setattr(synthesizer.model, "info", info)
    cloud, inside = bin_scene
    explanation = explained(cloud, region=inside)
    assert explanation.calibration == stated and explanation.returned
    for grasp in explanation.returned:
        terms = explanation.terms(grasp)
        assert terms["bias"] == 0.7
        logit = np.log(grasp.score) - np.log1p(-grasp.score)
        assert sum(terms.values()) == pytest.approx(logit, abs=0.005)
    poses = np.stack([grasp.world_from_tcp for grasp in explanation.returned])
    assessed = synthesizer.assess(cloud, poses, region=inside)
    scores = [grasp.score for grasp in explanation.returned]
    np.testing.assert_allclose(assessed.score, scores, atol=1e-4)


def test_the_region_that_is_proposed_far_away_fits(explained: Explained, bin_scene) -> None:
    cloud, inside = bin_scene
    far = np.array([400.0, -200.0, 0.0])
    region = inside.transformed(pose(*far))
    first = cause(explained(cloud.moved(far), region=moved(region, x=0.03)))
    given = re.search(r"pose \[([-\d.e]+), ([-\d.e]+), ([-\d.e]+),", first)
    assert given is not None
    np.testing.assert_allclose([float(one) for one in given.groups()], region.centre, atol=0.003)
