"""Fidelity of the own descriptions: each held against the CAD model of the same gripper, with
limits.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from megrasp_core.grippers import POSTURES, Gripper, cad_twins, load_gripper

from .compare import Comparison, compare

POINTS = 20000
# Mean distance of the outer surfaces (m), by kind; hands have more and rounder links.
SURFACE_LIMIT = {"parallel": 0.003, "adaptive": 0.003, "hand": 0.005}
TCP_LIMIT = 0.002
OPENING_LIMIT = 0.002
PAD_MOTION_LIMIT = 0.003


@dataclass(frozen=True)
class Measure:
    """One line of the table: a length in metres and the most it may be, None where only shown."""

    quantity: str
    value: float
    limit: float | None

    @property
    def passed(self) -> bool:
        """Whether the value is within the limit."""
        return self.limit is None or abs(self.value) <= self.limit


@dataclass(frozen=True)
class Fidelity:
    """How far a gripper is from a reference: names, hashes and the measures."""

    gripper: str
    reference: str
    hashes: tuple[str, str]
    points: int
    measures: tuple[Measure, ...]

    @property
    def passed(self) -> bool:
        """Whether every measure is within its limit."""
        return all(measure.passed for measure in self.measures)

    def to_dict(self) -> dict[str, Any]:
        """Return the contents as JSON holds them."""
        return {
            "gripper": self.gripper,
            "reference": self.reference,
            "hashes": list(self.hashes),
            "points": self.points,
            "passed": self.passed,
            "measures": {
                m.quantity: {"value": round(m.value, 6), "limit": m.limit, "passed": m.passed}
                for m in self.measures
            },
        }


def fidelity(
    gripper: Gripper, reference: Gripper, points: int = POINTS, seed: int = 0
) -> Fidelity:
    """Compare a gripper with a reference, posture by posture, `points` surface points each."""
    found = compare(gripper, reference, points, seed)
    return Fidelity(
        gripper.name,
        reference.name,
        (gripper.hash, reference.hash),
        points,
        tuple(_measures(found, gripper)),
    )


def fidelity_of_twins(names: Iterable[str] = (), points: int = POINTS) -> Iterable[Fidelity]:
    """Yield the fidelity of the named own descriptions, of all that have a CAD twin without names.

    Raises:
        UnknownGripperError: a name has no description.
        DescriptionError: MEGRASP_ASSETS is not set.
    """
    twins = cad_twins()
    for name in list(names) or list(twins):
        own = load_gripper(name)
        yield fidelity(own, load_gripper(twins.get(name, f"{name}_cad")), points)


def _measures(found: Comparison, gripper: Gripper) -> Iterable[Measure]:
    limit = SURFACE_LIMIT[gripper.description.kind]
    for posture in POSTURES:
        yield Measure(f"surface_{posture}", found.surface[posture], limit)
        yield Measure(f"surface_{posture}_p95", found.surface_p95[posture], None)
    yield Measure("tcp", found.tcp, TCP_LIMIT)
    # A hand has no width, though a ray between its fingers may still hit something.
    if gripper.description.max_width is not None:
        yield Measure("opening", found.opening, OPENING_LIMIT)
    yield Measure("pad_motion", found.pad_motion, PAD_MOTION_LIMIT)


LABELS = {
    "surface_open": "surface, open",
    "surface_open_p95": "surface, open, p95",
    "surface_closed": "surface, closed",
    "surface_closed_p95": "surface, closed, p95",
    "tcp": "TCP",
    "opening": "opening",
    "pad_motion": "pad motion",
}


def text_table(result: Fidelity) -> str:
    """Return one comparison as lines of text, millimetres."""
    lines = [f"{'':<22s}{'mm':>8s}{'limit':>8s}"]
    for m in result.measures:
        limit = (
            "" if m.limit is None else f"{1000 * m.limit:8.1f}  {'pass' if m.passed else 'FAIL'}"
        )
        lines.append(f"{LABELS[m.quantity]:<22s}{1000 * m.value:8.2f}{limit}")
    return "\n".join(lines)


def markdown_table(results: Iterable[Mapping[str, Any]]) -> str:
    """Return comparisons (`Fidelity.to_dict`) as a markdown table, millimetres; a value over its
    limit is bold.
    """
    head = " | ".join(LABELS.values())
    lines = [f"| gripper | {head} |", "|---|" + "---|" * len(LABELS)]
    for result in results:
        cells = [_cell(result["measures"].get(quantity)) for quantity in LABELS]
        lines.append(f"| {result['gripper']} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _cell(measure: Mapping[str, Any] | None) -> str:
    if measure is None:
        return "-"
    text = f"{round(1000 * measure['value'], 2) + 0.0:.2f}"
    return text if measure["passed"] else f"**{text}**"
