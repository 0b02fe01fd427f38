"""Convex pieces: they cover the mesh, leave its hollows free, and keep to their limits."""

from __future__ import annotations

import sys
from types import ModuleType

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from megrasp_core.errors import InvalidRequestError, ObjectError
from megrasp_core.meshes import Mesh, repaired
from megrasp_core.objects import ConvexPiece, decompose
from megrasp_core.objects.cutting import Cut, cut, halves_of_vertices
from megrasp_core.objects.solids import volume_of


def mesh_of(found: trimesh.Trimesh) -> Mesh:
    return Mesh(np.array(found.vertices), np.array(found.faces, np.int64))


def pipe() -> Mesh:
    return mesh_of(trimesh.creation.annulus(0.03, 0.036, 0.09))


def cup() -> Mesh:
    """Walls and a bottom of 3 mm, 60 mm wide, 70 mm high."""
    profile = [(0, 0), (0.03, 0), (0.03, 0.07), (0.027, 0.07), (0.027, 0.003), (0, 0.003)]
    found = trimesh.creation.revolve(np.array(profile, float), sections=48)
    found.merge_vertices()
    trimesh.repair.fix_normals(found)
    assert found.is_watertight and found.volume > 0
    return mesh_of(found)


def inside(pieces: tuple[ConvexPiece, ...], points: np.ndarray, margin: float) -> np.ndarray:
    """Which points lie in a piece, or no farther out than the margin."""
    found = np.zeros(len(points), bool)
    for vertices, _ in pieces:
        planes = ConvexHull(vertices).equations
        found |= (points @ planes[:, :3].T + planes[:, 3] <= margin).all(axis=1)
    return found


def test_cutting_keeps_the_volume() -> None:
    mesh = mesh_of(trimesh.creation.torus(0.05, 0.02))
    whole = Cut.of(mesh)
    assert whole.volume() == pytest.approx(volume_of(mesh.vertices, mesh.faces.astype(np.int32)))
    parts = [whole]
    rng = np.random.default_rng(3)
    for _ in range(4):
        normal = rng.standard_normal(3)
        normal /= np.linalg.norm(normal)
        offset = float(rng.uniform(-0.02, 0.02))
        halves = [half for part in parts for half in cut(part, normal, offset)]
        for part in parts:
            both = cut(part, normal, offset)
            assert sum(half.volume() for half in both) == pytest.approx(part.volume(), rel=1e-9)
            for half, vertices in zip(both, halves_of_vertices(part, normal, offset)):
                assert set(map(tuple, half.vertices())) == set(
                    map(tuple, np.unique(vertices, axis=0))
                )
        parts = [half for half in halves if len(half.surface)]
    half, other = cut(whole, np.array([1.0, 0.0, 0.0]), 0.0)
    assert half.volume() == pytest.approx(other.volume(), rel=1e-6)


def test_what_is_nearly_convex_becomes_its_hull() -> None:
    found = decompose(mesh_of(trimesh.creation.icosphere(4, 0.03)))
    assert len(found.pieces) == 1 and len(found.pieces[0].vertices) <= 82
    assert found.method.startswith("convex hull (mesh/hull volume 1.0")
    volume = volume_of(*found.pieces[0])
    assert 0.9 < volume / (4 / 3 * np.pi * 0.03**3) < 1.0


@pytest.mark.parametrize("make", [pipe, cup])
def test_what_is_hollow_stays_hollow(make) -> None:
    mesh = make()
    found = decompose(mesh, "planes")
    assert 6 <= len(found.pieces) <= 24
    assert max(len(piece.vertices) for piece in found.pieces) <= 48
    assert inside(found.pieces, mesh.vertices, 0.001).all()
    low, high = np.quantile(mesh.vertices[:, 2], [0, 1])
    z = np.linspace(low + 0.012, high, 20)
    angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    radius = 0.021
    free = np.array([(radius * np.cos(a), radius * np.sin(a), h) for a in angle for h in z])
    assert not inside(found.pieces, free, -1e-6).any()
    solid = volume_of(mesh.vertices, mesh.faces.astype(np.int32))
    assert sum(volume_of(*piece) for piece in found.pieces) < 1.6 * solid


