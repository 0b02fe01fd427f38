"""Convex pieces of a mesh: one hull where that is nearly the shape, otherwise those of CoACD."""

from __future__ import annotations

import importlib
import logging
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from scipy.spatial import QhullError

from megrasp_core.errors import InvalidRequestError, ObjectError
from megrasp_core.meshes import Mesh, repaired, simplified

from .model import ConvexPiece, FloatArray
from .solids import convex_piece, volume_of

_log = logging.getLogger(__name__)

Method = Literal["auto", "coacd", "hull"]

HULL_SHARE = 0.92
"""A mesh that fills so much of its hull is its hull."""
FACES, HULL_FACES = 900, 320
"""Triangles of the mesh that is decomposed, and of a hull that stands for the whole mesh."""
COACD = {"threshold": 0.06, "max_convex_hull": 24, "max_ch_vertex": 48, "seed": 0}
"""Concavity that is left, most pieces, most vertices of one; CoACD's other values are its own."""
FLAT = 1e-9
"""A hull with a smaller share of the volume of the cube around it has none."""
INSTALL = "Run `pip install 'megrasp-core[objects]'`"


@dataclass(frozen=True, eq=False)
class Decomposition:
    """Convex pieces, and in words how they were made."""

    pieces: tuple[ConvexPiece, ...]
    method: str


def available_method(method: Method) -> Method:
    """Return "coacd" or "hull" for "auto", with a warning where it is "hull", and others as given.

    Raises InvalidRequestError for an unknown method, and for "coacd" where it is not installed.
    """
    if method not in get_args(Method):
        raise InvalidRequestError(
            f"unknown decomposition {method!r}; expected one of {', '.join(get_args(Method))}."
        )
    if method == "hull":
        return "hull"
    try:
        importlib.import_module("coacd")
        return "coacd"
    except ImportError as error:
        if method == "coacd":
            raise InvalidRequestError(
                "the decomposition 'coacd' was given, but the package coacd is not installed; "
                f"expected an installed coacd. {INSTALL}, or give 'hull'."
            ) from error
    _log.warning(
        "the package coacd is not installed: every object becomes one convex hull, without "
        "hollows. %s to get convex pieces.",
        INSTALL,
    )
    return "hull"


def decompose(mesh: Mesh, method: Method = "auto") -> Decomposition:
    """Return convex pieces that cover a mesh.

    Args:
        mesh: outward, as `repaired` returns it.
        method: "coacd" (at most 24 pieces of 48 vertices), "hull" (one of at most 320 faces), or
            "auto": coacd where it is installed, otherwise hull. A mesh that fills 92 % of its hull
            becomes the hull with each of them.

    Raises:
        InvalidRequestError: unknown method, or "coacd" where it is not installed.
        ObjectError: the mesh is flat.
    """
    method = available_method(method)
    whole = _hull(mesh.vertices) if len(mesh.faces) else None
    if whole is None:
        raise ObjectError(
            f"the mesh is flat: its {len(mesh.faces)} triangles enclose nothing; expected a body "
            "with a volume. Remove it, or give it a thickness."
        )
    # About the middle: the figure of a mesh that is still open depends on the origin.
    about = mesh.vertices - mesh.vertices.mean(axis=0)
    filled = volume_of(about, np.asarray(mesh.faces, np.int32)) / volume_of(*whole)
    if method == "coacd" and filled < HULL_SHARE:
        return _by_coacd(mesh)
    light = simplified(Mesh(*whole), HULL_FACES)
    return Decomposition(
        (convex_piece(light.vertices),), f"convex hull (mesh/hull volume {filled:.3f})"
    )


def _by_coacd(mesh: Mesh) -> Decomposition:
    light = repaired(simplified(mesh, FACES))
    given = light.mesh if light.closed else mesh
    coacd: Any = importlib.import_module("coacd")
    coacd.set_log_level("off")
    # One thread, as workers are processes; the number is that of the calling thread.
    threads = coacd._lib.omp_get_max_threads()
    coacd._lib.omp_set_num_threads(1)
    try:
        parts = coacd.run_coacd(coacd.Mesh(given.vertices, given.faces), decimate=True, **COACD)
    finally:
        coacd._lib.omp_set_num_threads(threads)
    hulls = [_hull(np.asarray(vertices, dtype=np.float64)) for vertices, _ in parts]
    pieces = tuple(hull for hull in hulls if hull is not None)
    if not pieces:
        raise ObjectError(
            "coacd found no convex piece in the mesh; expected at least one. Give the "
            "decomposition 'hull'."
        )
    return Decomposition(pieces, " ".join(["coacd", *(f"{k} {v}" for k, v in COACD.items())]))


def _hull(points: FloatArray) -> ConvexPiece | None:
    """The hull of points (N, 3); None where they lie in a plane."""
    if len(points) < 4:
        return None
    try:
        hull = convex_piece(points)
    except QhullError:
        return None
    flat = volume_of(*hull) <= FLAT * float(np.ptp(points, axis=0).max()) ** 3
    return None if flat else hull
