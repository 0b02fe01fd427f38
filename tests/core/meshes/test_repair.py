"""Meshes as they come: doubled, turned, torn, nested; closed and outward afterwards."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from megrasp_core.meshes import Mesh, is_closed, joined, repaired, simplified, winding_number


def mesh_of(found: trimesh.Trimesh) -> Mesh:
    return Mesh(np.array(found.vertices), np.array(found.faces, np.int64))


def box(x: float = 0.06, y: float = 0.05, z: float = 0.04) -> Mesh:
    return mesh_of(trimesh.creation.box((x, y, z)))


def ball(radius: float = 0.03, subdivisions: int = 3) -> Mesh:
    return mesh_of(trimesh.creation.icosphere(subdivisions, radius))


def moved(mesh: Mesh, x: float) -> Mesh:
    return Mesh(mesh.vertices + np.array([x, 0.0, 0.0]), mesh.faces)


def turned(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, mesh.faces[:, ::-1])


def volume(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def test_a_good_mesh_is_left_as_it_is() -> None:
    mesh = ball()
    repair = repaired(mesh)
    assert repair.done == () and repair.closed
    assert volume(repair.mesh) == pytest.approx(volume(mesh), rel=1e-9)
    assert len(repair.mesh.faces) == len(mesh.faces)


def test_triangles_that_share_no_vertex_become_a_surface() -> None:
    mesh = box()
    soup = Mesh(mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(36).reshape(-1, 3))
    assert not is_closed(soup)
    repair = repaired(soup)
    assert repair.closed and len(repair.mesh.vertices) == 8
    assert repair.done == ("28 equal vertices merged",)


def test_double_degenerate_and_infinite_faces_go() -> None:
    mesh = box()
    vertices = np.concatenate([mesh.vertices, [[np.nan, 0, 0]]])
    more = [mesh.faces[0], mesh.faces[3][::-1], [0, 0, 1], [0, 1, 8]]
    repair = repaired(Mesh(vertices, np.concatenate([mesh.faces, more])))
    assert repair.closed and len(repair.mesh.faces) == 12
    assert repair.done == (
        "1 face with a corner that is not finite dropped",
        "3 degenerate or double faces dropped",
    )


@pytest.mark.parametrize("which", [slice(3, 5), slice(0, 40), slice(None)])
def test_faces_are_turned_outward(which: slice) -> None:
    mesh = ball()
    faces = mesh.faces.copy()
    faces[which] = faces[which][:, ::-1]
    repair = repaired(Mesh(mesh.vertices, faces))
    assert repair.closed and volume(repair.mesh) == pytest.approx(volume(mesh), rel=1e-9)
    assert "turned" in repair.done[0]


def test_small_holes_are_closed() -> None:
    mesh = ball()
    repair = repaired(Mesh(mesh.vertices, mesh.faces[7:]))
    assert repair.closed and volume(repair.mesh) == pytest.approx(volume(mesh), rel=0.01)
    assert "hole" in repair.done[0] and "closed" in repair.done[0]


def test_a_missing_flat_bottom_is_closed_and_an_open_shell_is_not() -> None:
    mesh = ball()
    low = mesh.vertices[:, 2]
    cylinder = mesh_of(trimesh.creation.cylinder(0.03, 0.08))
    bottom = (cylinder.vertices[cylinder.faces][:, :, 2] < -0.0399).all(axis=1)
    repair = repaired(Mesh(cylinder.vertices, cylinder.faces[~bottom]))
    assert repair.closed and volume(repair.mesh) == pytest.approx(volume(cylinder), rel=1e-6)
    # Cut along a wave: no plane closes it.
    wave = 0.2 * mesh.vertices[:, 0] + 8.0 * mesh.vertices[:, 1] ** 2
    shell = Mesh(mesh.vertices, mesh.faces[(low + wave < 0.005)[mesh.faces].all(axis=1)])
    repair = repaired(shell)
    assert not repair.closed and len(repair.open_holes) >= 1
    assert max(repair.open_holes) > 0.02


def test_loose_scraps_are_dropped_and_parts_kept() -> None:
    repair = repaired(joined([ball(), moved(ball(0.002, 1), 0.05), moved(box(), 0.2)]))
    assert repair.done == ("1 loose part dropped",)
    assert volume(repair.mesh) == pytest.approx(volume(ball()) + volume(box()), rel=1e-9)


def test_what_lies_inside_is_a_cavity_or_dropped() -> None:
    outer, inner = ball(0.03), ball(0.02)
    hollow = repaired(joined([outer, turned(inner)]))
    assert hollow.closed
    assert volume(hollow.mesh) == pytest.approx(volume(outer) - volume(inner), rel=1e-9)
    filled = repaired(joined([outer, inner]))
    assert volume(filled.mesh) == pytest.approx(volume(outer), rel=1e-9)
    assert filled.done == ("1 part inside another dropped",)
    # A container that is wound inward as a whole keeps its cavity.
    whole = repaired(turned(joined([outer, turned(inner)])))
    assert volume(whole.mesh) == pytest.approx(volume(outer) - volume(inner), rel=1e-9)


def test_overlapping_parts_are_told() -> None:
    repair = repaired(joined([ball(), moved(ball(), 0.0317)]))
    assert repair.done == ("parts overlap: their common volume counts twice",)


def test_nothing_is_left_of_a_mesh_without_area() -> None:
    repair = repaired(Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]])))
    assert len(repair.mesh.faces) == 0 and not repair.closed


def test_winding_numbers() -> None:
    points = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]])
    np.testing.assert_allclose(winding_number(ball(), points), [1.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(winding_number(turned(ball()), points), [-1.0, 0.0], atol=1e-9)


def test_fewer_faces() -> None:
    mesh = ball(subdivisions=4)
    fewer = simplified(mesh, 400)
    assert len(fewer.faces) <= 400 and simplified(fewer, 400) is fewer
    assert volume(fewer) == pytest.approx(volume(mesh), rel=0.06)
    np.testing.assert_allclose(np.ptp(fewer.vertices, axis=0), 0.06, atol=0.002)
