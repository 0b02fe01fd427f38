"""Convex pieces: they cover the mesh, leave its hollows free, and keep to their limits."""

from __future__ import annotations

import logging
import sys

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from megrasp_core.errors import InvalidRequestError, ObjectError
from megrasp_core.meshes import Mesh
from megrasp_core.objects import ConvexPiece, decompose
from megrasp_core.objects.solids import volume_of

MISSING = "coacd is missing: pip install 'megrasp-core[objects]'"


def mesh_of(found: trimesh.Trimesh) -> Mesh:
    return Mesh(np.array(found.vertices), np.array(found.faces, np.int64))


def channel() -> Mesh:
    """A U of walls of 6 mm, 40 mm wide, 30 mm high and long."""
    x, y, t = 0.04, 0.03, 0.006
    outline = [(0, 0), (x, 0), (x, y), (x - t, y), (x - t, t), (t, t), (t, y), (0, y)]
    cap = [[0, 1, 4], [0, 4, 5], [1, 2, 3], [1, 3, 4], [0, 5, 6], [0, 6, 7]]
    return mesh_of(trimesh.creation.extrude_triangulation(np.array(outline), np.array(cap), 0.03))


def inside(pieces: tuple[ConvexPiece, ...], points: np.ndarray, margin: float) -> np.ndarray:
    """Which points lie in a piece, or no farther out than the margin (m)."""
    found = np.zeros(len(points), bool)
    for vertices, _ in pieces:
        planes = ConvexHull(vertices).equations
        found |= (points @ planes[:, :3].T + planes[:, 3] <= margin).all(axis=1)
    return found


def test_what_is_hollow_stays_hollow(capfd: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("coacd", reason=MISSING)
    mesh = channel()
    found = decompose(mesh, "coacd")
    assert found.method == "coacd threshold 0.06 max_convex_hull 24 max_ch_vertex 48 seed 0"
    assert 3 <= len(found.pieces) <= 24
    assert max(len(piece.vertices) for piece in found.pieces) <= 48
    surface = trimesh.Trimesh(*mesh, process=False)
    points = np.asarray(trimesh.sample.sample_surface(surface, 2000, seed=1)[0])
    assert inside(found.pieces, points, 0.001).all()
    axes = np.linspace([0.008, 0.008, 0.002], [0.032, 0.03, 0.028], 7).T
    free = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3)
    assert not inside(found.pieces, free, 0.0).any()
    solid = volume_of(mesh.vertices, mesh.faces.astype(np.int32))
    assert sum(volume_of(*piece) for piece in found.pieces) == pytest.approx(solid, rel=0.1)
    again = decompose(mesh)
    for one, other in zip(found.pieces, again.pieces, strict=True):
        np.testing.assert_array_equal(one.vertices, other.vertices)
    assert capfd.readouterr() == ("", "")


def test_what_is_nearly_convex_and_what_is_asked_to_be_becomes_its_hull() -> None:
    found = decompose(mesh_of(trimesh.creation.icosphere(4, 0.03)))
    assert len(found.pieces) == 1 and len(found.pieces[0].vertices) <= 162
    assert found.method.startswith("convex hull (mesh/hull volume 1.0")
    assert 0.93 < volume_of(*found.pieces[0]) / (4 / 3 * np.pi * 0.03**3) < 1.0
    assert len(decompose(channel(), "hull").pieces) == 1


def test_without_coacd_there_is_one_hull_and_a_warning(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setitem(sys.modules, "coacd", None)
    with caplog.at_level(logging.WARNING):
        found = decompose(channel())
    assert volume_of(*found.pieces[0]) == pytest.approx(0.04 * 0.03 * 0.03, rel=1e-6)
    assert len(found.pieces) == 1 and "pip install 'megrasp-core[objects]'" in caplog.text
    with pytest.raises(InvalidRequestError, match=r"pip install 'megrasp-core\[objects\]'"):
        decompose(channel(), "coacd")


def test_flat_meshes_and_unknown_methods_are_told() -> None:
    square = np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]], float)
    for faces in (np.array([[0, 1, 2], [0, 2, 3]]), np.zeros((0, 3), np.int64)):
        with pytest.raises(ObjectError, match=f"flat: its {len(faces)} triangles .* a volume"):
            decompose(Mesh(square, faces))
    with pytest.raises(InvalidRequestError, match="'planes'; expected one of auto, coacd, hull"):
        decompose(channel(), "planes")  # type: ignore[arg-type]
