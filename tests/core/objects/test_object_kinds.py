"""Every procedural kind: closed, convex pieces, mass properties, sizes."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from megrasp_core.errors import InvalidRequestError
from megrasp_core.objects import (
    OBJECT_KINDS,
    OBSTACLE_KINDS,
    ObjectModel,
    mass_properties,
    procedural_object,
)
from megrasp_core.objects.solids import volume_of

SEEDS = range(8)
KINDS = [*OBJECT_KINDS, *OBSTACLE_KINDS]


def visual(model: ObjectModel) -> trimesh.Trimesh:
    return trimesh.Trimesh(model.vertices, model.faces, process=False)


def in_pieces(model: ObjectModel, points: np.ndarray) -> np.ndarray:
    inside = np.zeros(len(points), bool)
    for vertices, _ in model.pieces:
        planes = ConvexHull(vertices).equations
        inside |= (points @ planes[:, :3].T + planes[:, 3] <= 0).all(axis=1)
    return inside


def in_surface(model: ObjectModel, points: np.ndarray) -> np.ndarray:
    """Winding number of the visual mesh around points: the solid angles of its triangles."""
    a, b, c = (model.vertices[model.faces[:, i]] - points[:, None] for i in range(3))
    la, lb, lc = (np.linalg.norm(side, axis=-1) for side in (a, b, c))
    volume = np.einsum("pfi,pfi->pf", a, np.cross(b, c))
    ab, bc, ca = ((x * y).sum(axis=-1) for x, y in ((a, b), (b, c), (c, a)))
    angle = 2 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
    return angle.sum(axis=1) > 2 * np.pi


def narrowest(points: np.ndarray) -> float:
    """Return the least width (m) of the convex hull over the normals of its faces."""
    normals = ConvexHull(points).equations[:, :3]
    along = points @ normals.T
    return float((along.max(axis=0) - along.min(axis=0)).min())


@pytest.fixture(scope="module", params=KINDS)
def models(request: pytest.FixtureRequest) -> list[ObjectModel]:
    return [procedural_object(seed, request.param) for seed in SEEDS]


def test_visual_mesh_is_closed_and_light(models: list[ObjectModel]) -> None:
    for model in models:
        mesh = visual(model)
        assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0
        assert len(model.faces) <= 2000 and mesh.body_count == 1


def test_pieces_are_convex_and_closed(models: list[ObjectModel]) -> None:
    for model in models:
        for vertices, faces in model.pieces:
            piece = trimesh.Trimesh(vertices, faces, process=False)
            assert piece.is_watertight and piece.volume > 0
            above = vertices @ piece.face_normals.T - np.einsum(
                "fi,fi->f", piece.triangles[:, 0], piece.face_normals
            )
            assert above.max() < 1e-9
            assert ConvexHull(vertices).volume == pytest.approx(piece.volume, rel=1e-6)


def test_pieces_fill_the_visual_mesh(models: list[ObjectModel]) -> None:
    for model in models:
        corners = np.concatenate([vertices for vertices, _ in model.pieces])
        np.testing.assert_allclose(corners.min(axis=0), model.bounds[0], atol=1e-6)
        np.testing.assert_allclose(corners.max(axis=0), model.bounds[1], atol=1e-6)
        pieces = sum(volume_of(*piece) for piece in model.pieces)
        assert pieces == pytest.approx(visual(model).volume, rel=1e-6)
    model = models[0]
    points = np.random.default_rng(0).uniform(*model.bounds, (400, 3))
    inside = in_surface(model, points)
    assert 0.05 < inside.mean() <= 1
    np.testing.assert_array_equal(inside, in_pieces(model, points))


def test_mass_properties(models: list[ObjectModel]) -> None:
    for model in models:
        mesh = visual(model)
        assert 0.02 <= model.mass <= 1.0
        np.testing.assert_allclose(mesh.center_mass, 0, atol=1e-8)
        mesh.density = model.mass / mesh.volume
        np.testing.assert_allclose(mesh.moment_inertia, model.inertia, rtol=1e-5, atol=1e-10)
        a, b, c = np.sort(np.linalg.eigvalsh(model.inertia))
        assert a > 0 and a + b >= c * (1 - 1e-9)
        if 0.02 < model.mass < 1.0:
            assert 300 <= model.mass / mesh.volume <= 800
        assert all(0 <= value <= 1 for value in model.colour)


def test_sizes(models: list[ObjectModel]) -> None:
    for model in models:
        assert model.extents.max() <= 0.18
        width = narrowest(model.vertices)
        if model.category in OBSTACLE_KINDS:
            assert width > 0.08
        elif model.category == "bowl":
            assert model.extents.max() <= 0.135
        else:
            assert 0.008 <= width <= 0.07


@pytest.mark.parametrize("kind", KINDS)
def test_the_seed_decides(kind: str) -> None:
    first, again, other = (procedural_object(seed, kind) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.vertices, again.vertices)
    np.testing.assert_array_equal(first.inertia, again.inertia)
    assert (first.mass, first.colour, first.name) == (again.mass, again.colour, again.name)
    assert abs(first.extents - other.extents).max() > 1e-4 and first.name != other.name


def test_drawn_kinds_cover_the_registry_and_suit_jaws() -> None:
    models = [procedural_object(seed) for seed in range(150)]
    assert {model.category for model in models} == set(OBJECT_KINDS)
    widths = np.array([narrowest(model.vertices) for model in models])
    assert np.mean((widths >= 0.015) & (widths <= 0.07)) > 0.8
    obstacles = {procedural_object(seed, obstacle=True).category for seed in range(30)}
    assert obstacles == set(OBSTACLE_KINDS)


@pytest.mark.parametrize("kind", ["tube", "tape_roll", "bowl"])
def test_hollow_things_are_hollow(kind: str) -> None:
    for seed in SEEDS:
        model = procedural_object(seed, kind)
        hull = ConvexHull(model.vertices).volume
        assert visual(model).volume < 0.9 * hull
        axis = np.array([[0.0, 0.0, model.bounds[1, 2] - 1e-3]])
        assert not in_pieces(model, axis).any() and not in_surface(model, axis).any()


def test_unknown_kinds_and_seeds() -> None:
    with pytest.raises(
        InvalidRequestError, match=r"unknown object kind 'teapot'; expected one of .*bottle"
    ):
        procedural_object(0, "teapot")
    with pytest.raises(InvalidRequestError, match="seed -1 is negative"):
        procedural_object(-1)


def test_mass_properties_of_a_known_box_and_of_its_halves() -> None:
    from megrasp_core.objects import box
    from megrasp_core.objects.solids import blocks

    whole = mass_properties(box([0.1, 0.2, 0.3]).pieces)
    assert whole.volume == pytest.approx(0.006)
    np.testing.assert_allclose(whole.centre, 0, atol=1e-15)
    expected = 0.006 / 12 * np.array([0.04 + 0.09, 0.01 + 0.09, 0.01 + 0.04])
    np.testing.assert_allclose(whole.inertia, np.diag(expected), atol=1e-15)
    halves = [
        piece
        for xs in ([-0.05, 0.01], [0.01, 0.05])
        for piece in blocks(xs, [-0.1, 0.1], [-0.15, 0.15], np.ones((1, 1, 1), bool)).pieces
    ]
    parts = mass_properties(halves)
    np.testing.assert_allclose(parts.inertia, whole.inertia, atol=1e-15)
    np.testing.assert_allclose(parts.centre, 0, atol=1e-15)
