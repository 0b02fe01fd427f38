"""Where cameras stand, in which light, and that scenes look as they did when labelled."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from jaw_and_boxes import at, make_box
from PIL import Image
from scipy.spatial import KDTree

from megrasp_core.cli import main
from megrasp_core.errors import DataError, InvalidRequestError
from megrasp_core.objects import ObjectSet
from megrasp_core.pointcloud import read_cloud, write_cloud
from megrasp_core.scenes import Layout, SceneConfig, ViewShares, region_of, scene_cameras
from megrasp_core.scenes.observing import scene_surface
from megrasp_core.simulation import (
    Bin,
    DepthNoise,
    Light,
    TopDownCamera,
    World,
    build_world,
    observe,
    rig,
)

CONFIG = SceneConfig(grippers=())
NAMES = ("procedural/000003", "procedural/000009", "obstacle/000002")
POSES = np.array(
    [
        [0.06, 0.04, 0.04, 0, 0, 0, 1],
        [-0.09, -0.05, 0.05, 0, 0, 0.6, 0.8],
        [-0.05, 0.08, 0.04, 0.6, 0, 0, 0.8],
    ],
    np.float32,
)


def layout(bin: Bin | None) -> Layout:
    return Layout(NAMES, np.array([0, 0, 1], bool), POSES, bin, region_of(bin, CONFIG))


@pytest.fixture(scope="module")
def world() -> World:
    boxes = [make_box((0.06, 0.06, 0.06)), make_box((0.05, 0.05, 0.05))]
    world = build_world(boxes, bin=Bin())
    world.set_object_poses(np.stack([at(0.08, 0, 0.03), at(-0.08, 0, 0.025)]))
    return world


@pytest.mark.parametrize(
    ("jump", "seed", "bin", "count", "sensor", "points"),
    [
        (
            0.03,
            11,
            Bin(),
            30252,
            (-0.02659, 0.00001, 0.86272),
            (
                (-0.19895, 0.14674, -0.00244),
                (-0.09618, 0.0882, 0.09304),
                (0.00357, -0.04742, -0.00264),
                (0.1046, 0.08579, -0.00214),
                (0.20057, -0.11641, 0.15091),
            ),
        ),
        (
            0.008,
            4,
            None,
            22261,
            (0.02102, 0.02534, 0.85123),
            (
                (-0.15885, 0.00139, 0.00245),
                (-0.06402, 0.05981, 0.10096),
                (0.02398, 0.04259, 0.10666),
                (0.12532, 0.06969, 0.00204),
                (0.21998, -0.0834, 0.00207),
            ),
        ),
        (
            0.03,
            3,
            None,
            37412,
            (0.00348, -0.0026, 0.59094),
            (
                (-0.20252, 0.17981, 0.00272),
                (-0.10368, 0.07146, 0.09903),
                (-0.00785, -0.0519, 0.00004),
                (0.07628, 0.21185, 0.00034),
                (0.20403, -0.01865, 0.00249),
            ),
        ),
    ],
)
def test_a_recipe_gives_the_cloud_that_it_was_labelled_with(
    jump: float,
    seed: int,
    bin: Bin | None,
    count: int,
    sensor: tuple[float, ...],
    points: tuple[tuple[float, ...], ...],
) -> None:
    """A bin, a table from above and a table from around, recorded; a recipe keeps poses and seed
    alone, so that another camera, noise or random stream would spoil those that exist.
    """
    # The last bit of a depth is another on another processor, and edges draw a random number for
    # each of their pixels: one pixel more shifts all numbers that follow. Where some steps of a
    # picture end within that bit of the default of 8 mm, edges begin at 30 mm, of which none ends
    # within 3 um.
    config = replace(CONFIG, noise=DepthNoise(jump=jump))
    surface = scene_surface(layout(bin), seed, config, ObjectSet(NAMES))
    assert surface.sensor == pytest.approx(sensor, abs=1e-4)
    # A measurement on the border of two voxels may change sides: with all last bits changed, one
    # point came or went and two in a thousand moved, by up to 3 mm; these five did not.
    assert len(surface.points) == pytest.approx(count, rel=2e-3)
    assert KDTree(surface.points).query(points)[0].max() < 1e-4


def test_named_views() -> None:
    assert len(rig("dense")) == 10
    (top,) = rig("top_down")
    assert top.world_from_camera == pytest.approx(TopDownCamera().world_from_camera)
    (one,), (same,), (other,) = (rig("sparse", np.random.default_rng(s)) for s in (1, 1, 2))
    assert np.array_equal(one.world_from_camera, same.world_from_camera)
    assert np.linalg.norm(one.position - other.position) > 0.05
    for seed in range(50):
        (camera,) = rig("sparse", np.random.default_rng(seed))
        away = camera.position - [0, 0, 0.03]
        assert 0.65 <= np.linalg.norm(away) <= 0.85
        assert 0.6 <= np.arcsin(away[2] / np.linalg.norm(away)) <= 1.1
        assert camera.world_from_camera[:3, 2] == pytest.approx(-away / np.linalg.norm(away))
    with pytest.raises(InvalidRequestError, match="rng"):
        rig("sparse")
    with pytest.raises(InvalidRequestError, match="fisheye"):
        rig("fisheye")  # type: ignore[arg-type]


def test_scenes_are_looked_at_in_the_shares_of_the_config() -> None:
    shares = ViewShares(dense=0.3, sparse=0.5)
    rng = np.random.default_rng(0)
    seen = Counter(shares.drawn(rng) for _ in range(4000))
    assert seen["dense"] / 4000 == pytest.approx(0.3, abs=0.03)
    assert seen["sparse"] / 4000 == pytest.approx(0.5, abs=0.03)
    with pytest.raises(DataError, match=r"0\.7"):
        ViewShares(0.7, 0.5)
    sparse = replace(CONFIG, views=ViewShares(0.0, 1.0))
    (camera,) = scene_cameras(5, sparse, in_bin=False)
    assert np.hypot(*camera.position[:2]) > 0.25
    (over,) = scene_cameras(5, sparse, in_bin=True)  # a wall would hide what is in the bin
    assert np.hypot(*over.position[:2]) < 0.05
    assert len(scene_cameras(5, replace(CONFIG, views=ViewShares(1.0)), in_bin=False)) == 10


def test_a_config_without_noise_gives_a_clean_cloud() -> None:
    def floor(config: SceneConfig) -> float:
        surface = scene_surface(layout(None), 4, config, ObjectSet(NAMES))
        return float(np.std(surface.points[surface.points[:, 2] < 0.005][:, 2]))

    assert floor(replace(CONFIG, noise=None)) < 0.2 * floor(CONFIG)


def test_light_shades_what_it_falls_on(world: World) -> None:
    light = Light((0.6, 0.0, 0.8), ambient=0.4, brightness=0.9, tint=(1.0, 0.9, 0.8))
    plain = observe(world, TopDownCamera())
    lit = observe(world, TopDownCamera(), light=light)
    assert np.array_equal(plain.points, lit.points)
    assert plain.colors is not None and lit.colors is not None
    level = np.asarray(light.tint) * 0.9
    floor = plain.points[:, 2] < 0.001
    assert lit.colors[floor] == pytest.approx(
        plain.colors[floor] * level * (0.4 + 0.6 * 0.8), abs=1e-6
    )
    inside = (plain.points[:, 2] > 0.01) & (plain.points[:, 2] < 0.14)
    inside &= np.abs(plain.points[:, 1]) < 0.14
    lamp_side = inside & (plain.points[:, 0] > 0.199)  # this wall looks away from the lamp
    other_side = inside & (plain.points[:, 0] < -0.199)
    assert lit.colors[lamp_side] == pytest.approx(plain.colors[lamp_side] * level * 0.4, abs=1e-6)
    assert lit.colors[other_side] == pytest.approx(
        plain.colors[other_side] * level * (0.4 + 0.6 * 0.6), abs=1e-6
    )


def test_colours_are_those_of_the_objects_unless_light_is_asked_for(world: World) -> None:
    colors = observe(world, TopDownCamera()).colors
    assert colors is not None and len(np.unique(colors, axis=0)) <= 3


@pytest.mark.slow
def test_drawn_light_and_paint_differ_by_seed_and_are_kept_in_files(
    world: World, tmp_path: Path
) -> None:
    def seen(seed: int, paint: bool = True) -> np.ndarray:
        light = Light.drawn(np.random.default_rng(seed), paint=paint)
        assert np.linalg.norm(light.direction) == pytest.approx(1.0) and light.direction[2] > 0.3
        cloud = observe(world, TopDownCamera(), light=light)
        assert cloud.colors is not None
        assert cloud.colors.min() >= 0 and cloud.colors.max() <= 1
        return cloud.colors

    assert np.array_equal(seen(1), seen(1))
    assert np.abs(seen(1) - seen(2)).max() > 0.05
    assert np.abs(seen(1) - seen(1, paint=False)).max() > 0.05
    light = Light.drawn(np.random.default_rng(1))
    cloud = observe(world, TopDownCamera(), DepthNoise(), np.random.default_rng(0), light)
    assert cloud.colors is not None
    for name, error in (("c.npz", 0.0), ("c.ply", 1 / 255)):
        write_cloud(tmp_path / name, cloud)
        assert read_cloud(tmp_path / name).colors == pytest.approx(cloud.colors, abs=error)


def test_look_draws_a_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "p" / "look.png"
    args = ["data", "look", "--objects", "2", "--views", "sparse", "--out", str(out)]
    assert main([*args, "--noise", "stereo", "--off", "axial", "range"]) == 0
    with Image.open(out) as image:
        assert image.width > 1000 and len(np.unique(np.asarray(image.convert("L")))) > 50
    assert str(out) in capsys.readouterr().out
    assert main([*args, "--off", "glare"]) == 2
    assert "glare" in capsys.readouterr().err
    assert main(["data", "look", "--objects", "0"]) == 2
