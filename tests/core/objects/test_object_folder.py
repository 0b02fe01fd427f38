"""Object folders: round trip, the assets' own files, messages."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh

from megrasp_core.errors import InvalidRequestError, ObjectError
from megrasp_core.objects import (
    OBJECT_KINDS,
    TRAIN_SETS,
    ObjectModel,
    asset_objects,
    generate_objects,
    is_validation,
    load_object,
    load_objects,
    procedural_object,
    save_object,
)

needs_assets = pytest.mark.skipif(
    "MEGRASP_ASSETS" not in os.environ, reason="MEGRASP_ASSETS is not set: no outside objects here"
)


@pytest.mark.parametrize("kind", ["box", "bottle", "bowl", "l_bracket"])
def test_round_trip(tmp_path: Path, kind: str) -> None:
    model = procedural_object(11, kind)
    save_object(model, tmp_path / "thing")
    back = load_object(tmp_path / "thing")
    assert back.name == "thing" and back.category == kind
    np.testing.assert_allclose(back.vertices, model.vertices, rtol=1e-8, atol=1e-12)
    np.testing.assert_array_equal(back.faces, model.faces)
    assert len(back.pieces) == len(model.pieces)
    for got, expected in zip(back.pieces, model.pieces, strict=True):
        np.testing.assert_array_equal(got.vertices, expected.vertices.astype(np.float32))
        np.testing.assert_array_equal(got.faces, expected.faces)
    assert (back.mass, back.colour, back.friction) == (model.mass, model.colour, model.friction)
    np.testing.assert_array_equal(back.inertia, model.inertia)
    assert load_object(tmp_path / "thing", "set/other").name == "set/other"


def test_the_files_are_those_of_the_format(tmp_path: Path) -> None:
    model = procedural_object(2, "tube")
    save_object(model, tmp_path / "a", {"licence": "Apache-2.0"})
    assert sorted(p.name for p in (tmp_path / "a").iterdir()) == [
        "collision.npz",
        "meta.json",
        "visual.obj",
    ]
    with np.load(tmp_path / "a" / "collision.npz") as data:
        assert {key: data[key].dtype.name for key in data} == {
            "verts": "float32",
            "faces": "int32",
            "vert_start": "int32",
            "face_start": "int32",
        }
        assert data["vert_start"][0] == 0 and data["vert_start"][-1] == len(data["verts"])
        assert len(data["vert_start"]) == len(model.pieces) + 1
        assert data["faces"].max() < np.diff(data["vert_start"]).max()
    meta = json.loads((tmp_path / "a" / "meta.json").read_text())
    mesh = trimesh.load_mesh(tmp_path / "a" / "visual.obj")
    assert meta["volume"] == pytest.approx(mesh.volume, rel=1e-6)
    assert meta["convex_volume"] == pytest.approx(mesh.volume, rel=1e-6)
    np.testing.assert_allclose(meta["extents"], mesh.extents, atol=1e-8)
    assert (
        meta["watertight"] is True and meta["com"] == [0, 0, 0] and meta["licence"] == "Apache-2.0"
    )


def test_load_objects_finds_every_folder_by_relative_path(tmp_path: Path) -> None:
    for name in ("b/two", "a/one", "a/deep/three"):
        save_object(procedural_object(1, "block"), tmp_path / name)
    (tmp_path / "a" / "notes").mkdir()
    assert [m.name for m in load_objects(tmp_path)] == ["a/deep/three", "a/one", "b/two"]
    assert [m.name for m in load_objects(tmp_path / "b" / "two")] == ["two"]


def test_generate_objects(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    folders = generate_objects(tmp_path / "new", 5, 40, lambda done, n: seen.append((done, n)))
    assert seen == [(1, 5), (2, 5), (3, 5), (4, 5), (5, 5)] and len(set(folders)) == 5
    models = load_objects(tmp_path / "new")
    assert sorted(m.name for m in models) == sorted(f.name for f in folders)
    for folder, seed in zip(folders, range(40, 45), strict=True):
        expected, got = procedural_object(seed), load_object(folder)
        np.testing.assert_allclose(got.vertices, expected.vertices, atol=1e-9)
        meta = json.loads((folder / "meta.json").read_text())
        assert meta["licence"] == "Apache-2.0" and f"seed {seed}" in meta["source"]
        assert got.category == expected.category and got.category in OBJECT_KINDS
    generate_objects(tmp_path / "again", 5, 40)
    for folder in folders:
        for file in ("visual.obj", "meta.json"):
            twin = tmp_path / "again" / folder.name / file
            assert twin.read_bytes() == (folder / file).read_bytes()
    with pytest.raises(InvalidRequestError, match="asked for 0 objects; expected at least 1"):
        generate_objects(tmp_path, 0)


def broken(folder: Path, case: str) -> None:
    save_object(procedural_object(5, "block"), folder)
    meta = json.loads((folder / "meta.json").read_text())
    if case == "two_files":
        (folder / "visual.obj").unlink()
        (folder / "collision.npz").unlink()
    elif case == "no_mass":
        del meta["mass"]
    elif case == "null_inertia":
        meta["inertia"] = None
    elif case == "negative_mass":
        meta["mass"] = -1
    elif case == "flat_inertia":
        meta["inertia"] = [[1, 0, 0], [0, 1, 0], [0, 0, -1]]
    elif case == "text_mass":
        meta["mass"] = "heavy"
    elif case == "rgb":
        meta["rgb"] = [1, 0]
    elif case == "obj":
        (folder / "visual.obj").write_text("v 0 0 0\nf 1 2\n")
    elif case == "index":
        (folder / "visual.obj").write_text(
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n" + "f 1 2 9\n" * 4
        )
    elif case == "npz":
        (folder / "collision.npz").write_bytes(b"PK\x03\x04 rubbish")
    elif case == "arrays":
        np.savez(folder / "collision.npz", verts=np.zeros((3, 3)), faces=np.zeros((1, 3)))
    elif case == "starts":
        with np.load(folder / "collision.npz") as data:
            arrays = {key: data[key] for key in data}
        arrays["vert_start"] = np.array([0, 5])
        np.savez(folder / "collision.npz", **arrays)
    if case == "json":
        (folder / "meta.json").write_text("{")
    else:
        (folder / "meta.json").write_text(json.dumps(meta))


@pytest.mark.parametrize(
    ("case", "parts"),
    [
        ("two_files", ["lacks visual.obj, collision.npz", "megrasp objects"]),
        ("no_mass", ["lacks mass", "(kg)"]),
        ("null_inertia", ["lacks inertia"]),
        ("negative_mass", ["mass -1.0", "over 0"]),
        ("flat_inertia", ["positive definite"]),
        ("text_mass", ["wrong kind", "heavy"]),
        ("rgb", ["wrong kind", "2 numbers where 3"]),
        ("obj", ["visual.obj"]),
        ("index", ["visual.obj"]),
        ("npz", ["collision.npz is damaged"]),
        ("arrays", ["collision.npz lacks the arrays vert_start, face_start"]),
        ("starts", ["do not fit"]),
        ("json", ["not readable JSON"]),
    ],
)
def test_messages_name_folder_and_fault(tmp_path: Path, case: str, parts: list[str]) -> None:
    folder = tmp_path / "my_object"
    broken(folder, case)
    with pytest.raises(ObjectError) as caught:
        load_object(folder)
    message = str(caught.value)
    assert str(folder) in message
    for part in parts:
        assert part in message
    with pytest.raises(ObjectError):
        load_objects(tmp_path)


def test_missing_folders(tmp_path: Path) -> None:
    with pytest.raises(ObjectError, match=r"no object folder .*nowhere.*visual.obj"):
        load_object(tmp_path / "nowhere")
    with pytest.raises(ObjectError, match=r"no folder .*nowhere"):
        load_objects(tmp_path / "nowhere")
    with pytest.raises(
        ObjectError, match=r"holds no object: no meta\.json.*megrasp objects generate"
    ):
        load_objects(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(ObjectError, match="cannot write the object folder"):
        save_object(procedural_object(0, "block"), tmp_path / "file" / "x")


def test_models_check_themselves() -> None:
    good = procedural_object(0, "block")
    parts = (good.vertices, good.faces, good.pieces, 0.1, good.inertia)
    with pytest.raises(ObjectError, match="'x' has no convex piece"):
        ObjectModel("x", good.vertices, good.faces, (), 0.1, good.inertia)
    with pytest.raises(ObjectError, match=r"faces of its visual mesh have the shape \(12, 2\)"):
        ObjectModel("x", good.vertices, good.faces[:, :2], *parts[2:])
    with pytest.raises(ObjectError, match="mass nan"):
        ObjectModel("x", *parts[:3], float("nan"), good.inertia)
    with pytest.raises(ObjectError, match="names vertex 99 of 8"):
        ObjectModel("x", good.vertices, np.where(good.faces == 0, 99, good.faces), *parts[2:])


def fake_assets(root: Path) -> None:
    for split, sets in (
        ("train", [*TRAIN_SETS, "kit_bigbird"]),
        ("devtest", ["ycb", "kit_bigbird"]),
    ):
        for group in sets:
            for k in range(12):
                folder = root / "objects" / split / group / f"{split}_{k:02d}"
                folder.mkdir(parents=True)
                (folder / "meta.json").write_text("{}")


def test_splits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake_assets(tmp_path)
    monkeypatch.setenv("MEGRASP_ASSETS", str(tmp_path))
    train, validation, devtest = (asset_objects(s) for s in ("train", "validation", "devtest"))
    assert not set(train) & set(validation) and len(train) + len(validation) == 60
    assert 1 <= len(validation) <= 15
    assert len(devtest) == 24 and {f.parent.name for f in devtest} == {"ycb", "kit_bigbird"}
    assert all(f.parent.parent.name == "train" for f in train + validation)
    assert {f.parent.name for f in train} == set(TRAIN_SETS)
    for folder in validation:
        assert is_validation(f"{folder.parent.name}/{folder.name}")
    # One object more must not move another between the splits.
    shutil.rmtree(train[0])
    assert asset_objects("validation") == validation
    with pytest.raises(
        InvalidRequestError, match="'test'; expected one of train, validation, devtest"
    ):
        asset_objects("test")


def test_hash_is_stable() -> None:
    """The split is written into models' cards: these must never change."""
    names = [f"ycb/{k:03d}" for k in range(200)]
    held_back = [name for name in names if is_validation(name)]
    assert held_back[:4] == HELD_BACK and 10 <= len(held_back) <= 30


