"""Files as strangers write them, and damaged ones: never points that were not in the file."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np
import pytest

from megrasp_core.errors import CloudError
from megrasp_core.pointcloud import Cloud, read_cloud, write_cloud
from megrasp_core.pointcloud.pcd import unlzf

RNG = np.random.default_rng(1)
POINTS = np.round(RNG.uniform(-0.5, 0.5, (180, 3)), 4)
FORMATS = {
    "binary.ply": True, "text.ply": False, "binary.pcd": True, "text.pcd": False,
    "cloud.npy": True, "cloud.npz": True,
}  # fmt: skip


def ply(path: Path, body: str, *, properties: str = "float x,float y,float z", n: int = 2) -> Path:
    lines = "\n".join(f"property {one}" for one in properties.split(","))
    path.write_text(f"ply\nformat ascii 1.0\nelement vertex {n}\n{lines}\nend_header\n{body}")
    return path


@pytest.mark.parametrize("name", FORMATS)
def test_no_mutation_gives_other_points_or_a_traceback(tmp_path: Path, name: str) -> None:
    """Bytes changed, cut, doubled: an error, or rows that were there, in their order, but for
    those that a change fell into.
    """
    path = tmp_path / name
    write_cloud(path, Cloud(POINTS), binary=FORMATS[name])
    whole, read = path.read_bytes(), read_cloud(path)
    known = {row.tobytes() for row in read.points}
    rng = np.random.default_rng(len(name))
    refused = 0
    for _ in range(340):
        data = bytearray(whole)
        touched = int(rng.integers(0, 3))
        # Headers are short: half of the changes go there.
        reach = len(data) if rng.random() < 0.5 else min(len(data), 330)
        for _ in range(touched):
            data[int(rng.integers(reach))] = int(rng.integers(256))
        if not touched:
            end = int(rng.integers(len(data)))
            data = data[:end] if rng.random() < 0.8 else data + data[:end]
        path.write_bytes(bytes(data))
        try:
            found = read_cloud(path).points
        except CloudError as error:
            assert path.name in str(error)
            refused += 1
            continue
        strange = sum(row.tobytes() not in known for row in found)
        assert len(found) <= len(POINTS) and strange <= touched, bytes(data[:330])
    assert refused > 60


def test_the_end_of_a_file_is_told_by_its_last_row(tmp_path: Path) -> None:
    for name, told in (("binary.ply", "vertex 90 of 180"), ("binary.pcd", "point 90 of 180")):
        path = tmp_path / name
        write_cloud(path, Cloud(POINTS))
        data = path.read_bytes()
        row = 24 if name.endswith("ply") else 12
        path.write_bytes(data[: len(data) - 90 * row])
        with pytest.raises(CloudError, match=f"{name} ends at {told}"):
            read_cloud(path)
    for name, told in (("text.ply", "vertex 89 of 180"), ("text.pcd", "point 89 of 180")):
        path = tmp_path / name
        write_cloud(path, Cloud(POINTS), binary=False)
        lines = path.read_text().splitlines(keepends=True)
        path.write_text("".join(lines[:-91]))
        with pytest.raises(CloudError, match=f"{name} ends at {told}"):
            read_cloud(path)


def test_infinite_rows_are_holes_and_words_are_damage(tmp_path: Path) -> None:
    path = ply(tmp_path / "a.ply", "-inf -inf inf\n0.1 0.2 0.3\n")
    assert read_cloud(path).points.tolist() == [[0.1, 0.2, 0.3]]
    path = ply(tmp_path / "b.ply", "0.1 0.2 0.3\n0.1 zero 0.3\n")
    with pytest.raises(CloudError, match=r"damaged at vertex 1 of 2: '0.1 zero 0.3'.*3 numbers"):
        read_cloud(path)


def test_a_last_line_without_its_end_does_not_count(tmp_path: Path) -> None:
    path = ply(tmp_path / "a.ply", "0.1 0.2 0.3\n0.4 0.5 0.6\n0.7 0.8 0.9", n=3)
    assert read_cloud(path).points.tolist() == [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]]


def test_further_properties_and_elements_before_the_vertices(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    head = (
        "ply\nformat binary_big_endian 1.0\ncomment from elsewhere\n"
        "element face 2\nproperty list uchar int vertex_indices\n"
        "element vertex 2\nproperty float nx\nproperty double z\nproperty double x\n"
        "property double y\nproperty ushort red\nproperty ushort green\nproperty ushort blue\n"
        "end_header\n"
    )
    faces = struct.pack(">B3iB4i", 3, 0, 1, 2, 4, 0, 1, 2, 3)
    rows = b"".join(
        struct.pack(">fdddHHH", 9.0, z, x, y, 65535, 0, 0)
        for x, y, z in ((0.1, 0.2, 0.3), (0.4, 0.5, 0.6))
    )
    path.write_bytes(head.encode() + faces + rows)
    cloud = read_cloud(path)
    assert cloud.points.tolist() == [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]]
    assert cloud.colors is not None and cloud.colors.tolist() == [[1.0, 0.0, 0.0]] * 2


@pytest.mark.parametrize(
    ("properties", "told"),
    [
        ("float x,float y", r"have x \(f4\), y \(f4\); expected x, y, z"),
        ("float x,float y,double z", "of one type"),
        ("float x,float y,list uchar int z", "no lists"),
        ("half x,half y,half z", r"header line 'property half x'"),
    ],
)
def test_vertices_of_another_kind_are_named(tmp_path: Path, properties: str, told: str) -> None:
    with pytest.raises(CloudError, match=told):
        read_cloud(ply(tmp_path / "a.ply", "1 2 3\n4 5 6\n", properties=properties))


def test_pixels_without_a_reading_are_left_out(tmp_path: Path, caplog) -> None:
    points = np.concatenate([np.zeros((40, 3)), POINTS])
    np.save(tmp_path / "a.npy", points)
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.npy").points, POINTS)
    assert "40 of 220 points" in caplog.text and "exactly 0 0 0" in caplog.text
    np.save(tmp_path / "b.npy", np.concatenate([np.zeros((1, 3)), POINTS]))
    assert len(read_cloud(tmp_path / "b.npy")) == 181, "one point may be there"


@pytest.mark.parametrize(
    ("value", "told"),
    [(0.0, "all 50 points .* are 0 0 0"), (0.3, r"are \[0.3, 0.3, 0.3\]"), (1e9, "up to 1e\\+09")],
)
def test_what_is_no_surface_is_refused(tmp_path: Path, value: float, told: str) -> None:
    np.save(tmp_path / "a.npy", np.full((50, 3), value))
    with pytest.raises(CloudError, match=told):
        read_cloud(tmp_path / "a.npy")


def test_arrays_of_other_shapes_are_read_or_named(tmp_path: Path) -> None:
    def saved(array: np.ndarray) -> Path:
        np.save(tmp_path / "a.npy", array)
        return tmp_path / "a.npy"

    table = np.zeros(180, [("x", "f4"), ("y", "f4"), ("z", "f4"), ("rgb", "u4")])
    for axis, name in enumerate("xyz"):
        table[name] = POINTS[:, axis]
    np.testing.assert_allclose(read_cloud(saved(table)).points, POINTS, atol=1e-6)
    for array, told in (
        (POINTS.T, r"shape \(3, 180\).*points\.T"),
        (np.hstack([POINTS, POINTS]), r"shape \(180, 6\).*points\[:, :3\]"),
        (np.ones((120, 160)), "looks like a depth image"),
        (np.ones((8, 9, 4)), r"points\[\.\.\., :3\]"),
        (table[["x", "y"]], "fields x, y; expected x, y, z"),
    ):
        with pytest.raises(CloudError, match=told):
            read_cloud(saved(array))
    np.save(tmp_path / "p.npy", np.array({"points": POINTS}, dtype=object), allow_pickle=True)
    with pytest.raises(CloudError, match=r"pickled Python object.*np\.savez"):
        read_cloud(tmp_path / "p.npy")


def test_a_depth_image_with_its_camera(tmp_path: Path) -> None:
    depth = np.full((4, 6), 0.5, np.float32)
    depth[0, 0] = 0.0
    matrix = np.array([[100.0, 0, 2.5], [0, 200.0, 1.5], [0, 0, 1]])
    np.savez(tmp_path / "a.npz", depth=depth, K=matrix)
    cloud = read_cloud(tmp_path / "a.npz")
    assert len(cloud) == 23 and cloud.viewpoint is not None and not cloud.viewpoint.any()
    np.testing.assert_allclose(cloud.points[-1], [0.5 * 2.5 / 100, 0.5 * 1.5 / 200, 0.5])
    np.savez(tmp_path / "b.npz", depth=(1000 * depth).astype(np.uint16), K=matrix)
    with pytest.raises(CloudError, match="Divide whole millimetres by 1000"):
        read_cloud(tmp_path / "b.npz")


def pcd(path: Path, points: np.ndarray, viewpoint: str) -> Path:
    rows = "\n".join(" ".join(f"{value:.6f}" for value in row) for row in points)
    path.write_text(
        "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT {viewpoint}\nPOINTS {len(points)}\nDATA ascii\n"
        f"{rows}\n"
    )
    return path


def test_viewpoint_is_the_sensors_place(tmp_path: Path, caplog) -> None:
    # Down along -z with the camera's x along x: half a turn about x.
    world = pcd(tmp_path / "world.pcd", POINTS * [1, 1, 0.1], "0.1 -0.2 0.9 0 1 0 0")
    assert read_cloud(world).viewpoint.tolist() == [0.1, -0.2, 0.9]
    assert "taken from VIEWPOINT" in caplog.text
    turned = [0.1, -0.2, 0.9] + POINTS * [1, -1, -0.1] - [0, 0, 0.9]
    for place, holes in (("own.pcd", 0), ("holes.pcd", 40)):
        seen = POINTS * [1, 1, 0.1] + [0, 0, 0.9]
        seen = np.concatenate([np.zeros((holes, 3)), seen])
        own = pcd(tmp_path / place, seen, "0.1 -0.2 0.9 0 1 0 0")
        assert read_cloud(own).viewpoint.tolist() == [0.1, -0.2, 0.9]
        np.testing.assert_allclose(read_cloud(own).points, turned, atol=1e-6)
        assert "--frame optical --gravity 0 0 1" in caplog.text
        kept = read_cloud(own, optical=True)
        np.testing.assert_allclose(kept.points, seen[holes:], atol=1e-6)
        assert not kept.viewpoint.any()
    plain = pcd(tmp_path / "plain.pcd", POINTS, "0 0 0 1 0 0 0")
    assert read_cloud(plain).viewpoint is None


def test_points_at_the_sensor_are_no_readings(tmp_path: Path, caplog) -> None:
    place = np.array([0.1, -0.2, 0.9])
    seen = np.concatenate([POINTS, np.tile(np.float32(place), (30, 1))])
    np.savez(tmp_path / "a.npz", points=seen, viewpoint=place)
    assert len(read_cloud(tmp_path / "a.npz")) == len(POINTS)
    assert "30 of 210 points" in caplog.text


@pytest.mark.parametrize(
    ("arrays", "told"),
    [
        ({"points": np.zeros((3, 24, 32))}, r"np\.moveaxis\(points, 0, -1\)"),
        ({"points": np.zeros((4, 500))}, r"points\[:3\]\.T"),
        ({"points": POINTS, "colors": np.array(None)}, "leave out what is None"),
        ({"points": POINTS, "colors": np.array(3.0)}, "'colors' is float64 of shape"),
    ],
)
def test_arrays_that_are_no_points_get_advice_that_works(
    tmp_path: Path, arrays: dict[str, np.ndarray], told: str
) -> None:
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(CloudError, match=told):
        read_cloud(tmp_path / "a.npz")


def test_numbers_of_python_are_none_of_a_file(tmp_path: Path) -> None:
    path = pcd(tmp_path / "a.pcd", POINTS, "0 0 0 1 0 0 0")
    path.write_text(
        path.read_text()
        .replace("DATA ascii\n0.", "DATA ascii\n1_0.")
        .replace("DATA ascii\n-0.", "DATA ascii\n-1_0.")
    )
    with pytest.raises(CloudError, match="damaged at point 0"):
        read_cloud(path)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("SIZE 4 4 4", "SIZE 4 4 3", "TYPE F of SIZE 3"),
        ("POINTS 180", "POINTS 190", "POINTS 190, but WIDTH 180 times HEIGHT 1"),
        ("COUNT 1 1 1", "COUNT 1 1", "3 FIELDS, 3 TYPEs, 2 COUNTs"),
        ("FIELDS x y z", "FIELDS x y x", "has a name twice"),
        ("FIELDS x y z", "FIELDS x y w", "expected x, y, z"),
        ("DATA ascii", "DATA morse", "DATA morse"),
        ("WIDTH 180\n", "", "no 'WIDTH'"),
    ],
)
def test_headers_that_do_not_fit_are_named(tmp_path: Path, old: str, new: str, told: str) -> None:
    path = pcd(tmp_path / "a.pcd", POINTS, "0 0 0 1 0 0 0")
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(CloudError, match=told):
        read_cloud(path)


def test_compressed_points(tmp_path: Path) -> None:
    """Literal runs, and references that overlap what they write."""
    flat = np.tile(np.float32([0.25, 0.5]), (3, 4)).astype("<f4").tobytes()  # fields one by one
    assert unlzf(bytes([7, *flat[:8], 0b11100000, 96 - 8 - 9, 7]), 96) == flat
    head = (
        "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 8\nHEIGHT 1\n"
        "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 8\nDATA binary_compressed\n"
    )
    stream = io.BytesIO()
    body = bytes([7, *flat[:8], 0b11100000, 96 - 8 - 9, 7])
    stream.write(head.encode() + struct.pack("<II", len(body), 96) + body)
    path = tmp_path / "a.pcd"
    path.write_bytes(stream.getvalue())
    points = read_cloud(path).points
    assert points.shape == (8, 3) and points[:2].tolist() == [[0.25] * 3, [0.5] * 3]
    path.write_bytes(stream.getvalue()[:-2])
    with pytest.raises(CloudError, match="ends at point"):
        read_cloud(path)
    with pytest.raises(ValueError, match="refers to what is not there"):
        unlzf(bytes([0b00100000, 5]), 3)
