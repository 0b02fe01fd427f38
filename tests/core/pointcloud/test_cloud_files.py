"""Cloud files: round trips and the messages for bad input."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from megrasp_core.errors import CloudError
from megrasp_core.pointcloud import Cloud, read_cloud, write_cloud

RNG = np.random.default_rng(0)
POINTS = RNG.uniform(-0.5, 0.5, (257, 3))
COLORS = RNG.integers(0, 256, (257, 3)) / 255.0


@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".npz", ".npy", ".PLY"])
@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize("colors", [COLORS, None])
def test_round_trip(tmp_path: Path, suffix: str, binary: bool, colors: np.ndarray | None) -> None:
    path = tmp_path / "deep" / f"cloud{suffix}"
    cloud = Cloud(POINTS, colors, np.array([0.0, 0.1, 0.9]))
    write_cloud(path, cloud, binary=binary)
    back = read_cloud(path)
    # PCD holds float32; text PLY prints a limited number of digits.
    np.testing.assert_allclose(back.points, POINTS, atol=1e-6)
    if suffix == ".npz":
        np.testing.assert_array_equal(back.points, POINTS)
    if suffix in (".npz", ".pcd"):
        np.testing.assert_array_equal(back.viewpoint, cloud.viewpoint)
    else:
        assert back.viewpoint is None
    if colors is None or suffix == ".npy":
        assert back.colors is None
    else:
        np.testing.assert_allclose(back.colors, colors, atol=1 / 255)


def test_binary_and_text_files_differ(tmp_path: Path) -> None:
    for suffix in (".ply", ".pcd"):
        write_cloud(tmp_path / f"a{suffix}", Cloud(POINTS), binary=False)
        write_cloud(tmp_path / f"b{suffix}", Cloud(POINTS), binary=True)
        text = (tmp_path / f"a{suffix}").read_bytes()
        assert (
            b"ascii" in text[:400] and b"ascii" not in (tmp_path / f"b{suffix}").read_bytes()[:400]
        )


@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".npz", ".npy"])
def test_nan_rows_are_dropped_with_their_colours(tmp_path: Path, suffix: str) -> None:
    points = POINTS.copy()
    points[::3, 1] = np.nan
    points[1, 2] = np.inf
    keep = np.isfinite(points).all(axis=1)
    write_cloud(tmp_path / f"c{suffix}", Cloud(points, COLORS))
    back = read_cloud(tmp_path / f"c{suffix}")
    np.testing.assert_allclose(back.points, points[keep], atol=1e-6)
    if back.colors is not None:
        np.testing.assert_allclose(back.colors, COLORS[keep], atol=1 / 255)


def test_organised_cloud_and_integer_colours(tmp_path: Path) -> None:
    colors = np.zeros((16, 16, 3), np.uint8)
    colors[3, 4] = [255, 51, 0]
    points = POINTS[:256].reshape(16, 16, 3).astype(np.float32)
    np.savez(tmp_path / "depth.npz", points=points, colors=colors, viewpoint=[0, 0, 1])
    cloud = read_cloud(tmp_path / "depth.npz")
    assert cloud.points.shape == (256, 3) and cloud.points.dtype == np.float64
    assert cloud.colors is not None
    np.testing.assert_allclose(cloud.colors[3 * 16 + 4], [1.0, 0.2, 0.0])
    np.testing.assert_array_equal(cloud.viewpoint, [0, 0, 1])


def bad_file(folder: Path, case: str) -> Path:
    path = folder / ("x.npy" if case in ("shape", "nan", "empty", "text") else "x.npz")
    if case == "missing":
        return folder / "nowhere.ply"
    if case == "suffix":
        return folder / "cloud.xyz"
    if case == "shape":
        np.save(path, np.zeros((5, 4)))
    elif case == "nan":
        np.save(path, np.full((7, 3), np.nan))
    elif case == "empty":
        np.save(path, np.zeros((0, 3)))
    elif case == "text":
        np.save(path, np.array([["a", "b", "c"]]))
    elif case == "names":
        np.savez(path, cloud=POINTS, rgb=COLORS)
    elif case == "colours":
        np.savez(path, points=POINTS, colors=COLORS[:9])
    elif case == "viewpoint":
        np.savez(path, points=POINTS, viewpoint=np.zeros(7))
    elif case == "pickle":
        np.savez(path, points=np.array([{"a": 1}], dtype=object))
    elif case == "damaged":
        path.write_bytes(b"PK\x03\x04 no archive")
    elif case == "damaged_ply":
        path = folder / "x.ply"
        path.write_text("this is no ply file\n")
    elif case == "npy_as_npz":
        np.save(folder / "x.npy", POINTS)
        (folder / "x.npy").rename(path)
    return path


@pytest.mark.parametrize(
    ("case", "parts"),
    [
        ("missing", ["nowhere.ply", "does not exist", ".ply, .pcd, .npz, .npy"]),
        ("suffix", ["cloud.xyz", "'.xyz'", ".ply, .pcd, .npz, .npy"]),
        ("shape", ["(5, 4)", "expected (N, 3)", "take columns 0 to 2"]),
        ("nan", ["all 7 points", "NaN"]),
        ("empty", ["holds no points", "expected at least one"]),
        ("text", ["of type <U1", "expected numbers in metres"]),
        ("names", ["cloud, rgb", "'points'", "(N, 3)"]),
        ("colours", ["colors have the shape (9, 3)", "(257, 3)"]),
        ("viewpoint", ["viewpoint has the shape (7,)", "(3,)"]),
        ("pickle", ["pickled Python object", "leave out what is None"]),
        ("damaged", ["damaged or no numpy file"]),
        ("damaged_ply", ["no PLY file", "expected 'ply' to 'end_header'"]),
        ("npy_as_npz", ["no .npz archive"]),
    ],
)
def test_bad_files_say_what_is_wrong(tmp_path: Path, case: str, parts: list[str]) -> None:
    path = bad_file(tmp_path, case)
    with pytest.raises(CloudError) as caught:
        read_cloud(path)
    message = str(caught.value)
    assert path.name in message
    for part in parts:
        assert part in message
    assert caught.value.code == 102


def test_a_folder_is_no_cloud_and_no_target(tmp_path: Path) -> None:
    (tmp_path / "f.ply").mkdir()
    with pytest.raises(CloudError, match="is a folder"):
        read_cloud(tmp_path / "f.ply")
    (tmp_path / "file").write_text("")
    with pytest.raises(CloudError, match="cannot write"):
        write_cloud(tmp_path / "file" / "x.npz", Cloud(POINTS))
    with pytest.raises(CloudError, match=r"expected one of \.ply"):
        write_cloud(tmp_path / "x.txt", Cloud(POINTS))


def test_a_missing_file_prints_nothing(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "x.pcd").write_text("rubbish")
    with pytest.raises(CloudError):
        read_cloud(tmp_path / "x.pcd")
    out, err = capfd.readouterr()
    assert out == "" and err == ""


@pytest.mark.parametrize("suffix", [".pcd", ".ply", ".npz", ".npy"])
@pytest.mark.parametrize("binary", [True, False])
def test_places_on_a_map_keep_their_millimetres(tmp_path, suffix: str, binary: bool) -> None:
    far = POINTS + np.array([512_345.678, 5_403_210.987, 310.0])
    path = tmp_path / f"far{suffix}"
    write_cloud(path, Cloud(far, COLORS), binary=binary)
    np.testing.assert_allclose(read_cloud(path).points, far, atol=1e-4, rtol=0)


def test_a_pcd_near_the_origin_stays_float32(tmp_path) -> None:
    holes = np.concatenate([POINTS, np.full((1, 3), np.nan)])
    write_cloud(tmp_path / "near.pcd", Cloud(holes))
    assert b"SIZE 4 4 4\n" in (tmp_path / "near.pcd").read_bytes()
