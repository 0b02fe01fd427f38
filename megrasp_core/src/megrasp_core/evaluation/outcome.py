"""What came of one scene of a protocol."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from megrasp_core.simulation import Verdict
from megrasp_core.synthesizer import RankedGrasp

__all__ = ["JudgedGrasp", "SceneOutcome"]


@dataclass(frozen=True)
class JudgedGrasp:
    """A returned grasp that was tried in a copy of the state.

    Attributes:
        score, confidence, tilt, hidden_share, clearance: of the grasp, see `RankedGrasp`.
        success: of the verdict.
        reason: of the verdict.
        lifted: places of the objects that it lifted.
    """

    score: float
    confidence: float
    tilt: float
    hidden_share: float
    clearance: float
    success: bool
    reason: str
    lifted: tuple[int, ...]

    @classmethod
    def of(cls, grasp: RankedGrasp, verdict: Verdict) -> JudgedGrasp:
        """A grasp and what became of it."""
        return cls(
            float(grasp.score),
            float(grasp.confidence),
            float(grasp.tilt),
            float(grasp.hidden_share),
            float(grasp.clearance),
            bool(verdict.success),
            verdict.reason.value,
            tuple(int(place) for place in verdict.lifted),
        )


@dataclass
class SceneOutcome:
    """Counts of one scene.

    Attributes:
        first: every executed attempt in order: success and the verdict's reason.
        targets: of every attempt, the name of the object that its TCP was nearest to; "" where
            nothing was executed.
        sampled: of every judged sample, success, whether it passed our own check, and the reason.
        counted: so many of the attempts, from the first, count: the next one was made where
            nothing could be lifted. None: all.
        unreachable: objects left at the end of the counted attempts that nothing can lift; None:
            not looked for.
        stages: times that the scene was looked at.
        answered: of them with a grasp to execute.
        objects: that may be lifted, at the start.
        removed: of them that were.
        removed_counted: of them by the attempts that count.
        judged: stage by stage, the returned grasps that were judged, best first.
        seconds: wall time of every synthesis.
        evaluations: of the network that a pose went through.
    """

    first: list[tuple[bool, str]] = field(default_factory=list)
    targets: list[str] = field(default_factory=list)
    sampled: list[tuple[bool, bool, str]] = field(default_factory=list)
    stages: int = 0
    answered: int = 0
    objects: int = 0
    removed: int = 0
    removed_counted: int = 0
    counted: int | None = None
    unreachable: int | None = None
    judged: list[list[JudgedGrasp]] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    evaluations: int = 0

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return dataclasses.asdict(self)

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> SceneOutcome:
        """What `to_json` gave, read from JSON.

        Raises:
            KeyError, TypeError, ValueError: it is something else.
        """
        values = dict(content)
        values["first"] = [(bool(ok), str(why)) for ok, why in values["first"]]
        values["sampled"] = [(bool(ok), bool(free), str(w)) for ok, free, w in values["sampled"]]
        values["judged"] = [
            [JudgedGrasp(**{**one, "lifted": tuple(one["lifted"])}) for one in stage]
            for stage in values["judged"]
        ]
        return cls(**values)
