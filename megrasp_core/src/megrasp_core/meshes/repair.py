"""Meshes as they come made closed and outward: what mass, rays and convex pieces need."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components

from .mesh import Mesh, joined

MERGE = 1e-6
"""Vertices this near, as a share of the mesh's diagonal, are one."""
LOOSE = 0.02
"""Parts that hang on nothing and have a smaller share of the area are dropped."""
SMALL_HOLE = 0.25
"""Holes up to this share of the mesh's diagonal across are closed."""
FLAT_HOLE = 0.02
"""Larger ones only where their rim is flat to this share: the side a scanned object stood on."""
INSIDE_SAMPLE = 32
"""Vertices of a part that are looked for in another."""

Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Repair:
    """A mesh and what was done to it.

    Attributes:
        mesh: faces outward; cavities inward.
        closed: whether it bounds a volume.
        done: in words, in order; empty where nothing was.
        open_holes: diameters (m) of the holes that are left.
    """

    mesh: Mesh
    closed: bool
    done: tuple[str, ...]
    open_holes: tuple[float, ...] = ()


def repaired(mesh: Mesh) -> Repair:
    """Merge equal vertices, drop what is double, degenerate or loose, turn faces outward and close
    holes.

    Holes are closed up to SMALL_HOLE of the diagonal, larger ones where their rim is flat. A part
    inside another is a cavity where it is wound the other way, otherwise it is dropped. The result
    may have no face.
    """
    done: list[str] = []
    mesh = _merged(mesh, done)
    if len(mesh.faces) == 0:
        return Repair(mesh, False, tuple(done))
    parts = [_part(mesh, faces) for faces in _without_loose(mesh, done)]
    turned = sum(part.turned for part in parts)
    if turned:
        done.append(f"{_counted(turned, 'face')} turned")
    diagonal = _diagonal(mesh.vertices)
    closed_parts, left = [], []
    filled: list[float] = []
    for part in parts:
        whole, closed_holes, open_holes = _filled(part.mesh, diagonal)
        closed_parts.append(part._with(whole))
        filled += closed_holes
        left += open_holes
    if filled:
        widest = 1000.0 * max(filled)
        width = f"the widest {widest:.0f} mm" if len(filled) > 1 else f"{widest:.0f} mm wide"
        done.append(f"{_counted(len(filled), 'hole')} closed, {width}")
    meshes = _nested(closed_parts, done) if not left else [part.mesh for part in closed_parts]
    whole = _compact(joined(meshes))
    return Repair(whole, not left and is_closed(whole), tuple(done), tuple(sorted(left)))


def is_closed(mesh: Mesh) -> bool:
    """Whether every edge is run through as often in one direction as in the other, so that the
    mesh bounds a volume.
    """
    return len(mesh.faces) > 0 and len(_unmatched(mesh.faces)) == 0


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def _diagonal(vertices: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(np.ptp(vertices, axis=0)))


def _compact(mesh: Mesh) -> Mesh:
    """Without vertices that no face uses."""
    used, index = np.unique(mesh.faces, return_inverse=True)
    return Mesh(mesh.vertices[used], index.reshape(-1, 3).astype(np.int64))


def _merged(mesh: Mesh, done: list[str]) -> Mesh:
    """One vertex for equal ones; no face with a corner that is not finite, twice the same corner
    or the corners of another.
    """
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    faces = np.asarray(mesh.faces, dtype=np.int64)
    whole = np.isfinite(vertices[faces]).all(axis=(1, 2))
    if not whole.all():
        count = int((~whole).sum())
        done.append(f"{_counted(count, 'face')} with a corner that is not finite dropped")
        faces = faces[whole]
    if len(faces) == 0:
        return Mesh(np.zeros((0, 3)), faces.reshape(0, 3))
    vertices, faces = _compact(Mesh(vertices, faces))
    grid = max(MERGE * _diagonal(vertices), np.finfo(np.float64).tiny)
    keys = np.round((vertices - vertices.min(axis=0)) / grid).astype(np.int64)
    _, first, index = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    if len(first) < len(vertices):
        done.append(f"{len(vertices) - len(first)} equal vertices merged")
    vertices, faces = vertices[first], index.reshape(-1)[faces]
    a, b, c = faces.T
    proper = (a != b) & (b != c) & (c != a)
    _, kept = np.unique(np.sort(faces[proper], axis=1), axis=0, return_index=True)
    dropped = len(faces) - len(kept)
    if dropped:
        done.append(f"{_counted(dropped, 'degenerate or double face')} dropped")
    return Mesh(vertices, faces[proper][np.sort(kept)])


