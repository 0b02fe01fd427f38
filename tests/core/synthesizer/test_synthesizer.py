"""The synthesizer with a small network of random weights: what does not depend on training."""

from __future__ import annotations

import copy
import dataclasses
import json
from collections import Counter

import numpy as np
import pytest
import torch

from megrasp_core.errors import (
    CancelledError,
    CloudError,
    EmptyRegionError,
    GravityError,
    InvalidRequestError,
    ModelError,
    SensorPlaceError,
    UnknownGripperError,
)
from megrasp_core.grippers import load_gripper
from megrasp_core.network import PRESETS, GraspModel, default_model, save_model
from megrasp_core.pointcloud import Cloud, OrientedBox
from megrasp_core.synthesizer import (
    GraspSynthesizer,
    SynthesisRequest,
    SynthesizerSettings,
)

REGION = OrientedBox.around((0.0, 0.0, 0.075), (0.40, 0.30, 0.15))
CAMERA = np.array([0.0, 0.0, 0.85])
PHASES = ["perceive", "encode", "sample", "rank"]


def table_cloud(seed: int = 0) -> Cloud:
    """Floor and three box tops and sides, 12000 points."""
    rng = np.random.default_rng(seed)
    parts = [rng.uniform((-0.2, -0.15, 0.0), (0.2, 0.15, 0.0005), (6000, 3))]
    for x, y, height in ((-0.1, 0.0, 0.05), (0.05, 0.05, 0.03), (0.1, -0.08, 0.08)):
        low, high = np.array([x - 0.02, y - 0.03]), np.array([x + 0.02, y + 0.03])
        top = rng.uniform((*low, height - 0.0005), (*high, height), (1500, 3))
        side = rng.uniform((*low, 0.0), (low[0] + 0.001, high[1], height), (500, 3))
        parts += [top, side]
    return Cloud(np.concatenate(parts), None, CAMERA)


@pytest.fixture(scope="module")
def model() -> GraspModel:
    torch.manual_seed(0)
    return GraspModel(PRESETS["tiny"], model_id="random").eval().requires_grad_(False)


@pytest.fixture(scope="module")
def synthesizer(model) -> GraspSynthesizer:
    return GraspSynthesizer(model, "robotiq_2f85")


def run(synthesizer, **options):
    options = {"region": REGION, "seed": 3, "num_grasps": 5, "drawn": 12, **options}
    return synthesizer.synthesize(table_cloud(), **options)


def test_counts_add_up_to_drawn(synthesizer):
    for options in ({}, {"keep_all": True}, {"mode": "fast"}, {"drawn": 60}):
        result = run(synthesizer, **options)
        passing = sum(grasp.reason == "" for grasp in result.grasps)
        assert passing + sum(result.rejected.values()) == result.drawn
        assert len(result.grasps) <= 5
        assert {"collision", "unseen", "workspace", "tilt", "duplicate"} <= set(result.rejected)


def test_everything_is_returned_with_keep_all_best_first_failing_last(synthesizer):
    result = run(synthesizer, keep_all=True, num_grasps=12)
    assert len(result.grasps) == 12
    free = [grasp.collision_free for grasp in result.grasps]
    assert free == sorted(free, reverse=True)
    scores = [grasp.score for grasp in result.grasps if grasp.reason == ""]
    assert scores == sorted(scores, reverse=True)
    assert all(grasp.reason for grasp in result.grasps if not grasp.collision_free)


def test_poses_that_were_not_refined_have_not_passed(model):
    settings = SynthesizerSettings(refined=2, turns=False)
    result = run(
        GraspSynthesizer(model, "robotiq_2f85", settings=settings),
        keep_all=True, num_grasps=300, drawn=300,
    )  # fmt: skip
    assert len(result.grasps) == 300
    whole = [grasp for grasp in result.grasps if grasp.collision_free]
    assert len(whole) <= 2, "only what was refined went through the whole check"
    unrefined = [grasp for grasp in result.grasps if grasp.reason == "unrefined"]
    assert len(unrefined) == result.rejected["unrefined"] > 0
    free = [grasp.collision_free for grasp in result.grasps]
    assert free == sorted(free, reverse=True)


