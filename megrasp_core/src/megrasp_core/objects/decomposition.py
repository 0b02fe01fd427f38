"""Convex pieces of a mesh: one hull where that is nearly the shape, otherwise the pieces of CoACD
or hulls of what planes cut the mesh into.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from megrasp_core.errors import InvalidRequestError, ObjectError
from megrasp_core.meshes import Mesh, is_closed, repaired, simplified

from .cutting import Cut, cut, halves_of_vertices
from .model import ConvexPiece
from .solids import convex_piece, volume_of

Method = Literal["auto", "coacd", "planes", "hull"]

HULL_SHARE = 0.92
"""A mesh that fills so much of its hull is its hull."""
FACES = 900
"""Triangles of the mesh that is decomposed."""
MOST_PIECES = 24
PIECE_VERTICES, HULL_VERTICES = 48, 82
THRESHOLD = 0.06
"""CoACD's concavity."""
EXCESS = 0.015
"""Cutting ends when the hulls hold so much more than the solid, as a share of it."""
PIECE_EXCESS = 0.001
"""A piece is not cut when its hull holds no more than this beyond it, as a share of the solid."""
ROUNDS = 3
"""Of cutting and merging."""
MERGE = 0.002
"""Two pieces become one when their common hull holds no more than this beyond theirs."""
POSITIONS = 7
"""Planes tried along a direction."""
FACETS = 2
"""Planes tried at flat areas across a direction."""
FACET_SHARE, FACET_STEP, ACROSS = 0.01, 0.01, 0.9998
"""Least share of the area that such a one has, how far such areas are apart as a share of the
part's length, and the cosine of how far their faces may be off.
"""
LITTLE = 0.15
"""A cut that gains less of the excess is chosen by what comes after it."""
AHEAD, COARSE = 16, 3
"""Cuts that are followed by another then, and planes tried along a direction there."""
BALANCE = 0.03
"""Weight of the difference of two halves against the volume of their hulls."""
FLAT = 1e-9
"""A hull with a smaller share of the volume of its bounding cube has none."""


@dataclass(frozen=True, eq=False)
class Decomposition:
    """Convex pieces, and in words how they were made."""

    pieces: tuple[ConvexPiece, ...]
    method: str


def has_coacd() -> bool:
    """Whether the package coacd is installed."""
    return importlib.util.find_spec("coacd") is not None


def decompose(mesh: Mesh, method: Method = "auto") -> Decomposition:
    """Return convex pieces of at most 48 vertices, or one hull of at most 82, that cover a mesh.

    Args:
        mesh: outward. Where it is not closed, "planes" gives its hull.
        method: "coacd" (the package), "planes" (cuts of our own), "hull" (one), or "auto": coacd
            where it is installed, otherwise planes. A mesh that fills 92 % of its hull becomes
            the hull with each of them.

    Raises:
        InvalidRequestError: unknown method, or "coacd" where it is not installed.
        ObjectError: the mesh is flat.
    """
    check_method(method)
    whole = _hull(mesh.vertices)
    if whole is None:
        raise ObjectError(
            f"the mesh is flat: its extents are {np.ptp(mesh.vertices, axis=0).tolist()} m; "
            "expected a body with a volume. Remove it, or give it a thickness."
        )
    closed = is_closed(mesh)
    filled = volume_of(mesh.vertices, np.asarray(mesh.faces, np.int32)) / whole.volume
    single = (_reduced(mesh.vertices, HULL_VERTICES),)
    if method == "hull":
        return Decomposition(single, "convex hull")
    if closed and filled >= HULL_SHARE:
        return Decomposition(single, f"convex hull (mesh/hull volume {filled:.3f})")
    if method == "coacd" or (method == "auto" and has_coacd()):
        return _by_coacd(_light(mesh))
    if not closed:
        return Decomposition(single, "convex hull (the mesh is not closed)")
    return _by_planes(_light(mesh))


def check_method(method: str) -> None:
    """Raise InvalidRequestError for a method that is unknown or not installed."""
    if method not in get_args(Method):
        raise InvalidRequestError(
            f"unknown decomposition {method!r}; expected one of {', '.join(get_args(Method))}."
        )
    if method == "coacd" and not has_coacd():
        raise InvalidRequestError(
            "the decomposition 'coacd' was given, but the package coacd is not installed; "
            "expected an installed coacd. Run `pip install megrasp-core[objects]`, or give "
            "'planes'."
        )


def _light(mesh: Mesh) -> Mesh:
    """The mesh with few faces, closed where it was."""
    light = simplified(mesh, FACES)
    if is_closed(light) or not is_closed(mesh):
        return light
    again = repaired(light)
    return again.mesh if again.closed else mesh


