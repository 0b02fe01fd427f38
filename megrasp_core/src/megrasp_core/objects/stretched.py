"""Scans stretched and mirrored: shapes of real things that nobody scanned."""

from __future__ import annotations

import dataclasses
import re

import numpy as np

from .model import ConvexPiece, FloatArray, ObjectModel

SIZE_SPREAD = 0.2
"""Spread of the logarithm of the factor that all axes share."""
AXIS_SPREAD = 0.15
"""And of that which each axis has beside it."""
LIMITS = (0.6, 1.6)
"""Of every factor."""
MASS = (0.02, 1.5)

_NAME = re.compile(r"stretched/(\d+)/(.+)")


def stretched_name(source: str, number: int) -> str:
    """Name of a stretched copy of an object."""
    return f"stretched/{number:06d}/{source}"


def stretched_from(name: str) -> tuple[int, str] | None:
    """Number and source of a stretched copy; None for the name of anything else."""
    match = _NAME.fullmatch(name)
    return None if match is None else (int(match[1]), match[2])


def source_of(name: str) -> str:
    """The object that a name is a stretched copy of, or the name itself."""
    found = stretched_from(name)
    return name if found is None else found[1]


def stretched(model: ObjectModel, number: int) -> ObjectModel:
    """An object with each axis of its frame scaled, every other copy mirrored as well; the same
    number gives the same factors.

    The density stays, but the mass is kept within 0.02 to 1.5 kg. What is convex stays convex, the
    centre of mass stays at the origin, and the second moment S of the mass, from which inertia is
    tr(S) 1 - S, becomes A S A times the ratio of masses.
    """
    rng = np.random.default_rng([number, 7])
    factors = np.exp(SIZE_SPREAD * rng.standard_normal() + AXIS_SPREAD * rng.standard_normal(3))
    factors = factors.clip(*LIMITS)
    mirrored = bool(rng.random() < 0.5)
    if mirrored:
        factors[0] *= -1
    order = [0, 2, 1] if mirrored else [0, 1, 2]
    mass = float(np.clip(model.mass * np.abs(factors).prod(), *MASS))
    return dataclasses.replace(
        model,
        name=stretched_name(model.name, number),
        vertices=model.vertices * factors,
        faces=model.faces[:, order],
        pieces=tuple(
            ConvexPiece(piece.vertices * factors, piece.faces[:, order]) for piece in model.pieces
        ),
        mass=mass,
        inertia=_inertia(model.inertia, factors) * (mass / model.mass),
    )


def _inertia(inertia: FloatArray, factors: FloatArray) -> FloatArray:
    """Inertia (3, 3) of the same mass after its axes were scaled."""
    second = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    second = factors[:, None] * second * factors
    return np.trace(second) * np.eye(3) - second