def test_more_is_drawn_while_no_grasp_is_good(model):
    """The first poses are the same, more follow, and the counts are of all."""
    unsure = copy.copy(model)
    unsure.info = dataclasses.replace(model.info, heads=("confidence",))
    steps: list[tuple[str, int, int]] = []
    traces = []
    results = [
        run(
            GraspSynthesizer(
                unsure,
                "robotiq_2f85",
                settings=SynthesizerSettings(sure=sure, refined=8),
            ),
            keep_all=True,
            num_grasps=36,
            drawn=12,
            more_rounds=rounds,
            on_step=lambda *step: steps.append(step),
            on_trace=traces.append,
        )
        for sure, rounds in ((1.0, 0), (1.0, 2), (0.0, 2))
    ]
    once, more, sure = results
    assert (once.drawn, more.drawn, sure.drawn) == (36, 108, 36)
    for result, trace in zip(results, traces, strict=True):
        passing = sum(grasp.reason == "" for grasp in result.grasps)
        assert passing + sum(result.rejected.values()) == result.drawn
        assert len(trace.starts) == len(trace.drawn) == len(trace.assessment) == result.drawn
    np.testing.assert_array_equal(traces[1].drawn[:36], traces[0].drawn)
    assert len(np.unique(traces[1].drawn[:, :3, 3].round(6), axis=0)) == 108
    assert [grasp.score for grasp in once.grasps] == [grasp.score for grasp in sure.grasps]
    evaluations = once.evaluations
    assert max(index for phase, index, _ in steps if phase == "sample") == 3 * evaluations
    assert all(index <= total for _, index, total in steps)
    fast = run(GraspSynthesizer(unsure, "robotiq_2f85"), mode="fast")
    assert fast.drawn == 5, "fast is fast whatever comes out"


