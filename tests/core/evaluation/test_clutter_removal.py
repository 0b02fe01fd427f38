"""Packed and pile: scenes, camera, hand, attempts in both engines, and when a round ends."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from megrasp_core.cli.clutter_page import MARK
from megrasp_core.errors import InvalidRequestError, MissingPackageError, ObjectError
from megrasp_core.evaluation.clutter_removal.bullet_hand import sliding_fingers
from megrasp_core.evaluation.clutter_removal.bullet_shapes import shrunk
from megrasp_core.evaluation.clutter_removal.bullet_world import BulletWorld
from megrasp_core.evaluation.clutter_removal.mujoco_world import MujocoWorld
from megrasp_core.evaluation.clutter_removal.object_files import clutter_pool, fitting
from megrasp_core.evaluation.clutter_removal.protocol import ClutterSettings, play, run_round
from megrasp_core.evaluation.clutter_removal.report import ClutterResult
from megrasp_core.evaluation.clutter_removal.scenes import make_scene, packed_poses, stands
from megrasp_core.evaluation.clutter_removal.side_view import dexnet_noise, look, side_camera
from megrasp_core.evaluation.clutter_removal.table import clutter_tables
from megrasp_core.evaluation.clutter_removal.world import (
    EDGE,
    WORKSPACE,
    Attempt,
    ClutterWorld,
    Outcome,
)
from megrasp_core.evaluation.planners import AntipodalPlanner, Planner
from megrasp_core.grippers import load_gripper
from megrasp_core.objects import ConvexPiece, procedural_object
from megrasp_core.synthesizer import RankedGrasp, Synthesis


@pytest.fixture(scope="module")
def gripper():
    return load_gripper("franka_hand")


@pytest.fixture(scope="module")
def box():
    """29 x 94 x 122 mm, 116 g."""
    return procedural_object(3, "box")


def world_of(engine: str, objects, gripper, **settings) -> ClutterWorld:
    if engine == "mujoco":
        return MujocoWorld(objects, gripper, **settings)
    pytest.importorskip("pybullet", reason="the extra bench is not installed")
    return BulletWorld(objects, gripper, **settings)


def upright(model) -> np.ndarray:
    pose = np.eye(4)
    pose[2, 3] = -model.bounds[0][2]
    return pose


def from_above(box, *, aside: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Pre-grasp with 2 cm of the box between the fingers, and the approach pose."""
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = [aside, 0.0, box.extents[2] + 0.1034 - 0.02]
    back = pose.copy()
    back[2, 3] += 0.1
    return pose, back


# ------------------------------------------------------------------ objects and scenes

URDF = """<robot name="two"><link name="a">
<inertial><mass value="0.2"/></inertial>
<collision><origin xyz="0 0 0.01" rpy="0 0 1.5707963"/><geometry>{shape}</geometry></collision>
</link>{more}</robot>"""


