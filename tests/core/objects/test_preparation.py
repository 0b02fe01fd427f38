"""Objects from mesh files: units, repair, mass; folders that resume; at rest on a table."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from megrasp_core.errors import InvalidRequestError, ObjectError
from megrasp_core.jobs import Progress
from megrasp_core.objects import (
    MeshFile,
    Prepared,
    PrepareSettings,
    load_object,
    load_objects,
    mesh_files,
    prepare_object,
    prepare_objects,
)
from megrasp_core.simulation.clutter import settle

BOX = (0.06, 0.05, 0.04)


def box(size: tuple[float, float, float] = BOX) -> trimesh.Trimesh:
    return trimesh.creation.box(size)


def l_shape() -> trimesh.Trimesh:
    """Two slabs of one surface, 60 x 50 x 30 mm."""
    t = 0.01
    outline = np.array([(0, 0), (0.06, 0), (0.06, t), (t, t), (t, 0.05), (0, 0.05)])
    cap = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    return trimesh.creation.extrude_triangulation(outline, cap, 0.03)


def file_of(mesh: trimesh.Trimesh, path: Path) -> MeshFile:
    path.parent.mkdir(parents=True, exist_ok=True)
    mesh.export(path)
    return MeshFile(path.stem, path)


def prepared(mesh: trimesh.Trimesh, folder: Path, **settings) -> Prepared:
    return prepare_object(file_of(mesh, folder / "thing.ply"), PrepareSettings(**settings))


def test_mass_inertia_and_centre_are_those_of_the_solid(tmp_path: Path) -> None:
    mesh = box()
    mesh.apply_translation([0.3, -0.2, 0.5])
    found = prepared(mesh, tmp_path, density=800.0)
    model, (x, y, z) = found.model, BOX
    assert model.mass == pytest.approx(800.0 * x * y * z, rel=1e-5)
    expected = model.mass / 12.0 * np.diag([y * y + z * z, x * x + z * z, x * x + y * y])
    np.testing.assert_allclose(model.inertia, expected, rtol=1e-4, atol=1e-10)
    np.testing.assert_allclose(
        model.bounds, np.array([-1, 1])[:, None] * np.array(BOX) / 2, atol=1e-6
    )
    np.testing.assert_allclose(found.meta["source_offset"], [0.3, -0.2, 0.5], atol=1e-6)
    assert found.meta["mass_source"] == "volume*density" and found.meta["density"] == 800.0
    default = prepared(mesh, tmp_path)
    assert default.model.mass == pytest.approx(500.0 * x * y * z, rel=1e-5)
    given = prepared(mesh, tmp_path, mass=0.25)
    assert given.model.mass == pytest.approx(0.25) and given.meta["mass_source"] == "given"
    np.testing.assert_allclose(
        given.model.inertia, expected * 0.25 / model.mass, rtol=1e-4, atol=1e-10
    )


def test_a_mesh_far_from_its_origin(tmp_path: Path) -> None:
    mesh, place = box(), np.array([400_000.0, 5_000_000.0, 300.0])
    mesh.apply_translation(place)
    path = tmp_path / "thing.obj"
    mesh.export(path, digits=9)
    found = prepare_object(MeshFile("thing", path), PrepareSettings(density=800.0))
    assert found.model.mass == pytest.approx(800.0 * np.prod(BOX), rel=1e-4)
    np.testing.assert_allclose(found.meta["source_offset"], place, atol=1e-5)


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (1000.0, ["60 m long", "In millimetres it would be 60 mm (--scale 0.001)"]),
        (100.0, ["6 m long", "In centimetres it would be 60 mm (--scale 0.01)", "in inches"]),
        (1 / 0.0254, ["2.36 m long", "in inches it would be 60 mm (--scale 0.0254)"]),
        (0.001, ["0.06 mm long", "expected metres, from 3 mm to 1 m"]),
    ],
)
def test_other_units_are_named(tmp_path: Path, factor: float, words: list[str]) -> None:
    mesh = box()
    mesh.apply_scale(factor)
    with pytest.raises(ObjectError) as caught:
        prepared(mesh, tmp_path)
    for word in ["thing.ply", *words]:
        assert word in str(caught.value)
    model = prepared(mesh, tmp_path, scale=1.0 / factor).model
    np.testing.assert_allclose(model.extents, BOX, rtol=1e-5)


def test_a_wrong_scale_is_told_and_metres_named(tmp_path: Path) -> None:
    with pytest.raises(ObjectError, match=r"0\.06 mm long with the scale 0\.001.*In metres"):
        prepared(box(), tmp_path, scale=0.001)


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".stl", ".glb", ".off"])
def test_every_format_is_read(tmp_path: Path, suffix: str) -> None:
    model = prepare_object(file_of(l_shape(), tmp_path / f"thing{suffix}")).model
    np.testing.assert_allclose(np.sort(model.extents), [0.03, 0.05, 0.06], atol=1e-6)
    assert model.mass == pytest.approx(500.0 * l_shape().volume, rel=1e-4)


def test_colours_and_several_bodies_of_a_scene(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    for x in (0.0, 0.2):
        part = box()
        part.visual.face_colors = [200, 100, 0, 255]  # type: ignore[union-attr]
        pose = np.eye(4)
        pose[0, 3] = x
        scene.add_geometry(part, transform=pose)
    scene.export(tmp_path / "two.glb")
    found = prepare_object(MeshFile("two", tmp_path / "two.glb"))
    np.testing.assert_allclose(found.model.colour, [200 / 255, 100 / 255, 0.0], atol=0.02)
    assert found.model.extents[0] == pytest.approx(0.26, abs=1e-6)
    assert prepared(box(), tmp_path).meta["rgb"] is None


def test_the_visual_mesh_is_light_and_the_volume_that_of_all(tmp_path: Path) -> None:
    mesh = trimesh.creation.icosphere(5, 0.03)
    found = prepared(mesh, tmp_path, faces=500)
    assert 300 < len(found.model.faces) <= 500 and found.meta["source_faces"] == len(mesh.faces)
    assert found.meta["volume"] == pytest.approx(mesh.volume, rel=1e-4)


def test_a_damaged_mesh_is_repaired_and_told(tmp_path: Path) -> None:
    mesh = trimesh.creation.icosphere(3, 0.03)
    mesh.faces[:9] = mesh.faces[:9, ::-1]
    mesh.update_faces(np.arange(len(mesh.faces)) != 100)
    found = prepared(mesh, tmp_path)
    assert found.meta["watertight"]
    assert "9 faces turned" in found.line() and "holes closed" in found.line()
    assert found.meta["volume"] == pytest.approx(4 / 3 * np.pi * 0.03**3, rel=0.03)


def test_finding_meshes(tmp_path: Path) -> None:
    file_of(box(), tmp_path / "b.STL")
    file_of(box(), tmp_path / "a" / "mesh.obj")
    (tmp_path / "notes").mkdir()
    (tmp_path / "readme.txt").write_text("")
    assert [(f.name, f.path.name) for f in mesh_files(tmp_path)] == [
        ("a", "mesh.obj"),
        ("b", "b.STL"),
    ]
    assert [f.name for f in mesh_files(tmp_path / "b.STL")] == ["b"]
    file_of(box(), tmp_path / "a.ply")
    with pytest.raises(ObjectError, match=r"would both become the object a; .*Rename one"):
        mesh_files(tmp_path)
    file_of(box(), tmp_path / "a" / "other.obj")
    with pytest.raises(ObjectError, match=r"holds 2 meshes \(mesh.obj, other.obj\); expected one"):
        mesh_files(tmp_path)
    with pytest.raises(ObjectError, match=r"holds no mesh; expected \.obj, \.ply, \.stl, \.glb"):
        mesh_files(tmp_path / "notes")
    with pytest.raises(ObjectError, match="no folder"):
        mesh_files(tmp_path / "none")
    with pytest.raises(ObjectError, match="no mesh file"):
        mesh_files(tmp_path / "readme.txt")


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"scale": 0.0}, "scale 0.0 .* 0.001 for millimetres"),
        ({"density": -1.0}, "density -1.0 .* kg/m3 over 0"),
        ({"mass": 0.0}, "mass 0.0 .* kilograms over 0"),
        ({"faces": 3}, "3 faces .* at least 100"),
        ({"decomposition": "many"}, "'many'; expected one of auto"),
    ],
)
def test_wrong_settings_are_told(tmp_path: Path, settings: dict, words: str) -> None:
    with pytest.raises(InvalidRequestError, match=words):
        prepared(box(), tmp_path, **settings)


@pytest.fixture
def scans(tmp_path: Path) -> Path:
    folder = tmp_path / "scans"
    file_of(box(), folder / "box.stl")
    file_of(l_shape(), folder / "bracket.obj")
    file_of(trimesh.creation.icosphere(3, 0.03), folder / "ball" / "scan.ply")
    return folder


def run(scans: Path, out: Path, **settings) -> tuple[list[str], int]:
    """Names made, in order, and how many were kept."""
    summary = prepare_objects(scans, out, PrepareSettings(**settings))
    assert not summary.run.failed
    return [line.partition(":")[0] for line in summary.made], summary.kept


def test_a_folder_is_made_once_and_damage_made_again(scans: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert run(scans, out) == (["ball", "box", "bracket"], 0)
    assert sorted(p.name for p in (out / "box").iterdir()) == [
        "collision.npz",
        "meta.json",
        "visual.obj",
    ]
    assert run(scans, out) == ([], 3)
    (out / "ball" / "meta.json").unlink()
    collision = out / "bracket" / "collision.npz"
    collision.write_bytes(collision.read_bytes()[:200])
    visual = out / "box" / "visual.obj"
    before = visual.read_text()
    visual.write_text("\n".join(before.splitlines()[:-1]))
    assert run(scans, out) == (["ball", "box", "bracket"], 0)
    assert visual.read_text() == before
    (out / "ball" / "meta.json").write_text('{"prepared"')
    assert run(scans, out) == (["ball"], 2)
    assert run(scans, out, density=700.0) == (["ball", "box", "bracket"], 0)
    file_of(box((0.07, 0.05, 0.04)), scans / "box.stl")
    assert run(scans, out, density=700.0) == (["box"], 2)


def test_a_run_that_is_stopped_goes_on(scans: Path, tmp_path: Path) -> None:
    def stop(_: Progress) -> None:
        raise KeyboardInterrupt

    summary = prepare_objects(scans, tmp_path / "out", on_progress=stop)
    assert summary.run.cancelled and [folder.name for folder in summary.folders] == ["ball"]
    # As a kill while the next one is written leaves it.
    (tmp_path / "out" / "box").mkdir()
    (tmp_path / "out" / "box" / "visual.obj").write_text("v 0 0")
    assert run(scans, tmp_path / "out") == (["box", "bracket"], 1)
    assert len(load_objects(tmp_path / "out")) == 3


def test_a_mesh_that_fails_stops_no_other(scans: Path, tmp_path: Path) -> None:
    (scans / "a_bad.ply").write_text("ply\nformat ascii 1.0\nelement vertex 3\n")
    (scans / "flat.off").write_text("OFF\n3 1 0\n0 0 0\n.1 0 0\n0 .1 0\n3 0 1 2\n")
    summary = prepare_objects(scans, tmp_path / "out")
    assert [folder.name for folder in summary.folders] == ["ball", "box", "bracket"]
    told = {str(file): message for file, message in summary.run.failed}
    assert set(told) == {"a_bad", "flat"}
    assert "a_bad.ply cannot be read" in told["a_bad"] and "is flat" in told["flat"]


def test_foreign_objects_and_the_source_are_not_written_over(scans: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    prepare_objects(scans, out)
    meta = out / "box" / "meta.json"
    content = json.loads(meta.read_text())
    del content["prepared"]
    meta.write_text(json.dumps(content))
    summary = prepare_objects(scans, out)
    assert "not made of a mesh by this command" in summary.run.failed[0][1]
    assert json.loads(meta.read_text()) == content
    for place in (scans, scans / "deep", tmp_path):
        with pytest.raises(ObjectError, match="lie in one another"):
            prepare_objects(scans, place)
    with pytest.raises(ObjectError, match="which is a file"):
        prepare_objects(scans, meta)


def test_prepared_objects_come_to_rest_on_a_table(scans: Path, tmp_path: Path) -> None:
    prepare_objects(scans, tmp_path / "out")
    models = load_objects(tmp_path / "out")
    assert [model.name for model in models] == ["ball", "box", "bracket"]
    # The ball is for other tests: it may roll.
    scene = settle(models[1:], rng=np.random.default_rng(0))
    assert scene.ok and scene.kept == (0, 1)
    heights = scene.object_poses[:, 2, 3]
    assert (heights > 0.004).all() and (heights < 0.06).all()
    assert load_object(tmp_path / "out" / "bracket").mass == models[2].mass