def test_poses_of_a_grasp_fit_each_other(synthesizer):
    gripper = synthesizer.gripper
    for grasp in run(synthesizer, keep_all=True, approach_distance=0.07).grasps:
        rotation = grasp.world_from_tcp[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        np.testing.assert_allclose(
            grasp.world_from_gripper @ gripper.gripper_from_tcp, grasp.world_from_tcp, atol=1e-12
        )
        way = grasp.world_from_gripper[:3, 3] - grasp.world_from_gripper_approach[:3, 3]
        np.testing.assert_allclose(way, 0.07 * rotation[:, 2], atol=1e-12)
        assert grasp.tilt == pytest.approx(np.arccos(-rotation[2, 2]), abs=1e-6)


def test_approach_along_gravity_comes_from_above(synthesizer):
    for grasp in run(synthesizer, keep_all=True, approach_direction="gravity").grasps:
        way = grasp.world_from_gripper_approach[:3, 3] - grasp.world_from_gripper[:3, 3]
        np.testing.assert_allclose(way, [0, 0, 0.10], atol=1e-12)


def test_the_same_seed_gives_the_same_grasps_and_another_one_others(synthesizer):
    first, again, other = (run(synthesizer, keep_all=True, seed=seed).grasps for seed in (5, 5, 6))
    for a, b in zip(first, again):
        np.testing.assert_array_equal(a.world_from_tcp, b.world_from_tcp)
    assert not np.allclose(first[0].world_from_tcp, other[0].world_from_tcp)


def test_a_random_seed_is_returned_and_repeats_the_result(synthesizer):
    first = run(synthesizer, keep_all=True, seed=None)
    again = run(synthesizer, keep_all=True, seed=first.seed)
    np.testing.assert_array_equal(first.grasps[0].world_from_tcp, again.grasps[0].world_from_tcp)


def test_a_far_frame_moves_the_grasps_along(synthesizer):
    shift = np.array([40.0, -28.0, 4.0])  # whole voxels of 4 mm: the grid belongs to the frame
    cloud = table_cloud()
    pose = REGION.world_from_box.copy()
    pose[:3, 3] += shift
    moved = synthesizer.synthesize(
        Cloud(cloud.points + shift, None, CAMERA + shift),
        region=OrientedBox(pose, REGION.size),
        seed=3,
        num_grasps=5,
        drawn=5,
        keep_all=True,
    )
    here = run(synthesizer, drawn=5, keep_all=True)
    for a, b in zip(here.grasps, moved.grasps):
        np.testing.assert_allclose(
            a.world_from_tcp[:3, 3] + shift, b.world_from_tcp[:3, 3], atol=2e-4
        )


@pytest.mark.parametrize("how", ["synthesize", "assess"])
def test_errors_of_a_far_scene_are_told_in_its_frame(synthesizer, how):
    far = np.array([1000.0, 2000.0, 0.0])
    cloud = table_cloud().moved(far)
    asked = (cloud,) if how == "synthesize" else (cloud, np.eye(4)[None])
    call = getattr(synthesizer, how)
    beside = OrientedBox.around((1003.0, 2000.0, 0.0), (0.3, 0.3, 0.3))
    with pytest.raises(EmptyRegionError, match=r"centre \[1003.0, 2000.0, 0.0\]"):
        call(*asked, region=beside)
    among = Cloud(cloud.points[cloud.points[:, 2] < 0.01])
    inside = np.array([1000.0, 2000.0, 0.0005])
    with pytest.raises(SensorPlaceError, match=r"\[1000.0, 2000.0, 0.0"):
        call(among, *asked[1:], sensor=inside, gravity=None)


def test_hints_of_a_far_scene_are_told_in_its_frame(synthesizer):
    far = np.array([1000.0, 2000.0, 0.0])
    moved, sensor = table_cloud().moved(far), np.add(far, (0.9, 0.0, 0.1))
    found = synthesizer.synthesize(moved, sensor=sensor, seed=3, num_grasps=5, drawn=30)
    assert "from the sensor at 1000.90 2000.00 0.10" in found.hints[0]


def test_scene_is_encoded_once_a_cloud_and_gripper_once_a_gripper(model, monkeypatch):
    calls = {"encode_scene": 0, "encode_gripper": 0, "predict": 0}

    def counted(name):
        real = getattr(GraspModel, name)

        def call(self, *args, **options):
            calls[name] += 1
            return real(self, *args, **options)

        return call

    for name in calls:
        monkeypatch.setattr(GraspModel, name, counted(name))
    fresh = GraspSynthesizer(model, "robotiq_2f85")
    result = run(fresh)
    assert calls == {"encode_scene": 1, "encode_gripper": 1, "predict": result.evaluations}
    run(fresh)
    fresh.set_gripper("franka_hand")
    fresh.set_gripper("robotiq_2f85")
    assert calls["encode_scene"] == 2 and calls["encode_gripper"] == 2


def test_a_trace_tells_what_became_of_every_pose_and_changes_nothing(synthesizer):
    for options in ({"drawn": 60}, {"mode": "fast"}):
        traces = []
        traced = run(synthesizer, on_trace=traces.append, **options)
        plain = run(synthesizer, **options)
        np.testing.assert_array_equal(
            [grasp.world_from_tcp for grasp in traced.grasps],
            [grasp.world_from_tcp for grasp in plain.grasps],
        )
        (trace,) = traces
        reason = trace.assessment.check.reason
        assert len(reason) == len(trace.starts) == len(trace.drawn) == traced.drawn
        counts = {name: n for name, n in traced.rejected.items() if n}
        assert Counter(reason[reason != ""].tolist()) == counts
        returned = trace.assessment.poses.tcp[reason == ""]
        assert len(returned) == len(traced.grasps)
        for grasp in traced.grasps:
            assert (np.abs(returned - grasp.world_from_tcp).max(axis=(1, 2)) < 1e-12).any()


def test_only_the_best_go_through_the_restarts(model, monkeypatch):
    sizes = []
    real = GraspModel.predict

    def predict(self, scene, code, poses, s):
        sizes.append(len(s))
        return real(self, scene, code, poses, s)

    monkeypatch.setattr(GraspModel, "predict", predict)
    synthesizer = GraspSynthesizer(model, "robotiq_2f85", settings=SynthesizerSettings(refined=4))
    result = run(synthesizer, drawn=12)
    assert sizes == [12] * 10 + [4] * 10 and result.evaluations == 20 and result.drawn == 12
    sizes.clear()
    result = run(synthesizer, mode="fast", num_grasps=6)
    assert sizes == [6] * 20 and result.drawn == 6


def test_phases_are_reported_in_order_and_timed(synthesizer):
    told = []
    result = run(synthesizer, on_step=lambda *step: told.append(step))
    assert list(dict.fromkeys(phase for phase, _, _ in told)) == PHASES
    steps = [step for phase, step, total in told if phase == "sample" and total == 20]
    assert steps == list(range(1, 21))
    assert {*PHASES, "total"} == set(result.timing)
    assert sum(result.timing[phase] for phase in PHASES) <= result.timing["total"] + 1e-3


@pytest.mark.parametrize("after", [1, 4, 15])
def test_cancel_stops_before_the_next_step(synthesizer, after):
    told = []
    with pytest.raises(CancelledError):
        run(
            synthesizer,
            on_step=lambda *step: told.append(step),
            cancelled=lambda: len(told) >= after,
        )
    assert len(told) == after


def test_excluded_poses_are_not_offered_again(synthesizer):
    everything = run(synthesizer, keep_all=True, num_grasps=12)
    poses = [grasp.world_from_tcp for grasp in everything.grasps]
    result = run(synthesizer, num_grasps=12, exclude=poses, exclude_radius=0.05)
    assert not result.grasps
    assert sum(result.rejected.values()) == 12


def test_unknown_gravity_is_possible(synthesizer):
    result = run(synthesizer, gravity=None, keep_all=True)
    assert len(result.grasps) == 5 and all(np.isnan(g.tilt) for g in result.grasps)
    assert result.to_json()["grasps"][0]["tilt"] is None


def test_an_empty_bin_is_told_and_nothing_is_drawn(synthesizer):
    floor = np.random.default_rng(0).uniform((-0.2, -0.15, 0.0), (0.2, 0.15, 0.0005), (6000, 3))
    told = []
    answer = synthesizer.synthesize(
        Cloud(floor, None, CAMERA), region=REGION, on_step=lambda *step: told.append(step[0])
    )
    assert answer.bin_empty and not answer.grasps and answer.drawn == 0
    assert sum(answer.rejected.values()) == 0
    assert answer.to_json()["bin_empty"] is True
    assert told == ["perceive"]
    assert not run(synthesizer).bin_empty and "bin_empty" not in run(synthesizer).to_json()


def test_a_request_or_options_but_not_both(synthesizer):
    request = SynthesisRequest(num_grasps=3, seed=1, region=REGION, keep_all=True)
    answer = synthesizer.synthesize(table_cloud(), request)
    assert len(answer.grasps) == 3 and answer.seed == 1
    with pytest.raises(InvalidRequestError, match=r"options \['seed'\] were given"):
        synthesizer.synthesize(table_cloud(), request, seed=2)
    with pytest.raises(InvalidRequestError, match=r"options \['grasps'\].*some of num_grasps"):
        synthesizer.synthesize(table_cloud(), grasps=3)


def test_json_is_as_fixed(synthesizer, tmp_path):
    file = tmp_path / "a" / "grasps.json"
    run(synthesizer, keep_all=True).write_json(file, "optical")
    content = json.loads(file.read_text())
    assert content["frame"] == "optical" and content["gripper"] == "robotiq_2f85"
    assert content["model"] == "random" and content["seed"] == 3
    assert content["drawn"] == 12 and content["evaluations"] == 20
    assert {"collision", "unseen", "workspace", "tilt", "duplicate"} <= set(content["rejected"])
    assert {*PHASES, "total"} == set(content["timing"])
    for grasp in content["grasps"]:
        for key in ("world_from_tcp", "world_from_gripper", "world_from_gripper_approach"):
            assert len(grasp[key]) == 7
            assert np.linalg.norm(grasp[key][3:]) == pytest.approx(1.0, abs=1e-6)
        assert isinstance(grasp["collision_free"], bool)
        assert {"score", "width", "clearance", "tilt"} <= set(grasp)


@pytest.mark.parametrize("threads", [7, None])
def test_threads_are_for_the_decoder_and_restored(threads, model, monkeypatch):
    synthesizer = GraspSynthesizer(model, "robotiq_2f85", threads=threads)
    before = torch.get_num_threads()
    calls = []
    # Not really set: threads that wait for each other on a busy machine take half a minute.
    monkeypatch.setattr(torch, "set_num_threads", calls.append)
    run(synthesizer, on_step=lambda phase, *_: calls.append(phase))
    assert calls[:3] == [1, "perceive", "encode"] and calls[-2:] == ["rank", before]
    decoding = calls[3:-2]
    assert decoding[0] == (threads or before) and decoding[-1] == before
    assert set(decoding) == {threads or before, before, "sample"}


def test_each_kind_of_gripper_has_its_default_model():
    synthesizer = GraspSynthesizer.load(gripper="robotiq_2f85")
    hand = synthesizer.model_for(load_gripper("shadow_hand_3f"))
    assert hand is not synthesizer.model
    assert run(synthesizer).model == synthesizer.model.model_id == default_model("adaptive")
    synthesizer.set_gripper("shadow_hand_3f")
    assert run(synthesizer).model == hand.model_id == default_model("hand")
    one = GraspSynthesizer.load("megrasp-bin", "shadow_hand_3f")
    assert one.model.model_id == "megrasp-bin"


def test_no_threads_are_refused(model):
    with pytest.raises(InvalidRequestError, match="threads 0"):
        GraspSynthesizer(model, threads=0)


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"num_grasps": 0}, InvalidRequestError, "num_grasps 0 .* from 1 to 1000"),
        ({"num_grasps": -1}, InvalidRequestError, "num_grasps -1 .* from 1 to 1000"),
        ({"num_grasps": 10**6}, InvalidRequestError, "num_grasps 1000000 .* from 1 to 1000"),
        ({"num_grasps": 2.5}, InvalidRequestError, "num_grasps 2.5 .* whole number"),
        ({"drawn": 10**6}, InvalidRequestError, "drawn 1000000"),
        ({"seed": -4}, InvalidRequestError, "seed -4"),
        ({"max_tilt": 4.0}, InvalidRequestError, "max_tilt 4.0"),
        ({"approach_distance": -0.1}, InvalidRequestError, "approach_distance -0.1"),
        ({"approach_direction": "up"}, InvalidRequestError, "expected 'tool' or 'gravity'"),
        ({"mode": "best"}, InvalidRequestError, "expected 'default' or 'fast'"),
        ({"exclude": np.eye(3)}, InvalidRequestError, r"expected \(E, 4, 4\)"),
        ({"exclude_radius": float("nan")}, InvalidRequestError, "exclude_radius"),
        ({"gravity": (0, 0, 0)}, GravityError, "expected three numbers that point down"),
        ({"gravity": None, "approach_direction": "gravity"}, GravityError, "Give gravity"),
        ({"gravity": None, "max_tilt": 0.3}, GravityError, "Give gravity"),
        ({"sensor": (0.0, 0.0)}, CloudError, "expected three finite numbers"),
        ({"region": OrientedBox.around((5, 5, 5), (0.1,) * 3)}, EmptyRegionError, "lies in the"),
    ],
)
def test_wrong_arguments_are_told(synthesizer, options, error, words):
    with pytest.raises(error, match=words):
        run(synthesizer, **options)


