"""Counts of a grasp library and what its objects are: the numbers behind `megrasp data stats` and
the library's card.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from megrasp_core.errors import ObjectError
from megrasp_core.objects import ObjectSet
from megrasp_core.storage import GraspSet

from .grasp_library import GraspLibrary

__all__ = ["COMPLETE", "OWN_TERMS", "ObjectFacts", "library_stats", "object_facts", "source_of"]

COMPLETE = 100
"""A pair of gripper and object with so many successes, and as many failures, is complete."""
OWN_TERMS = "Apache-2.0, made by this project from a seed"


@dataclass(frozen=True)
class ObjectFacts:
    """What is told of an object without its mesh.

    Attributes:
        name: in the object set.
        source: the set of a scan ("ycb"), or "procedural".
        extents: (3,) edges of its axis-aligned box, smallest first (m).
        mass: kg.
        terms: licence of the mesh.
    """

    name: str
    source: str
    extents: tuple[float, float, float]
    mass: float
    terms: str


def source_of(name: str) -> str:
    """The set that an object's name belongs to: "ycb" of asset/train/ycb/001, "procedural"."""
    parts = name.split("/")
    return parts[2] if parts[0] == "asset" and len(parts) > 3 else parts[0]


def object_facts(
    names: Iterable[str],
    objects: ObjectSet | None = None,
    on_progress: Callable[[], object] | None = None,
) -> tuple[list[ObjectFacts], list[str]]:
    """Facts of the objects that can be loaded, and the names of those that cannot."""
    found, missing = [], []
    objects = objects or ObjectSet(())
    for name in names:
        try:
            model = objects[name]
            folder = objects.folder(name)
        except ObjectError:
            missing.append(name)
        else:
            terms = OWN_TERMS
            if folder is not None:
                meta = json.loads((folder / "meta.json").read_text())
                terms = str(meta.get("licence") or "not given")
            a, b, c = sorted(float(edge) for edge in model.extents)
            found.append(ObjectFacts(name, source_of(name), (a, b, c), model.mass, terms))
        if on_progress is not None:
            on_progress()
    return found, missing


def library_stats(library: GraspLibrary, facts: Sequence[ObjectFacts] = ()) -> dict[str, Any]:
    """Counts of a grasp library.

    Args:
        library: free-space labels.
        facts: of its objects, as far as they could be loaded.

    Returns:
        pairs; objects, those of them labelled for all grippers, and their number by source;
        sums over all grippers of what `grippers` holds; grippers: per gripper objects, those with
        any success, those with at least COMPLETE successes and failures, successes, failures
        kept, full trials, drawn, start collisions, yield (successes / drawn), held_of_trials
        (successes / full trials), mean quality of the successes, median distance (m) of the TCP
        of a failure, and of a success, from that of the nearest other success of the pair, reasons
        of the failures kept, hashes of the description; grippers_able: per object the grippers
        with any success on it and those it was labelled for; sizes: of the objects with facts;
        terms by source.
    """
    grippers = {
        name: _gripper([entry for entry in library if entry.gripper == name])
        for name in library.grippers
    }
    able: dict[str, dict[str, int]] = {}
    for entry in library:
        counts = able.setdefault(entry.object_name, {"able": 0, "labelled": 0})
        counts["able"] += bool(entry.success.any())
        counts["labelled"] += 1
    sums = ("objects_with_success", "objects_complete")
    counts = ("successes", "failures_kept", "trials", "drawn", "start_collisions")
    total = {key: sum(entry[key] for entry in grippers.values()) for key in (*sums, *counts)}
    return {
        "pairs": len(library),
        "pairs_with_success": total["objects_with_success"],
        "pairs_complete": total["objects_complete"],
        "objects": len(able),
        "objects_of_all_grippers": len(library.objects()) if able else 0,
        "sources": dict(sorted(Counter(source_of(name) for name in able).items())),
        **{key: total[key] for key in counts},
        "grippers": grippers,
        "grippers_able": dict(sorted(able.items())),
        "sizes": _sizes(facts),
        "terms": _terms(facts),
    }


def _gripper(sets: Sequence[GraspSet]) -> dict[str, Any]:
    held = np.array([int(entry.success.sum()) for entry in sets])
    lost = np.array([len(entry.success) for entry in sets]) - held
    drawn, tried = sum(entry.drawn for entry in sets), sum(entry.tried for entry in sets)
    quality = np.concatenate([entry.quality[entry.success] for entry in sets])
    reasons = Counter(
        str(reason) for entry in sets for reason in entry.reason[~np.asarray(entry.success)]
    )
    return {
        "objects": len(sets),
        "objects_with_success": int((held > 0).sum()),
        "objects_complete": int(((held >= COMPLETE) & (lost >= COMPLETE)).sum()),
        "successes": int(held.sum()),
        "failures_kept": int(lost.sum()),
        "trials": tried,
        "drawn": drawn,
        "start_collisions": drawn - tried,
        "yield": _share(held.sum(), drawn),
        "held_of_trials": _share(held.sum(), tried),
        "mean_quality": float(quality.mean()) if len(quality) else None,
        "failure_to_success": _median([_to_success(entry, False) for entry in sets]),
        "success_to_success": _median([_to_success(entry, True) for entry in sets]),
        "failures_by_reason": dict(reasons.most_common()),
        "hashes": sorted({entry.gripper_hash for entry in sets}),
    }


def _to_success(entry: GraspSet, success: bool) -> np.ndarray:
    """Distances (m) of the failures', or successes', TCPs from the nearest other success."""
    held = np.asarray(entry.success, bool)
    places = entry.object_from_tcp[:, :3]
    if not held.any():
        return np.zeros(0)
    # A success is the nearest one to itself; without a second one its distance is infinite.
    distance = KDTree(places[held]).query(places[held == success], k=2)[0][:, int(success)]
    return distance[np.isfinite(distance)]


def _median(parts: Sequence[np.ndarray]) -> float | None:
    values = np.concatenate([np.zeros(0), *parts])
    return float(np.median(values)) if len(values) else None


def _share(part: float, whole: float) -> float | None:
    return float(part / whole) if whole else None


def _sizes(facts: Sequence[ObjectFacts]) -> dict[str, Any]:
    if not facts:
        return {"objects": 0}
    extents = np.array([fact.extents for fact in facts])
    columns: Mapping[str, np.ndarray] = {
        "smallest_extent": extents[:, 0],
        "largest_extent": extents[:, 2],
        "mass": np.array([fact.mass for fact in facts]),
    }
    return {
        "objects": len(facts),
        **{
            name: {"min": float(v.min()), "median": float(np.median(v)), "max": float(v.max())}
            for name, v in columns.items()
        },
    }


def _terms(facts: Sequence[ObjectFacts]) -> dict[str, list[str]]:
    sources = sorted({fact.source for fact in facts})
    return {s: sorted({fact.terms for fact in facts if fact.source == s}) for s in sources}