def _by_coacd(mesh: Mesh) -> Decomposition:
    coacd: Any = importlib.import_module("coacd")
    coacd.set_log_level("error")
    parts = coacd.run_coacd(
        coacd.Mesh(mesh.vertices, mesh.faces),
        threshold=THRESHOLD,
        max_convex_hull=MOST_PIECES,
        decimate=True,
        max_ch_vertex=PIECE_VERTICES,
        seed=0,
    )
    pieces = tuple(
        convex_piece(np.asarray(vertices, dtype=np.float64))
        for vertices, _ in parts
        if _hull(np.asarray(vertices, dtype=np.float64)) is not None
    )
    if not pieces:
        raise ObjectError(
            "coacd found no convex piece in the mesh; expected at least one. Give the "
            "decomposition 'planes' or 'hull'."
        )
    return Decomposition(
        pieces,
        f"coacd threshold {THRESHOLD} max_convex_hull {MOST_PIECES} max_ch_vertex "
        f"{PIECE_VERTICES}",
    )


def _by_planes(mesh: Mesh) -> Decomposition:
    """Cut the part whose hull holds most beyond it, again and again, and merge what the plane
    separated in vain; the pieces that merging saves go into further cuts.
    """
    solid = volume_of(mesh.vertices, np.asarray(mesh.faces, np.int32))
    first = _Part.of(Cut.of(mesh))
    assert first is not None
    parts, finished = [first], []
    budget = MOST_PIECES
    hulls: list[NDArray[np.float64]] = []
    for _ in range(ROUNDS):
        while parts and len(parts) + len(finished) < budget:
            worst = max(parts, key=lambda part: part.excess)
            total = sum(part.excess for part in [*parts, *finished])
            if total <= EXCESS * solid or worst.excess <= PIECE_EXCESS * solid:
                break
            parts.remove(worst)
            halves = _best_halves(worst)
            if halves is None:
                finished.append(worst)
            else:
                parts += halves
        count = len(parts) + len(finished)
        hulls = _merged([part.points for part in [*parts, *finished]], MERGE * solid)
        saved = count - len(hulls)
        if count < budget or saved == 0:
            break
        budget = MOST_PIECES + saved
    pieces = tuple(_reduced(points, PIECE_VERTICES) for points in hulls)
    return Decomposition(
        pieces, f"cuts by planes, at most {MOST_PIECES} pieces, max vertices {PIECE_VERTICES}"
    )


@dataclass(frozen=True, eq=False)
class _Part:
    """What planes left of the mesh, the vertices of its hull, and what the hull holds beyond it
    (m3).
    """

    cut: Cut
    points: NDArray[np.float64]
    excess: float

    @staticmethod
    def of(piece: Cut) -> _Part | None:
        """None where it has no volume."""
        vertices = piece.vertices()
        hull = _hull(vertices)
        if hull is None:
            return None
        return _Part(piece, vertices[hull.vertices], float(hull.volume) - piece.volume())


def _best_halves(part: _Part) -> list[_Part] | None:
    """The halves whose hulls hold least; None where no plane leaves two with a volume.

    A cut through a round hollow gains nothing, but the next one does: where no cut gains much,
    the best is that whose halves gain most from a cut of their own.
    """
    tried = _candidates(part)
    if not tried:
        return None
    whole = part.excess + part.cut.volume()
    if whole - tried[0].volume < LITTLE * part.excess:
        for candidate in tried[:AHEAD]:
            halves = cut(part.cut, candidate.normal, candidate.offset)
            parts = [half for half in map(_Part.of, halves) if half is not None]
            gains = 0.0
            for half in parts:
                further = _candidates(half, COARSE)
                if further:
                    held = half.excess + half.cut.volume()
                    gains += max(0.0, held - further[0].volume)
            candidate.volume -= gains
        tried.sort(key=lambda candidate: candidate.volume)
    for candidate in tried:
        halves = [_Part.of(half) for half in cut(part.cut, candidate.normal, candidate.offset)]
        if None not in halves:
            return [half for half in halves if half is not None]
    return None


@dataclass(eq=False)
class _Candidate:
    """A plane, and what the hulls of its halves hold (m3), balance included."""

    normal: NDArray[np.float64]
    offset: float
    volume: float


def _candidates(part: _Part, positions: int = POSITIONS) -> list[_Candidate]:
    """Planes that leave two halves with a volume, those whose hulls hold least first."""
    found = []
    for direction in _directions(part):
        along = part.points @ direction
        low, high = float(along.min()), float(along.max())
        even = np.linspace(low, high, positions + 2)[1:-1]
        for offset in [*even, *_facets(part, direction, low, high)]:
            volumes = []
            for vertices in halves_of_vertices(part.cut, direction, float(offset)):
                hull = _hull(vertices)
                if hull is None:
                    break
                volumes.append(float(hull.volume))
            if len(volumes) == 2:
                balance = BALANCE * abs(volumes[0] - volumes[1])
                found.append(_Candidate(direction, float(offset), sum(volumes) + balance))
    return sorted(found, key=lambda candidate: candidate.volume)