def _edges(faces: NDArray[np.integer]) -> tuple[Indices, Indices]:
    """Directed edges (3 F, 2) and the face of each."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return edges.astype(np.int64), np.tile(np.arange(len(faces)), 3)


def _without_loose(mesh: Mesh, done: list[str]) -> list[NDArray[np.integer]]:
    """The faces of each connected part that is not loose."""
    edges, _ = _edges(mesh.faces)
    count = len(mesh.vertices)
    graph = coo_matrix((np.ones(len(edges), bool), edges.T), shape=(count, count))
    part = connected_components(graph, directed=False)[1][mesh.faces[:, 0]]
    area = np.bincount(part, np.linalg.norm(mesh.crosses(), axis=1))
    present = np.unique(part)
    kept = [k for k in present if area[k] >= LOOSE * area.sum()]
    if len(kept) < len(present):
        done.append(f"{_counted(len(present) - len(kept), 'loose part')} dropped")
    return [mesh.faces[part == k] for k in kept]


@dataclass(frozen=True, eq=False)
class _Part:
    """A connected part, its faces outward; how many were turned for it, and whether its faces
    were mostly inward before.
    """

    mesh: Mesh
    turned: int
    was_inward: bool

    def _with(self, mesh: Mesh) -> _Part:
        return _Part(mesh, self.turned, self.was_inward)


def _part(mesh: Mesh, faces: NDArray[np.integer]) -> _Part:
    flip = _flips(faces)
    one_way = np.where(flip[:, None], faces[:, ::-1], faces)
    vertices = mesh.vertices - mesh.vertices[np.unique(faces)].mean(axis=0)
    a, b, c = (vertices[one_way[:, k]] for k in range(3))
    if np.einsum("ij,ij->", a, np.cross(b, c)) < 0.0:
        one_way, flip = one_way[:, ::-1], ~flip
    inward = bool(2 * flip.sum() > len(flip))
    # A part that is inward as a whole may be a cavity: whether it was turned is decided later.
    turned = int(min(flip.sum(), (~flip).sum()))
    return _Part(_compact(Mesh(mesh.vertices, one_way)), turned, inward)


def _flips(faces: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Which faces of a connected part to turn so that neighbours are wound alike."""
    edges, owner = _edges(faces)
    low, high = edges.min(axis=1), edges.max(axis=1)
    order = np.lexsort((high, low))
    low, high, owner = low[order], high[order], owner[order]
    forward = (edges[:, 0] < edges[:, 1])[order]
    key = np.flatnonzero(np.r_[True, (np.diff(low) != 0) | (np.diff(high) != 0)])
    pairs = key[np.diff(np.r_[key, len(low)]) == 2]
    one, other = owner[pairs], owner[pairs + 1]
    differ = forward[pairs] == forward[pairs + 1]
    flip = np.zeros(len(faces), bool)
    if not differ.any():
        return flip
    graph = coo_matrix((np.where(differ, 2, 1), (one, other)), shape=(len(faces),) * 2).tocsr()
    # A pair that shares two edges would be summed.
    graph.data = np.where(graph.data % 2 == 0, 2, 1)
    graph = graph.maximum(graph.T).tocsr()
    seen = np.zeros(len(faces), bool)
    while not seen.all():
        start = int(np.argmin(seen))
        found, before = breadth_first_order(graph, start, directed=False)
        seen[found] = True
        if len(found) == 1:
            continue
        parents = before[found[1:]]
        unlike = np.asarray(graph[found[1:], parents]).ravel() == 2
        for face, parent, turn in zip(found[1:].tolist(), parents.tolist(), unlike.tolist()):
            flip[face] = flip[parent] ^ turn
        # Fewer turned faces, so that the rest says how the part was wound.
        if 2 * flip[found].sum() > len(found):
            flip[found] = ~flip[found]
    return flip


def _unmatched(faces: NDArray[np.integer]) -> Indices:
    """Directed edges (K, 2) that run once more in their direction than in the other."""
    edges, _ = _edges(faces)
    low, high = edges.min(axis=1), edges.max(axis=1)
    pairs, index = np.unique(np.stack([low, high], axis=1), axis=0, return_inverse=True)
    sense = np.where(edges[:, 0] < edges[:, 1], 1, -1)
    surplus = np.bincount(index.reshape(-1), sense).astype(np.int64)
    forward = np.repeat(pairs, np.maximum(surplus, 0), axis=0)
    backward = np.repeat(pairs[:, ::-1], np.maximum(-surplus, 0), axis=0)
    return np.concatenate([forward, backward])


