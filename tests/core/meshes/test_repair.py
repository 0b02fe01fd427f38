"""Meshes as they come: doubled, turned, torn, nested; closed and outward afterwards."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from megrasp_core.meshes import Mesh, joined, repaired, simplified


def mesh_of(found: trimesh.Trimesh) -> Mesh:
    return Mesh(np.array(found.vertices), np.array(found.faces, np.int64))


def box() -> Mesh:
    return mesh_of(trimesh.creation.box((0.06, 0.05, 0.04)))


def ball(radius: float = 0.03, x: float = 0.0, subdivisions: int = 3) -> Mesh:
    mesh = mesh_of(trimesh.creation.icosphere(subdivisions, radius))
    return Mesh(mesh.vertices + np.array([x, 0.0, 0.0]), mesh.faces)


def turned(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, mesh.faces[:, ::-1])


def volume(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def test_a_good_mesh_is_left_as_it_is() -> None:
    repair = repaired(ball())
    assert repair.done == () and repair.closed and len(repair.mesh.faces) == len(ball().faces)
    assert volume(repair.mesh) == pytest.approx(volume(ball()), rel=1e-9)


def test_triangles_that_share_no_vertex_become_a_surface() -> None:
    mesh = box()
    repair = repaired(Mesh(mesh.vertices[mesh.faces].reshape(-1, 3), np.arange(36).reshape(-1, 3)))
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
    repair = repaired(Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]])))
    assert len(repair.mesh.faces) == 0 and not repair.closed


@pytest.mark.parametrize("which", [slice(3, 5), slice(0, 40), slice(None)])
def test_faces_are_turned_outward(which: slice) -> None:
    mesh = ball()
    faces = mesh.faces.copy()
    faces[which] = faces[which][:, ::-1]
    repair = repaired(Mesh(mesh.vertices, faces))
    assert repair.closed and volume(repair.mesh) == pytest.approx(volume(mesh), rel=1e-9)
    assert repair.done == (f"{len(faces[which])} faces turned",)


def test_holes_are_closed_and_their_share_told() -> None:
    mesh = ball()
    repair = repaired(Mesh(mesh.vertices, mesh.faces[7:]))
    assert repair.closed and volume(repair.mesh) == pytest.approx(volume(mesh), rel=0.01)
    # As a scan without the side that the object stood on.
    can = trimesh.creation.cylinder(0.03, 0.08)
    bottom = (can.vertices[can.faces][:, :, 2] < -0.0399).all(axis=1)
    repair = repaired(Mesh(np.array(can.vertices), can.faces[~bottom]))
    assert repair.closed and volume(repair.mesh) == pytest.approx(can.volume, rel=1e-6)
    assert repair.done == ("holes closed, 14 % of the surface",)


def test_loose_scraps_are_dropped_and_parts_kept() -> None:
    repair = repaired(joined([ball(), ball(0.002, 0.05, 1), ball(0.02, 0.2)]))
    assert repair.done == ("1 loose part dropped",)
    assert volume(repair.mesh) == pytest.approx(volume(ball()) + volume(ball(0.02)), rel=1e-9)
    # Many equal parts have a small share of the area each.
    beads = repaired(joined([ball(0.004, 0.01 * i, 1) for i in range(60)]))
    assert beads.done == () and volume(beads.mesh) == pytest.approx(60 * volume(ball(0.004, 0, 1)))


def test_a_part_inside_is_a_cavity_where_it_is_wound_the_other_way() -> None:
    outer, inner, core = (ball(radius) for radius in (0.03, 0.02, 0.01))
    hollow = volume(outer) - volume(inner)
    nested = joined([outer, turned(inner)])
    for mesh, expected in (
        (nested, hollow),
        (turned(nested), hollow),
        (joined([nested, core]), hollow + volume(core)),
        (joined([outer, inner]), volume(outer) + volume(inner)),
        (joined([outer, ball(0.02, 0.1), turned(ball(0.02, 0.2))]), hollow + 3 * volume(inner)),
    ):
        repair = repaired(mesh)
        assert repair.closed and volume(repair.mesh) == pytest.approx(expected, rel=1e-9)


def test_fewer_faces() -> None:
    mesh = ball(subdivisions=4)
    fewer = simplified(mesh, 400)
    assert len(fewer.faces) <= 400 and simplified(fewer, 400) is fewer
    assert volume(fewer) == pytest.approx(volume(mesh), rel=0.06)
    np.testing.assert_allclose(np.ptp(fewer.vertices, axis=0), 0.06, atol=0.002)