def test_an_exact_bracket_comes_apart_exactly() -> None:
    parts = [
        trimesh.creation.box(bounds=[[0, 0, 0], [0.06, 0.03, 0.01]]),
        trimesh.creation.box(bounds=[[0, 0, 0.01], [0.01, 0.03, 0.05]]),
    ]
    outline = np.array([[0, 0], [0.06, 0], [0.06, 0.01], [0.01, 0.01], [0.01, 0.05], [0, 0.05]])
    low, high = (np.insert(outline, 1, y, axis=1) for y in (0.0, 0.03))
    cap = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    side = [(i, j, i + 6) for i, j in zip(range(6), [1, 2, 3, 4, 5, 0])]
    side += [(j, j + 6, i + 6) for i, j in zip(range(6), [1, 2, 3, 4, 5, 0])]
    mesh = Mesh(np.concatenate([low, high]), np.concatenate([cap, cap[:, ::-1] + 6, side]))
    found = decompose(repaired(mesh).mesh, "planes")
    solid = sum(part.volume for part in parts)
    assert len(found.pieces) <= 6
    assert sum(volume_of(*piece) for piece in found.pieces) == pytest.approx(solid, rel=0.05)


def test_pieces_do_not_depend_on_where_the_mesh_is() -> None:
    mesh = cup()
    here = decompose(mesh, "planes")
    there = decompose(Mesh(mesh.vertices + np.array([0.5, -0.25, 1.0]), mesh.faces), "planes")
    volumes = [sum(volume_of(*piece) for piece in d.pieces) for d in (here, there)]
    assert volumes[0] == pytest.approx(volumes[1], rel=0.1)


def test_an_open_mesh_and_a_single_hull() -> None:
    mesh = pipe()
    assert len(decompose(mesh, "hull").pieces) == 1
    found = decompose(Mesh(mesh.vertices, mesh.faces[5:]), "planes")
    assert len(found.pieces) == 1 and "not closed" in found.method


def test_flat_meshes_and_unknown_methods_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    square = np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]], float)
    with pytest.raises(ObjectError, match=r"the mesh is flat.*0\.1.*volume"):
        decompose(Mesh(square, np.array([[0, 1, 2], [0, 2, 3]])))
    with pytest.raises(InvalidRequestError, match="'vhacd'; expected one of auto, coacd, planes"):
        decompose(pipe(), "vhacd")  # type: ignore[arg-type]
    monkeypatch.setattr("megrasp_core.objects.decomposition.has_coacd", lambda: False)
    with pytest.raises(InvalidRequestError, match=r"pip install megrasp-core\[objects\]"):
        decompose(pipe(), "coacd")


def test_coacd_is_taken_where_it_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    given: dict = {}
    module = ModuleType("coacd")
    module.set_log_level = lambda level: None  # type: ignore[attr-defined]
    module.Mesh = lambda vertices, faces: (vertices, faces)  # type: ignore[attr-defined]

    def run_coacd(mesh, **options):
        given.update(options, faces=len(mesh[1]))
        low, high = (trimesh.creation.box(bounds=[[0, 0, z], [1, 1, z + 1]]) for z in (0, 1))
        return [[low.vertices, low.faces], [high.vertices, high.faces]]

    module.run_coacd = run_coacd  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "coacd", module)
    monkeypatch.setattr("megrasp_core.objects.decomposition.has_coacd", lambda: True)
    found = decompose(pipe())
    assert len(found.pieces) == 2 and found.method.startswith("coacd threshold 0.06")
    assert given["max_convex_hull"] == 24 and given["faces"] <= 900