def _facets(part: _Part, direction: NDArray[np.float64], low: float, high: float) -> list[float]:
    """Where along a direction the part's surface has its largest flat areas across it: what is
    made of slabs comes apart exactly there.
    """
    corner = part.cut.surface
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    length = np.linalg.norm(cross, axis=1)
    across = np.abs(cross @ direction) > ACROSS * length
    height = corner[across, 0] @ direction
    margin = FACET_STEP * (high - low)
    inner = (height > low + margin) & (height < high - margin)
    if not inner.any():
        return []
    step = np.round((height[inner] - low) / margin).astype(np.int64)
    area = np.bincount(step, length[across][inner])
    moment = np.bincount(step, (length[across] * height)[inner])
    largest = [k for k in np.argsort(-area)[:FACETS] if area[k] > FACET_SHARE * length.sum()]
    return [float(moment[k] / area[k]) for k in largest]


def _directions(part: _Part) -> NDArray[np.float64]:
    """The axes, and the principal ones of the part's surface where they are others: (3 to 6, 3).

    Those of a part, not of the whole, halve the sectors of what is round.
    """
    corner = part.cut.surface
    weight = np.linalg.norm(
        np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1
    )
    middle = corner.mean(axis=1)
    offset = middle - weight @ middle / weight.sum()
    principal = np.linalg.eigh((offset * weight[:, None]).T @ offset)[1].T
    new = [axis for axis in principal if np.abs(axis).max() < np.cos(np.deg2rad(8.0))]
    return np.concatenate([np.eye(3), np.array(new).reshape(-1, 3)])


def _merged(hulls: list[NDArray[np.float64]], most: float) -> list[NDArray[np.float64]]:
    """Join pairs whose common hull holds at most `most` (m3) beyond theirs, the best first."""
    volumes = [_volume(points) for points in hulls]
    gaps: dict[tuple[int, int], float] = {}
    alive = list(range(len(hulls)))

    def measure(i: int, j: int) -> None:
        together = _volume(np.concatenate([hulls[i], hulls[j]]))
        gaps[i, j] = together - volumes[i] - volumes[j]

    for i in alive:
        for j in alive[:i]:
            measure(j, i)
    while gaps:
        (i, j), gap = min(gaps.items(), key=lambda item: item[1])
        if gap > most:
            break
        points = np.concatenate([hulls[i], hulls[j]])
        hull = _hull(points)
        assert hull is not None
        hulls.append(points[hull.vertices])
        volumes.append(float(hull.volume))
        alive = [k for k in alive if k not in (i, j)]
        gaps = {pair: gap for pair, gap in gaps.items() if i not in pair and j not in pair}
        for k in alive:
            measure(k, len(hulls) - 1)
        alive.append(len(hulls) - 1)
    return [hulls[k] for k in alive]


def _volume(points: NDArray[np.float64]) -> float:
    hull = _hull(points)
    return 0.0 if hull is None else float(hull.volume)


def _hull(points: NDArray[np.float64]) -> ConvexHull | None:
    """The hull of points (N, 3); None where they lie in a plane."""
    if len(points) < 4:
        return None
    try:
        hull = ConvexHull(points)
    except QhullError:
        return None
    return hull if hull.volume > FLAT * float(np.ptp(points, axis=0).max()) ** 3 else None


def _reduced(points: NDArray[np.float64], most: int) -> ConvexPiece:
    """The hull of at most `most` of the points, added while they lie farthest outside."""
    whole = ConvexHull(points)
    corners = points[whole.vertices]
    if len(corners) <= most:
        return convex_piece(corners)
    chosen = _spread(corners)
    hull = ConvexHull(corners[chosen], incremental=True)
    while len(chosen) < most:
        outside = (corners @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)
        outside[chosen] = -np.inf
        farthest = int(np.argmax(outside))
        if outside[farthest] <= 0.0:
            break
        chosen.append(farthest)
        hull.add_points(corners[[farthest]])
    hull.close()
    return convex_piece(corners[chosen])


def _spread(points: NDArray[np.float64]) -> list[int]:
    """The farthest points along the axes and diagonals."""
    steps: Sequence[int] = (-1, 0, 1)
    directions = np.array([(x, y, z) for x in steps for y in steps for z in steps if x or y or z])
    return sorted({int(k) for k in np.argmax(directions @ points.T, axis=1)})