def test_urdf_objects_have_their_size_mass_and_one_hull_for_each_part(tmp_path):
    corner = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    faces = [
        (1, 2, 3), (2, 4, 3), (5, 7, 6), (6, 7, 8), (1, 5, 2), (2, 5, 6),
        (3, 4, 7), (4, 8, 7), (1, 3, 5), (3, 7, 5), (2, 6, 4), (4, 6, 8),
    ]  # fmt: skip
    lines = []
    for number in range(2):
        lines += [f"v {x + 2 * number} {y} {z}" for x, y, z in corner]
        lines += [f"f {a + 8 * number} {b + 8 * number} {c + 8 * number}" for a, b, c in faces]
    (tmp_path / "two.obj").write_text("\n".join(lines))
    shape = '<mesh filename="two.obj" scale="0.02 0.02 0.02"/>'
    (tmp_path / "two.urdf").write_text(URDF.format(shape=shape, more=""))
    (model,) = clutter_pool(tmp_path)
    assert len(model.pieces) == 2 and model.mass == 0.2
    # Turned by a quarter about z.
    np.testing.assert_allclose(model.extents, [0.02, 0.06, 0.02], atol=1e-9)
    np.testing.assert_allclose(model.bounds.mean(axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(model.inertia[1, 1], 0.2 * (0.02**2 + 0.02**2) / 12, rtol=1e-6)


def test_urdf_files_that_are_no_rigid_object_are_named(tmp_path):
    (tmp_path / "a.urdf").write_text(
        URDF.format(shape='<box size="1 1 1"/>', more='<link name="b"/>')
    )
    with pytest.raises(ObjectError, match=r"a\.urdf has 2 links"):
        clutter_pool(tmp_path)
    (tmp_path / "a.urdf").write_text(URDF.format(shape='<mesh filename="no.obj"/>', more=""))
    with pytest.raises(ObjectError, match=r"no\.obj"):
        clutter_pool(tmp_path)


def test_only_objects_that_go_between_the_fingers_are_used(gripper, box):
    crate = procedural_object(1, "crate", obstacle=True)
    assert fitting([box, crate], gripper) == [box]
    with pytest.raises(InvalidRequestError, match="franka_hand"):
        fitting([crate], gripper)


def test_packed_objects_stand_apart_in_the_workspace():
    models = [procedural_object(seed, kind="block") for seed in range(5)]
    poses = packed_poses(models, np.random.default_rng(0))
    assert poses is not None
    clouds = []
    for model, pose in zip(models, poses, strict=True):
        corners = model.vertices @ pose[:3, :3].T + pose[:3, 3]
        assert (np.abs(corners[:, :2]) < EDGE / 2).all() and 0 < corners[:, 2].min() < 0.001
        edges = np.linspace(-0.5, 0.5, 15)
        grid = np.stack(np.meshgrid(edges, edges, edges), -1).reshape(-1, 3) * model.extents
        clouds.append((grid @ pose[:3, :3].T + pose[:3, 3])[:, :2])
    for number, one in enumerate(clouds):
        for other in clouds[:number]:
            assert np.linalg.norm(one[:, None] - other[None], axis=-1).min() > 0.003


def test_what_has_no_foot_does_not_stand(box):
    assert stands(box)
    tip = procedural_object(2, "box")
    half = np.array([[np.cos(0.6), 0, np.sin(0.6)], [0, 1, 0], [-np.sin(0.6), 0, np.cos(0.6)]])
    pieces = tuple(ConvexPiece(points @ half.T, faces) for points, faces in tip.pieces)
    tilted = type(tip)("tilted", tip.vertices @ half.T, tip.faces, pieces, tip.mass, tip.inertia)
    assert not stands(tilted)


def test_shrunk_hulls_have_their_faces_moved_inwards():
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 2) for z in (0, 3)], float)
    found = shrunk(corners, 0.1)
    np.testing.assert_allclose(found.min(axis=0), 0.1, atol=1e-9)
    np.testing.assert_allclose(found.max(axis=0), [0.9, 1.9, 2.9], atol=1e-9)
    # What is thinner than the margin keeps some of its thickness.
    thin = shrunk(corners * [0.1, 1.0, 1.0], 0.1)
    assert 0.0 < np.ptp(thin[:, 0]) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_a_pile_rests_in_the_workspace(engine, gripper):
    pool = [procedural_object(seed) for seed in range(8)]

    def make(objects):
        return world_of(engine, objects, gripper)

    world = make_scene("pile", pool, 3, make, (1, 0))
    before = world.poses()
    assert len(world.present) == 3
    assert WORKSPACE.contains(before[:, :3, 3]).all()
    world.run(0.5)
    assert np.abs(world.poses()[:, :3, 3] - before[:, :3, 3]).max() < 0.003
    world.close()


# ------------------------------------------------------------------ camera


@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_the_cloud_lies_on_the_box_and_on_the_table(engine, gripper, box):
    world = world_of(engine, [box], gripper)
    world.place(0, upright(box))
    rng = np.random.default_rng(1)
    cloud = look(world, side_camera(rng), "none", rng)
    off_table = cloud.points[cloud.points[:, 2] > 0.002]
    local = np.abs(off_table - upright(box)[:3, 3]) - box.extents / 2
    assert len(off_table) > 3000
    # Half a pixel is 0.6 mm here.
    assert np.abs(local.max(axis=1)).max() < 2e-4
    beside = np.abs(cloud.points[:, :2] - upright(box)[:2, 3]) > box.extents[:2] / 2 + 0.001
    table = cloud.points[beside.any(axis=1)]
    table = table[table[:, 2] <= 0.002]
    assert len(table) > 50_000 and np.abs(table[:, 2]).max() < 2e-4
    world.close()


def test_both_engines_see_the_same(gripper, box):
    bullet, own = (world_of(engine, [box], gripper) for engine in ("pybullet", "mujoco"))
    for world in (bullet, own):
        world.place(0, upright(box))
    camera = side_camera(np.random.default_rng(2))
    one, other = bullet.depth_image(camera), own.depth_image(camera)
    both = (one > 0) & (one < 1.0) & (other > 0)
    assert both.mean() > 0.3
    assert np.quantile(np.abs(one - other)[both], 0.999) < 1e-5
    bullet.close()