def test_all_nan_and_a_missing_sensor_are_told(synthesizer):
    with pytest.raises(CloudError, match="finite"):
        synthesizer.synthesize(Cloud(np.full((100, 3), np.nan), None, CAMERA))
    with pytest.raises(CloudError, match="sensor"):
        synthesizer.synthesize(Cloud(table_cloud().points))


def test_no_gripper_and_unknown_names_are_told(model, tmp_path):
    with pytest.raises(InvalidRequestError, match="no gripper is set"):
        run(GraspSynthesizer(model))
    with pytest.raises(UnknownGripperError, match="robotiq_2f85"):
        GraspSynthesizer(model, "claw")
    with pytest.raises(ModelError, match="not found"):
        GraspSynthesizer.load(tmp_path / "none", "robotiq_2f85")


def test_the_grippers_used_last_are_kept(model, monkeypatch):
    from megrasp_core.synthesizer import synthesizer as module

    monkeypatch.setattr(module, "KEPT_GRIPPERS", 2)
    kept = GraspSynthesizer(model)
    codes = model.encode_gripper
    encoded = []
    monkeypatch.setattr(
        model, "encode_gripper", lambda tokens: encoded.append(0) or codes(tokens), raising=False
    )
    for name, so_far in (
        ("robotiq_2f85", 1), ("franka_hand", 2), ("robotiq_2f85", 2), ("schunk_wsg32", 3),
        ("robotiq_2f85", 3), ("franka_hand", 4),
    ):  # fmt: skip
        assert kept.set_gripper(name).name == kept.gripper.name == name
        assert len(encoded) == so_far


