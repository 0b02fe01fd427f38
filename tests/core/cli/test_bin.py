"""`megrasp bin find`: what it writes is a region that others read, and 1 where there is no bin."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from bin_clouds import bin_meshes, pose, seen, table
from PIL import Image

from megrasp_core.benchmarks.bins import pose_error
from megrasp_core.cli import main
from megrasp_core.cli.common import read_region
from megrasp_core.pointcloud import Cloud, OrientedBox, write_cloud


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> tuple[Path, OrientedBox]:
    """A file of a cloud without viewpoint, and the inside of the bin in it."""
    meshes, inside = bin_meshes(pose(z=0.004, yaw=20))
    path = tmp_path_factory.mktemp("c") / "cloud.npz"
    write_cloud(path, Cloud(seen([*meshes, table()], pixels=220).points))
    return path, inside


def run(capsys, *args: object) -> tuple[int, str, str]:
    code = main([str(a) for a in args])
    told = capsys.readouterr()
    return code, told.out, told.err


def test_the_region_file_is_read_as_it_is(capsys, scene, tmp_path):
    cloud, inside = scene
    out, picture = tmp_path / "o" / "bin.json", tmp_path / "p" / "bin.png"
    code, said, _ = run(
        capsys, "bin", "find", cloud, "--sensor", 0.03, -0.02, 0.95, "--out", out,
        "--picture", picture,
    )  # fmt: skip
    assert code == 0 and "empty" in said and str(out) in said and str(picture) in said
    box, walls = read_region(out)
    distance, angle, size = pose_error(box, inside)
    assert walls and distance < 0.005 and angle < 1.0 and np.abs(size).max() < 0.006
    found = json.loads(out.read_text())["found"]
    assert found["empty"] and found["fill_level"] < 0.03 and found["depth_from"] == "floor"
    assert len(found["cells"]) == 6 and all(len(row) == 8 for row in found["cells"])
    with Image.open(picture) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    red = (pixels[..., 0] > 180) & (pixels[..., 1] < 80) & (pixels[..., 2] < 90)
    assert red[:, : red.shape[1] // 2].sum() > 500 and red[:, red.shape[1] // 2 :].sum() > 500


def test_the_optical_frame_wants_gravity(capsys, scene, tmp_path):
    cloud, _ = scene
    points = np.load(cloud)["points"]
    optical = tmp_path / "optical.npz"
    down = np.diag([1.0, -1.0, -1.0])
    write_cloud(optical, Cloud((points - [0.03, -0.02, 0.95]) @ down))
    code, _, told = run(capsys, "bin", "find", optical, "--frame", "optical")
    assert code == 2 and "--top-down" in told
    code, said, _ = run(capsys, "bin", "find", optical, "--frame", "optical", "--top-down")
    assert code == 0 and ("bin of 0.40" in said or "bin of 0.39" in said)


def test_no_bin_is_exit_code_1(capsys, scene, tmp_path):
    cloud, _ = scene
    code, said, _ = run(capsys, "bin", "find", cloud, "--size", 0.6, 0.5, 0)
    assert code == 1 and "no bin with inner edges of 0.6 x 0.5 m" in said
    bare = tmp_path / "table.npz"
    write_cloud(bare, seen([table()], pixels=120))
    out = tmp_path / "bin.json"
    code, said, _ = run(capsys, "bin", "find", bare, "--out", out)
    assert code == 1 and "no bin was found" in said and not out.exists()
