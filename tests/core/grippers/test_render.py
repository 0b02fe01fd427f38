"""The renderer on shapes whose outer surface is known, sound and damaged, and on the grippers."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
import trimesh
from gripper_cases import OWN_JAWS
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from megrasp_core.grippers import Gripper, load_gripper, render, render_cloud
from megrasp_core.grippers.render import visible
from megrasp_core.meshes import Mesh, SurfaceSample, sample_stratified

RADIUS = 0.05
EXTENTS = np.array([0.10, 0.06, 0.04])
COUNT = 256


def arrays(mesh: trimesh.Trimesh) -> Mesh:
    """Vertices and faces of a mesh."""
    return Mesh(np.array(mesh.vertices), np.array(mesh.faces, np.int64))


def sphere(radius: float = RADIUS) -> Mesh:
    """A ball around the origin, normals outwards, facets 5 degrees wide."""
    return arrays(trimesh.creation.icosphere(subdivisions=4, radius=radius))


def box(extents: NDArray[np.float64] = EXTENTS) -> Mesh:
    """A box around the origin."""
    return arrays(trimesh.creation.box(extents))


def without_lid(mesh: Mesh) -> Mesh:
    """The box without its face towards +Z."""
    vertices, faces = mesh
    return Mesh(vertices, faces[vertices[faces][:, :, 2].min(axis=1) < 0.0])


def flipped(mesh: Mesh) -> Mesh:
    """The mesh with all triangles wound the other way round."""
    return Mesh(mesh.vertices, mesh.faces[:, ::-1])


def partly_flipped(mesh: Mesh, share: float, seed: int) -> Mesh:
    """The mesh with a random share of its triangles wound the other way round."""
    turned = np.random.default_rng(seed).random(len(mesh.faces)) < share
    return Mesh(mesh.vertices, np.where(turned[:, None], mesh.faces[:, ::-1], mesh.faces))


def outward_on_box(sample: SurfaceSample, extents: NDArray[np.float64]) -> NDArray[np.float64]:
    """Component of the normals along the outward normal of the face that each point lies on."""
    scaled = sample.points / (extents / 2.0)
    rows, axis = np.arange(len(scaled)), np.abs(scaled).argmax(axis=1)
    np.testing.assert_allclose(np.abs(scaled[rows, axis]), 1.0, atol=1e-9)
    return np.sign(scaled[rows, axis]) * sample.normals[rows, axis]


@settings(max_examples=30, deadline=None)
@given(
    share=st.sampled_from([0.0, 0.3, 0.5, 1.0]),
    holes=st.sampled_from([0.0, 0.05]),
    opening=st.sampled_from([1.0, 0.6, 0.0]),
    doubled=st.booleans(),
    degenerate=st.booleans(),
    seed=st.integers(0, 2**16),
)
def test_damaged_ball(
    share: float, holes: float, opening: float, doubled: bool, degenerate: bool, seed: int
) -> None:
    """Wrong windings, missing triangles, a missing cap, triangles twice with both windings and
    triangles without area change neither the surface nor the normals.
    """
    vertices, faces = partly_flipped(sphere(), share, seed)
    kept = np.random.default_rng(seed + 1).random(len(faces)) >= holes
    faces = faces[kept & (vertices[faces].mean(axis=1)[:, 2] < opening * RADIUS)]
    if doubled:
        faces = np.concatenate([faces, faces[:, ::-1]])
    if degenerate:
        empty = np.repeat(faces[:9, :1], 3, axis=1)
        line = np.stack([faces[:9, 0], faces[:9, 1], faces[:9, 0]], axis=1)
        faces = np.concatenate([empty, faces, line, empty])
    sample = render_cloud([Mesh(vertices, faces)], COUNT, seed)
    assert sample.points.shape == sample.normals.shape == (COUNT, 3)
    np.testing.assert_allclose(np.linalg.norm(sample.normals, axis=1), 1.0, atol=1e-9)
    distance = np.linalg.norm(sample.points, axis=1)
    assert (np.abs(distance - RADIUS) < 1e-3 * RADIUS + 5e-5).all()
    outward = (sample.points * sample.normals).sum(axis=1) / distance
    # Where half of a ball is missing, the rim is seen from both sides alike.
    rim = (opening == 0.0) & (sample.points[:, 2] > -0.1 * RADIUS)
    assert (outward[~rim] > 0.99).all()


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_box_without_lid(share: float) -> None:
    """Five faces, seen from outside although the inner sides can be seen as well."""
    sample = render_cloud([partly_flipped(without_lid(box()), share, 3)], COUNT, 0)
    assert (outward_on_box(sample, EXTENTS) > 0.99).all()
    assert not ((sample.points[:, 2] > EXTENTS[2] / 2.0 - 1e-9) & (sample.normals[:, 2] > 0)).any()


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_inner_walls_count_where_a_ray_reaches_them(share: float) -> None:
    """The cavity of a walled box is outside as long as the lid is off, inside when it is on."""
    inner = EXTENTS - 0.004
    walls = partly_flipped(without_lid(box()), share, 3)
    lining = partly_flipped(flipped(without_lid(box(inner))), share, 4)
    lid = arrays(trimesh.creation.box((0.12, 0.08, 0.004)))
    lid[0][:, 2] += EXTENTS[2] / 2.0 + 0.002

    for meshes, open_ in (([walls, lining], True), ([walls, lining, lid], False)):
        sample = render_cloud(meshes, COUNT, 0)
        inside = sample.mesh == 1
        assert inside.any() == open_
        lined = SurfaceSample(sample.points[inside], sample.normals[inside], sample.mesh[inside])
        if open_:
            assert (outward_on_box(lined, inner) < -0.99).all()


def test_sheet() -> None:
    """A surface without thickness is seen, its normals stay as they are wound."""
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]], np.float64)
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    for wound, up in ((faces, 1.0), (faces[:, ::-1], -1.0)):
        sheet = Mesh(corners, wound)
        np.testing.assert_array_equal(render_cloud([sheet], COUNT, 0).normals[:, 2], up)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_parts_inside_others_are_hidden(share: float) -> None:
    """A ball in a box is not there, the part of a ball that sticks out of it is."""
    case = partly_flipped(box(), share, 1)
    ball = partly_flipped(sphere(0.015), share, 2)
    hidden = render_cloud([case, ball], COUNT, 0)
    assert (hidden.mesh == 0).all()
    assert (outward_on_box(hidden, EXTENTS) > 0.99).all()
    shifted = Mesh(ball.vertices + np.array([0.0, 0.0, EXTENTS[2] / 2.0]), ball.faces)
    half = render_cloud([case, shifted], 4 * COUNT, 0)
    dome = half.points[half.mesh == 1]
    assert len(dome) > 50
    assert (dome[:, 2] > EXTENTS[2] / 2.0 - 1e-3).all()


def test_what_cannot_be_rendered(monkeypatch: pytest.MonkeyPatch) -> None:
    """Meshes without a surface say so, and so does one that nobody can see."""
    corners = np.zeros((3, 3))
    for vertices in (corners, np.full((3, 3), np.nan)):
        with pytest.raises(ValueError, match=r"1 triangles of (0\.0|nan) m2"):
            render_cloud([Mesh(vertices, np.array([[0, 1, 2]]))], 16, 0)
    with pytest.raises(ValueError, match="0 triangles"):
        render_cloud([], 16, 0)
    monkeypatch.setattr(render, "HOPELESS", 20)
    buried = [Mesh(0.9 * box().vertices, box().faces)] * 60
    with pytest.raises(ValueError, match="can be seen from outside and 64 are needed"):
        render_cloud([box(), *buried], 64, 0)


def test_much_that_is_hidden_takes_longer_only() -> None:
    """A box full of boxes: points enough, all on the outer one."""
    buried = [Mesh(0.9 * box().vertices, box().faces)] * 60
    sample = render_cloud([box(), *buried], 128, 0)
    assert len(np.unique(sample.points, axis=0)) == 128
    assert (sample.mesh == 0).all()


SCRIPT = """
from megrasp_core.grippers import load_gripper
clouds = load_gripper("franka_hand").clouds(300, seed=4)
print(b"".join(array.tobytes() for array in vars(clouds).values()).hex())
"""


@pytest.mark.slow
@pytest.mark.usefixtures("no_cache")
def test_every_process_renders_the_same() -> None:
    """Bit for bit."""
    there = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, check=True).stdout
    clouds = load_gripper("franka_hand").clouds(300, seed=4)
    here = b"".join(array.tobytes() for array in vars(clouds).values())
    assert bytes.fromhex(there.decode()) == here


@pytest.fixture(scope="module", params=OWN_JAWS)
def gripper(request: pytest.FixtureRequest) -> Gripper:
    """Every shipped jaw in turn."""
    return load_gripper(request.param)


@pytest.mark.usefixtures("no_cache")
def test_clouds_of_a_seed(gripper: Gripper) -> None:
    """The same for the same seed, others for another."""
    clouds = gripper.clouds(512, seed=3)
    fresh = load_gripper(gripper.name).clouds(512, seed=3)
    for name, array in vars(clouds).items():
        np.testing.assert_array_equal(array, getattr(fresh, name))
    assert not np.array_equal(clouds.open_points, gripper.clouds(512, seed=4).open_points)


def test_normals_point_outwards(gripper: Gripper) -> None:
    """From a point a step along its normal, at least one direction leads out without a hit."""
    clouds = gripper.clouds(256)
    index = np.zeros(256, np.int64)
    stepped = clouds.open_points + 2e-4 * clouds.open_normals
    seen = visible(gripper.meshes("open"), SurfaceSample(stepped, clouds.open_normals, index))
    assert len(seen.points) >= 250
    buried = clouds.open_points - 5e-4 * clouds.open_normals
    hidden = visible(gripper.meshes("open"), SurfaceSample(buried, clouds.open_normals, index))
    assert len(hidden.points) < 10


@pytest.mark.parametrize("posture", ["open", "closed"])
def test_inverted_gripper_looks_the_same(gripper: Gripper, posture: str) -> None:
    """A model exported inside out: the same points are seen, their normals point outwards.

    Next to edges the two sides of a surface cannot always be told apart.
    """
    meshes = gripper.meshes(posture)
    drawn = sample_stratified(meshes, 2000, 0)
    right = visible(meshes, drawn)
    inverted = SurfaceSample(drawn.points, -drawn.normals, drawn.mesh)
    turned = visible([flipped(mesh) for mesh in meshes], inverted)
    np.testing.assert_array_equal(turned.points, right.points)
    assert ((turned.normals * right.normals).sum(axis=1) > 0.99).mean() > 0.99