def _loops(edges: Indices) -> list[list[int]]:
    """Closed walks through all the directed edges, no vertex twice in one.

    As many edges lead to a vertex as away from it, so that a walk ends where it began.
    """
    onward: dict[int, list[int]] = {}
    for start, end in edges.tolist():
        onward.setdefault(start, []).append(end)
    loops = []
    for first in list(onward):
        while onward[first]:
            walk, place = [first], {first: 0}
            while walk:
                following = onward[walk[-1]]
                if not following:
                    break
                vertex = following.pop()
                if vertex in place:
                    at = place[vertex]
                    loops.append(walk[at:])
                    for gone in walk[at + 1 :]:
                        del place[gone]
                    walk = walk[: at + 1]
                    if at == 0:
                        break
                else:
                    place[vertex] = len(walk)
                    walk.append(vertex)
    return [loop for loop in loops if len(loop) > 2]


def _filled(mesh: Mesh, diagonal: float) -> tuple[Mesh, list[float], list[float]]:
    """The mesh with its holes closed that may be, and the diameters of these and of the rest."""
    vertices, faces = [mesh.vertices], [np.asarray(mesh.faces, np.int64)]
    count = len(mesh.vertices)
    closed, left = [], []
    for loop in _loops(_unmatched(mesh.faces)):
        rim = mesh.vertices[loop]
        width = _diagonal(rim)
        thickness = float(np.ptp((rim - rim.mean(axis=0)) @ _thin_direction(rim)))
        if width > SMALL_HOLE * diagonal and thickness > FLAT_HOLE * diagonal:
            left.append(width)
            continue
        closed.append(width)
        ring, following = np.array(loop), np.roll(loop, -1)
        if len(loop) == 3:
            faces.append(ring[None, ::-1])
            continue
        vertices.append(rim.mean(axis=0, keepdims=True))
        faces.append(np.stack([following, ring, np.full(len(loop), count)], axis=1))
        count += 1
    return Mesh(np.concatenate(vertices), np.concatenate(faces)), closed, left


def _thin_direction(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][-1]


def _nested(parts: list[_Part], done: list[str]) -> list[Mesh]:
    """The parts' meshes: cavities inward, without parts inside others."""
    if len(parts) == 1:
        if parts[0].was_inward:
            done.append("the whole mesh turned outward")
        return [parts[0].mesh]
    meshes, overlapping, inner, turned = [], 0, 0, 0
    for i, part in enumerate(parts):
        step = max(1, len(part.mesh.vertices) // INSIDE_SAMPLE)
        sample = part.mesh.vertices[::step]
        holders = []
        for j, other in enumerate(parts):
            if j == i:
                continue
            share = float((winding_number(other.mesh, sample) > 0.5).mean())
            if share == 1.0:
                holders.append(other)
            elif share > 0.0:
                overlapping += 1
        if not holders:
            meshes.append(part.mesh)
            turned += part.was_inward
        elif len(holders) % 2 and part.was_inward != holders[0].was_inward:
            meshes.append(Mesh(part.mesh.vertices, part.mesh.faces[:, ::-1]))
        else:
            inner += 1
    if turned:
        done.append(f"{_counted(turned, 'part')} turned outward")
    if inner:
        done.append(f"{_counted(inner, 'part')} inside another dropped")
    if overlapping:
        done.append("parts overlap: their common volume counts twice")
    return meshes


def winding_number(mesh: Mesh, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """How often the mesh winds around each of points (N, 3): 1 inside a closed outward mesh, 0
    outside, in between near holes.
    """
    total = np.zeros(len(points))
    corners = mesh.vertices[mesh.faces]
    for index, point in enumerate(points):
        a, b, c = (corners[:, k] - point for k in range(3))
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        over = np.einsum("ij,ij->i", a, np.cross(b, c))
        under = la * lb * lc
        under += np.einsum("ij,ij->i", a, b) * lc
        under += np.einsum("ij,ij->i", b, c) * la
        under += np.einsum("ij,ij->i", c, a) * lb
        total[index] = np.arctan2(over, under).sum() / (2.0 * np.pi)
    return total
