"""Objects from a seed: unlimited, with exact mass and convex pieces."""

from __future__ import annotations

import colorsys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from megrasp_core.errors import InvalidRequestError

from .folder import save_object
from .kinds import OBJECT_KINDS, OBSTACLE_KINDS
from .model import ConvexPiece, ObjectModel
from .solids import mass_properties

DENSITY = (300.0, 800.0)
MASS = (0.02, 1.0)


def procedural_object(
    seed: int, kind: str | None = None, *, obstacle: bool = False
) -> ObjectModel:
    """Return the object of this seed; the same arguments give the same object.

    kind: one of OBJECT_KINDS or OBSTACLE_KINDS, by default drawn with the seed. obstacle: draw
    from the big ones that jaws cannot grasp instead. The density is drawn from 300 to 800 kg/m3,
    the mass clipped to 0.02..1 kg and the inertia is that of the clipped mass.

    Raises InvalidRequestError for an unknown kind or a negative seed.
    """
    if seed < 0:
        raise InvalidRequestError(f"seed {seed} is negative; expected a whole number from 0.")
    rng = np.random.default_rng([seed, int(obstacle)])
    names = sorted(OBSTACLE_KINDS if obstacle else OBJECT_KINDS)
    drawn = names[int(rng.integers(len(names)))]
    kind = kind or drawn
    build = OBJECT_KINDS.get(kind) or OBSTACLE_KINDS.get(kind)
    if build is None:
        known = ", ".join([*sorted(OBJECT_KINDS), *sorted(OBSTACLE_KINDS)])
        raise InvalidRequestError(f"unknown object kind {kind!r}; expected one of {known}.")
    solid = build(rng)
    properties = mass_properties(solid.pieces)
    mass = float(np.clip(rng.uniform(*DENSITY) * properties.volume, *MASS))
    colour = colorsys.hsv_to_rgb(rng.random(), rng.uniform(0.1, 0.9), rng.uniform(0.35, 0.95))
    return ObjectModel(
        name=f"procedural/{kind}_{seed:06d}",
        vertices=solid.vertices - properties.centre,
        faces=solid.faces,
        pieces=tuple(
            ConvexPiece(points - properties.centre, faces) for points, faces in solid.pieces
        ),
        mass=mass,
        inertia=properties.inertia * (mass / properties.volume),
        colour=colour,
        category=kind,
    )


def generate_objects(
    destination: str | Path,
    count: int,
    seed: int = 0,
    on_progress: Callable[[int, int], object] | None = None,
) -> list[Path]:
    """Write `count` procedural objects below `destination` and return their folders.

    The objects are those of the seeds seed, seed + 1, ...; on_progress(done, count) is called
    after each. Raises InvalidRequestError for a count below 1 and ObjectError when a folder cannot
    be written.
    """
    if count < 1:
        raise InvalidRequestError(f"asked for {count} objects; expected at least 1.")
    folders = []
    for done in range(count):
        model = procedural_object(seed + done)
        folder = Path(destination) / model.name.rpartition("/")[2]
        properties = mass_properties(model.pieces)
        save_object(
            model,
            folder,
            {
                "name": folder.name,
                "set": "procedural",
                "source": f"procedural object, kind {model.category}, seed {seed + done}",
                "licence": "Apache-2.0",
                "density": model.mass / properties.volume,
                "decomposition": "exact: the pieces fill the visual mesh",
                "repair": "none",
            },
        )
        folders.append(folder)
        if on_progress is not None:
            on_progress(done + 1, count)
    return folders
