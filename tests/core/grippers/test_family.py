"""The procedural family: any seed gives a gripper that loads; the real jaws lie in the ranges."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from megrasp_core.cli import main
from megrasp_core.errors import InvalidRequestError
from megrasp_core.gripper_tools.compare import opening, pad_displacement
from megrasp_core.grippers import (
    Gripper,
    is_whole,
    list_grippers,
    load_description,
    load_gripper,
    sample_gripper,
    write_gripper,
)
from megrasp_core.grippers.family import FAMILY_KINDS, RANGES, draw_parameters
from megrasp_core.grippers.posture import settle

SEEDS = st.integers(0, 2**31)
KINDS = st.sampled_from(sorted(FAMILY_KINDS))
FEW = settings(
    max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
MANY = settings(max_examples=100, deadline=None)


def gripper_of(folder: Path, seed: int, kind: str | None = None) -> Gripper:
    """Write and load the gripper of a seed."""
    return load_gripper(write_gripper(folder, *sample_gripper(seed, kind)))


@MANY
@given(seed=SEEDS)
def test_same_seed_same_gripper(seed: int) -> None:
    first, second = sample_gripper(seed), sample_gripper(seed)
    assert first == second
    assert first != sample_gripper(seed + 1)


@FEW
@given(seed=SEEDS, kind=KINDS)
def test_loads_and_closes_towards_the_middle(tmp_path: Path, seed: int, kind: str) -> None:
    """The strict loader takes it, its pads close along X from both sides, the TCP is free."""
    gripper = gripper_of(tmp_path, seed, kind)
    d = gripper.description
    assert d.max_width is not None and d.max_width > d.min_width
    first, second = (pad_displacement(gripper, group) for group in (0, 1))
    assert first[0] > 0.005 and second[0] < -0.005
    assert abs(first[1] + second[1]) < 0.02
    width = opening(gripper)
    # Fingers that come in aslant may leave no surface right beside the TCP.
    assert np.isnan(width) or width > d.max_width - 0.002
    low = [gripper.pad_points("open", group)[:, 0].mean() for group in (0, 1)]
    assert low[0] < 0.0 < low[1]


@FEW
@given(seed=SEEDS, kind=KINDS)
def test_drive_settles_in_both_postures(tmp_path: Path, seed: int, kind: str) -> None:
    gripper = gripper_of(tmp_path, seed, kind)
    for posture in ("open", "closed"):
        wanted = gripper.qpos(posture)
        reached = settle(gripper.model, gripper.control(posture))
        span = np.abs(gripper.qpos("open") - gripper.qpos("closed")).max()
        assert np.abs(reached - wanted).max() < 0.03 * span


@FEW
@given(seed=SEEDS, kind=KINDS)
@pytest.mark.usefixtures("no_cache")
def test_clouds_differ_and_repeat(tmp_path: Path, seed: int, kind: str) -> None:
    folder = write_gripper(tmp_path, *sample_gripper(seed, kind))
    clouds, again = (load_gripper(folder).clouds(256) for _ in range(2))
    assert np.array_equal(clouds.open_points, again.open_points)
    moved = np.linalg.norm(clouds.displacement, axis=1)
    assert 0.02 < (moved > 0.005).mean() < 0.98


@MANY
@given(seed=SEEDS, kind=KINDS)
def test_numbers_lie_in_their_ranges(seed: int, kind: str) -> None:
    p = draw_parameters(seed, kind)
    layouts, motions = FAMILY_KINDS[kind]
    assert p.kind == kind and p.layout in layouts and p.motion in motions
    for name in ("opening", "gap", "finger_length", "pad_length", "crank_length", "force"):
        assert RANGES[name].low <= getattr(p, name) <= RANGES[name].high
    description, _ = sample_gripper(seed, kind)
    assert RANGES["tcp_depth"].low <= description["tcp"][2] <= RANGES["tcp_depth"].high


def test_every_kind_motion_pad_and_palm_occurs() -> None:
    drawn = [draw_parameters(seed) for seed in range(400)]
    kinds = Counter(p.kind for p in drawn)
    assert set(kinds) == set(FAMILY_KINDS)
    # A kind is drawn before its numbers, so none is rare because it is hard to fit together.
    assert min(kinds.values()) > 400 / len(FAMILY_KINDS) / 2
    assert len({(p.layout, p.motion) for p in drawn}) == sum(
        len(layouts) * len(motions) for layouts, motions in FAMILY_KINDS.values()
    )
    assert len({p.pad for p in drawn}) == 5
    assert len({p.palm for p in drawn}) == 3
    heights = np.array([p.palm_height for p in drawn])
    assert 0.2 < (heights < RANGES["thin_palm"].high).mean() < 0.9


def test_real_jaws_lie_inside() -> None:
    """Opening, closed gap and TCP depth of the shipped jaws lie between the drawn extremes."""
    names = [n for n in list_grippers() if not n.endswith("_cad")]
    real = [d for n in names if (d := load_gripper(n).description).max_width is not None]
    assert len(real) >= 8
    drawn = [sample_gripper(seed)[0] for seed in range(600)]
    for field, of in {
        "max_width": lambda d: d["max_width"],
        "min_width": lambda d: d["min_width"],
        "tcp": lambda d: d["tcp"][2],
    }.items():
        values = [of(d) for d in drawn]
        for d in real:
            assert min(values) <= of(d.to_dict()) + 1e-4, (d.name, field)
            assert max(values) >= of(d.to_dict()), (d.name, field)


def test_model_is_primitive_geometry() -> None:
    for seed in range(30):
        tree = ElementTree.fromstring(sample_gripper(seed)[1])
        assert not [mesh for mesh in tree.iter("mesh") if mesh.get("file")]
        names = [geom.get("name") for geom in tree.iter("geom")]
        assert len(set(names)) == len(names) > 6


@pytest.mark.parametrize(("seed", "kind", "said"), [(-1, None, "-1"), (0, "claw", "angular")])
def test_wrong_requests_name_what_is_expected(seed: int, kind: str | None, said: str) -> None:
    with pytest.raises(InvalidRequestError, match=said):
        sample_gripper(seed, kind)


def test_command_keeps_whole_folders_and_mends_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    args = ["gripper", "sample", "-n", "5", "--seed", "1", "--out", str(tmp_path)]
    assert main(args) == 0
    folders = sorted(tmp_path.iterdir())
    assert len(folders) == 5 and "wrote 5" in capsys.readouterr().out
    before = folders[0].stat().st_mtime_ns
    (folders[1] / "model.xml").write_text("<mujoco>")
    (folders[2] / "gripper.yaml").unlink()
    assert main(args) == 0
    said = capsys.readouterr().out
    assert "wrote 2" in said and "kept 3" in said
    assert folders[0].stat().st_mtime_ns == before
    for folder in folders:
        name = load_description(folder).name
        seed = int(name.rpartition("_")[2])
        assert name == folder.name and is_whole(tmp_path, *sample_gripper(seed))
        assert yaml.safe_load((folder / "gripper.yaml").read_text())["name"] == name


@pytest.mark.parametrize("args", [("-n", "0"), ("--report", "x.json"), ("--kind", "claw")])
def test_command_refuses_wrong_requests(tmp_path: Path, args: tuple[str, ...]) -> None:
    assert main(["gripper", "sample", "--out", str(tmp_path), *args]) != 0