def test_an_unknown_gripper_leaves_the_one_in_use(synthesizer):
    with pytest.raises(UnknownGripperError):
        synthesizer.set_gripper("claw")
    assert synthesizer.gripper.name == "robotiq_2f85"


def test_a_saved_model_gives_the_same_grasps(model, synthesizer, tmp_path):
    folder = save_model(model, tmp_path / "random")
    loaded = GraspSynthesizer.load(folder, "robotiq_2f85")
    a, b = run(synthesizer, keep_all=True), run(loaded, keep_all=True)
    np.testing.assert_allclose(a.grasps[0].world_from_tcp, b.grasps[0].world_from_tcp, atol=1e-9)


@pytest.mark.parametrize("far", [0.0, 5000.0])
def test_unfinished_poses_are_told_in_the_frame_of_the_cloud(synthesizer, far):
    heard, offset = [], np.array([far, 0.0, 0.0])
    pose = np.eye(4)
    pose[:3, 3] = offset
    result = synthesizer.synthesize(
        table_cloud().moved(offset),
        region=REGION.transformed(pose),
        mode="fast",
        num_grasps=5,
        seed=3,
        keep_all=True,
        on_poses=heard.append,
    )
    assert len(heard) == result.evaluations
    assert all(len(poses) == 5 for poses in heard)
    # The last ones are those that were checked and ranked, here in their order of drawing.
    drawn = {tuple(np.round(tcp[:3, 3] - offset, 3)) for tcp in heard[-1].tcp}
    ranked = {tuple(np.round(grasp.world_from_tcp[:3, 3] - offset, 3)) for grasp in result.grasps}
    assert len(drawn & ranked) >= 1
    fits = heard[-1].gripper @ synthesizer.gripper.gripper_from_tcp
    np.testing.assert_allclose(fits, heard[-1].tcp, atol=1e-9 * max(1.0, far))


def test_the_same_comes_out_with_few_poses_at_a_time(synthesizer, monkeypatch):
    whole = run(synthesizer, keep_all=True)
    sizes = []
    predict = synthesizer.model.predict

    def counted(field, code, poses, s):
        sizes.append(len(poses))
        return predict(field, code, poses, s)

    monkeypatch.setattr(synthesizer.model, "predict", counted)
    parts = run(synthesizer, keep_all=True, at_once=5)
    assert set(sizes) == {5, 2}
    assert parts.rejected == whole.rejected
    for one, other in zip(parts.grasps, whole.grasps, strict=True):
        np.testing.assert_allclose(one.world_from_tcp, other.world_from_tcp, atol=1e-4)
