"""Device packs are mapped; damaged and foreign ones are told, and what a pack cannot hold."""

from __future__ import annotations

import dataclasses
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dataset_records import record
from made_packs import made_records, packed
from safetensors.numpy import load_file, save_file

from megrasp_core.errors import DataError, InvalidRequestError
from megrasp_core.pointcloud import SceneSettings
from megrasp_core.storage import DevicePack, PackSettings, open_scenes, verify_pack


@pytest.fixture(scope="module")
def pack(tmp_path_factory: pytest.TempPathFactory) -> DevicePack:
    return packed(tmp_path_factory.mktemp("pack") / "scenes.mgpack", made_records())


def test_opening_and_reading_touch_only_their_part(pack, tmp_path):
    """A pack whose last scene claims 2 GB, almost all of it a hole in the file."""
    arrays = load_file(pack.path)
    more = 2**28
    arrays["point_start"][-1] += more
    path, claimed = tmp_path / "huge.mgpack", int(arrays["point_start"][-1])
    rows = {"points": claimed, "normals": claimed, "on_plane": -(-claimed // 8)}
    kinds = {"float32": "F32", "int32": "I32", "int64": "I64", "int16": "I16", "int8": "I8"}
    header: dict[str, Any] = {"__metadata__": {"format": "megrasp device pack 1"}}
    start = 0
    for name, array in arrays.items():
        shape = [rows.get(name, len(array)), *array.shape[1:]]
        size = int(np.prod(shape)) * array.itemsize
        kind = kinds.get(array.dtype.name, "U8")
        header[name] = {"dtype": kind, "shape": shape, "data_offsets": [start, start + size]}
        start += size
    head = json.dumps(header).encode()
    with path.open("wb") as file:
        file.write(struct.pack("<Q", len(head)) + head)
        for name, array in arrays.items():
            file.seek(8 + len(head) + header[name]["data_offsets"][0])
            file.write(array.tobytes())
        file.truncate(8 + len(head) + start)
    assert path.stat().st_size > 2e9
    before = resident()
    huge = DevicePack(path)
    np.testing.assert_array_equal(huge[2].lattice, pack[2].lattice)
    assert resident() - before < 50e6


def resident() -> int:
    """Memory of this process, in bytes."""
    statm = Path("/proc/self/statm")
    if not statm.exists():
        pytest.skip("no /proc/self/statm: the memory of a process cannot be read")
    return int(statm.read_text().split()[1]) * 4096


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (lambda whole: whole[:-100], "damaged.*Copy the file again"),
        (lambda whole: whole + b"more", "damaged.*Copy the file again"),
        (lambda whole: whole[:5], "damaged.*Copy the file again"),
        (lambda whole: b"", "damaged.*Copy the file again"),
        (lambda whole: b"no safetensors at all" * 9, "no device pack"),
        (
            lambda whole: whole.replace(b"device pack 1", b"device pack 9", 1),
            r"has format 'megrasp device pack 9'; expected 'megrasp device pack 1'.*again",
        ),
    ],
)
def test_damage_is_told_when_opening(pack, tmp_path, content, expected):
    path = tmp_path / "damaged.mgpack"
    path.write_bytes(content(pack.path.read_bytes()))
    with pytest.raises(DataError, match=expected):
        DevicePack(path)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda a: {"points": a["points"][:-1]}, "points do not have the rows"),
        (lambda a: {"normals": a["normals"][:, :1]}, "normals has type I8 and shape"),
        (lambda a: {"origin": a["origin"].astype(np.float64)}, "origin has type F64"),
        (lambda a: {"point_start": a["point_start"][:0]}, "damaged"),
        (lambda a: {"inference": a["inference"] + 9000}, "more nodes than points"),
        (lambda a: {"label_start": a["label_start"][::-1].copy()}, "damaged"),
        (lambda a: {"meta": a["meta"][:-3]}, "damaged"),
        (lambda a: {"robust": a["robust"][1:]}, "robust do not have the rows"),
        (lambda a: {"robust": a["robust"].astype(np.int16)}, "robust has type I16"),
    ],
)
def test_arrays_that_do_not_fit_are_named(pack, tmp_path, change, expected):
    arrays = load_file(pack.path)
    path = tmp_path / "odd.mgpack"
    save_file({**arrays, **change(arrays)}, path, metadata={"format": "megrasp device pack 1"})
    with pytest.raises(DataError, match=expected):
        DevicePack(path)


def test_missing_and_foreign_files_are_told(tmp_path):
    with pytest.raises(DataError, match=r"no file .*none\.mgpack; expected a device pack"):
        open_scenes(tmp_path / "none.mgpack")
    save_file({"weight": np.zeros(3)}, tmp_path / "model.safetensors")
    with pytest.raises(DataError, match="has format ''; expected 'megrasp device pack 1'"):
        open_scenes(tmp_path / "model.safetensors")
    with pytest.raises(DataError, match="manifest"):
        open_scenes(tmp_path)


def test_verify_finds_a_changed_byte_and_a_wrong_owner(pack, tmp_path):
    assert verify_pack(pack.path) == []
    whole = bytearray(pack.path.read_bytes())
    whole[len(whole) // 2] ^= 1
    (tmp_path / "flipped.mgpack").write_bytes(whole)
    [problem] = verify_pack(tmp_path / "flipped.mgpack")
    assert "does not match its sha256" in problem
    arrays = load_file(pack.path)
    arrays["robust"][0] ^= 1
    save_file(arrays, tmp_path / "held.mgpack", metadata={"format": "megrasp device pack 1"})
    [problem] = verify_pack(tmp_path / "held.mgpack")
    assert "robust does not match its sha256" in problem
    del arrays["robust"]
    save_file(arrays, tmp_path / "lost.mgpack", metadata={"format": "megrasp device pack 1"})
    with pytest.raises(DataError, match="others were written"):
        verify_pack(tmp_path / "lost.mgpack")
    arrays = load_file(pack.path)
    arrays["reason"][:] = 200
    save_file(arrays, tmp_path / "odd.mgpack", metadata={"format": "megrasp device pack 1"})
    assert any("damaged at scene_0000000010" in p for p in verify_pack(tmp_path / "odd.mgpack"))


def test_what_a_pack_cannot_hold_is_refused(tmp_path):
    path = tmp_path / "scenes.mgpack"
    with pytest.raises(DataError, match="no scene was given"):
        packed(path, [])
    with pytest.raises(InvalidRequestError, match=r"100 points a scene.*at least 2048"):
        PackSettings(points=100)
    one = record(1)
    with pytest.raises(DataError, match=r"scene_0000000001 has .*finite.*data verify"):
        packed(path, [dataclasses.replace(one, points=np.full_like(one.points, np.inf))])
    owner = one.labels["first"].object + 300
    far = {"first": dataclasses.replace(one.labels["first"], object=owner)}
    with pytest.raises(DataError, match=r"labels with object 300 to 30.; expected 0 to 255"):
        packed(path, [dataclasses.replace(one, labels=far)])
    assert not path.exists()


def test_nodes_chosen_otherwise_are_refused(pack):
    with pytest.raises(DataError, match=r"'max_nodes': 2048.*'max_nodes': 1000.*Pack"):
        pack[0].nodes(SceneSettings(max_nodes=1000))