HELD_BACK = ["ycb/015", "ycb/024", "ycb/034", "ycb/042"]


def test_missing_assets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MEGRASP_ASSETS", raising=False)
    with pytest.raises(ObjectError, match=r"MEGRASP_ASSETS is not set.*procedural"):
        asset_objects("train")
    monkeypatch.setenv("MEGRASP_ASSETS", str(tmp_path))
    with pytest.raises(ObjectError, match="does not exist"):
        asset_objects("train")


@needs_assets
def test_real_assets() -> None:
    validation = [load_object(p, f"{p.parent.name}/{p.name}") for p in asset_objects("validation")]
    assert len(asset_objects("train")) + len(validation) == 119
    assert len(asset_objects("devtest")) == 48
    for model in validation:
        assert model.category in TRAIN_SETS
        low = np.min([piece.vertices.min(axis=0) for piece in model.pieces], axis=0)
        high = np.max([piece.vertices.max(axis=0) for piece in model.pieces], axis=0)
        assert np.abs(np.stack([low, high]) - model.bounds).max() < 0.01


@needs_assets
def test_real_object_round_trip(tmp_path: Path) -> None:
    source = asset_objects("validation")[0]
    model = load_object(source)
    save_object(model, tmp_path / source.name)
    back = load_object(tmp_path / source.name)
    np.testing.assert_allclose(back.vertices, model.vertices, atol=1e-9)
    for got, expected in zip(back.pieces, model.pieces, strict=True):
        np.testing.assert_array_equal(got.vertices, expected.vertices)
    assert back.mass == model.mass and back.colour == model.colour