def test_noise_has_the_size_that_it_says(gripper, box):
    world = world_of("mujoco", [box], gripper)
    world.place(0, upright(box))
    camera = side_camera(np.random.default_rng(1))
    cloud = look(world, camera, "gaussian", np.random.default_rng(0))
    table = np.abs(cloud.points[:, 2]) < 0.004
    assert cloud.points[table, 2].std() == pytest.approx(0.0008, rel=0.05)
    clean = np.full((200, 200), 0.6, np.float32)
    clean[0] = 0.0
    factors = []
    for seed in range(200):
        noisy = dexnet_noise(clean, np.random.default_rng(seed))
        assert not noisy[0].any()
        factors.append(noisy[1:].mean() / 0.6)
    assert noisy[1:].std() == pytest.approx(0.005, rel=0.1)
    assert np.std(factors) == pytest.approx(0.0316, rel=0.2)
    with pytest.raises(InvalidRequestError, match="gaussian, dexnet, none"):
        look(world, camera, "fog", np.random.default_rng(0))  # type: ignore[arg-type]


# ------------------------------------------------------------------ hand


def test_fingers_come_from_the_description(gripper):
    palm, fingers = sliding_fingers(gripper)
    assert palm and len(fingers) == 2
    np.testing.assert_allclose(fingers[0].axis, -fingers[1].axis, atol=1e-9)
    assert [finger.stroke for finger in fingers] == pytest.approx([0.04, 0.04])
    # The motor's 100 N are shared.
    assert [finger.force for finger in fingers] == pytest.approx([50.0, 50.0])
    with pytest.raises(InvalidRequestError, match="--engine mujoco"):
        sliding_fingers(load_gripper("robotiq_2f85"))


def test_the_hand_is_where_it_is_put_and_closes_to_the_end(gripper, box):
    world = world_of("pybullet", [box], gripper)
    assert isinstance(world, BulletWorld)
    hand = world.hand
    pose, _ = from_above(box)
    pose[2, 3] += 0.5
    hand.place(pose)
    palm, first, second = hand.link_places()
    opened = gripper.meshes("open", "collision")
    low = min(mesh.vertices[:, 0].min() for mesh in opened)
    assert abs(palm[0]) < 0.1 and first[2] < palm[2]
    assert abs(np.linalg.norm((first - second)[:2])) > 0.08 and low < -0.04
    hand.hold(1.0)
    world.run(1.0)
    assert hand.ways() == pytest.approx([0.04, 0.04], abs=5e-4)
    closed = hand.link_places()
    np.testing.assert_allclose(closed[0], palm, atol=5e-4)
    moved = [after - before for after, before in zip(closed[1:], (first, second))]
    np.testing.assert_allclose(np.abs(moved[0]), [0.04, 0, 0], atol=1e-3)
    np.testing.assert_allclose(moved[0], -moved[1], atol=1e-3)
    hand.place(pose, 0.5)
    assert hand.ways() == pytest.approx([0.02, 0.02], abs=1e-3)
    world.close()


def test_penetration_is_exact_to_hundredths_of_a_millimetre(gripper, box):
    world = world_of("pybullet", [box], gripper)
    assert isinstance(world, BulletWorld)
    world.place(0, upright(box))
    touching = 0.04 - box.extents[0] / 2
    for deep in (-0.0002, 0.0004, 0.0012):
        pose, _ = from_above(box, aside=touching + deep)
        assert world.depth_at(pose) == pytest.approx(max(0.0, deep), abs=2e-5)
    world.close()


@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_attempts_end_for_the_right_reason(engine, gripper, box):
    world = world_of(engine, [box], gripper)
    world.place(0, upright(box))
    world.run(0.2)
    # A finger in the box.
    met = world.attempt(*from_above(box, aside=0.03))
    assert met.outcome is Outcome.COLLISION and met.depth > 0.001 and not met.held
    pose, back = from_above(box)
    up = np.outer([0, 0, 1, 0], [0, 0, 0, 0.05])
    assert world.attempt(pose + up, back + up).outcome is Outcome.NO_CONTACT
    held = world.attempt(pose, back)
    assert held.success and held.held == (0,)
    world.close()


@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_what_is_slippery_slips(engine, gripper, box):
    world = world_of(engine, [box], gripper, friction=0.003)
    world.place(0, upright(box))
    assert world.attempt(*from_above(box)).outcome is Outcome.SLIPPED
    world.close()


def test_without_pybullet_the_extra_is_named(gripper, box, monkeypatch):
    monkeypatch.setitem(sys.modules, "pybullet", None)
    with pytest.raises(MissingPackageError, match=r"megrasp-core\[bench\].*") as caught:
        BulletWorld([box], gripper)
    assert "--engine mujoco" in str(caught.value)


# ------------------------------------------------------------------ rounds


class Told(ClutterWorld):
    """A world in which attempts end as they are told to."""

    def __init__(self, outcomes: list[Outcome], box) -> None:
        super().__init__([box] * 3)
        self.present, self.outcomes = [0, 1, 2], outcomes

    def place(self, index, world_from_object):
        """Nothing is placed."""

    def take_out(self, index):
        self.present = [i for i in self.present if i != index]

    def poses(self):
        pose = np.eye(4)
        pose[2, 3] = 0.05
        return np.tile(pose, (3, 1, 1))

    def fence(self, stands):
        """There is none."""

    def run(self, duration):
        """Nothing moves."""

    def depth_image(self, camera):
        return np.full((camera.height, camera.width), 0.6, np.float32)

    def attempt(self, world_from_gripper, approach, opening=0.0):
        outcome = self.outcomes.pop(0)
        return Attempt(outcome, tuple(self.present[:1]) if outcome is Outcome.SUCCESS else ())


class Scripted(Planner):
    """Answers so many times with the same pose, then with nothing."""

    name = "scripted"

    def __init__(self, answers: int) -> None:
        self.answers, self.excluded = answers, []

    def plan(self, cloud, **options):
        self.excluded.append(len(options["exclude"]))
        self.answers -= 1
        pose = np.eye(4)
        grasp = RankedGrasp(pose, pose, pose, pose, 0.95, 0.04, 0.01, 0.0, True)
        grasps = [grasp] if self.answers >= 0 else []
        return Synthesis(grasps, {}, {"total": 0.1}, 0, 100, 20, "franka_hand", self.name)


WON, LOST, HIT = Outcome.SUCCESS, Outcome.SLIPPED, Outcome.COLLISION


@pytest.mark.parametrize(
    ("outcomes", "answers", "ending", "tried", "removed"),
    [
        ([WON, WON, WON], 9, "cleared", 3, 3),
        ([LOST, HIT], 9, "failures", 2, 0),
        ([LOST, WON, LOST, LOST], 9, "failures", 4, 1),
        ([LOST, WON, LOST, WON, LOST, WON], 9, "cleared", 6, 3),
        ([WON], 1, "no_grasp", 1, 1),
    ],
)
def test_a_round_ends_when_empty_after_two_failures_or_without_a_grasp(
    outcomes, answers, ending, tried, removed, box
):
    planner = Scripted(answers)
    rng = np.random.default_rng(0)
    found = play(ClutterSettings(), Told([*outcomes], box), planner, rng)
    assert (found.ending, len(found.tried), found.removed) == (ending, tried, removed)
    assert found.objects == 3
    assert planner.excluded[:2] == [0, 0 if outcomes[0] is WON else 1]


def test_rates_and_causes_of_the_result_file(box):
    settings = ClutterSettings(rounds=2)
    rng = np.random.default_rng(0)
    rounds = tuple(
        play(settings, Told(outcomes, box), Scripted(9), rng)
        for outcomes in ([WON, WON, WON], [WON, HIT, LOST])
    )
    result = ClutterResult(settings, "franka_hand", "franka_hand", "m", 60, "procedural", rounds)
    content = json.loads(json.dumps(result.to_json()))
    assert (content["gsr"]["successes"], content["gsr"]["trials"]) == (4, 6)
    assert (content["dr"]["successes"], content["dr"]["trials"]) == (4, 6)
    assert content["failures"] == {
        "collision": 1, "no_contact": 0, "object_moved": 0, "slipped": 1, "unstable": 0
    }  # fmt: skip
    assert content["endings"] == {"cleared": 1, "failures": 1}
    assert [len(one) for one in content["attempts"]] == [3, 3]


def test_the_page_has_the_tables_of_the_result_files():
    root = Path(__file__).parents[3] / "docs"
    files = sorted((root / "results").glob("clutter_*.json"))
    results = [json.loads(file.read_text()) for file in files]
    assert {content["protocol"] for content in results} == {"packed", "pile"}
    page = (root / "evaluation.md").read_text()
    assert f"<!-- {MARK} -->\n{clutter_tables(results)}<!-- /{MARK} -->" in page, (
        "run python -m megrasp_core.cli.clutter_page docs/evaluation.md "
        "docs/results/clutter_*.json"
    )


def test_unknown_settings_are_named():
    with pytest.raises(InvalidRequestError, match="packed, pile"):
        ClutterSettings(scene="heap")  # type: ignore[arg-type]
    with pytest.raises(InvalidRequestError, match="rounds 0"):
        ClutterSettings(rounds=0)


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_the_same_seed_gives_the_same_round(engine, gripper):
    world_of(engine, [], gripper).close()
    pool = [procedural_object(seed, kind="block") for seed in range(6)]
    settings = ClutterSettings(engine=engine, objects=2, drawn=60, noise="gaussian")
    planner = AntipodalPlanner(gripper)
    first, second = (run_round(settings, gripper, planner, pool, 0) for _ in range(2))
    assert [t.attempt for t in first.tried] == [t.attempt for t in second.tried]
    assert first.tried
