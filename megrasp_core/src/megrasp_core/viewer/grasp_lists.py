"""The grasps of one synthesis as lists to look through: ranked, and rejected by reason."""

from __future__ import annotations

import dataclasses
import math

from megrasp_core.synthesizer import RankedGrasp, Synthesis, SynthesisRequest

__all__ = ["RANKED", "GraspLists", "everything", "report"]

RANKED = "ranked"


def everything(request: SynthesisRequest) -> SynthesisRequest:
    """The request that also returns what is rejected: the same draws, so the same ranked grasps
    first.
    """
    return dataclasses.replace(request, num_grasps=request.drawn, keep_all=True)


class GraspLists:
    """What came of a request, taken from the answer to `everything` of it."""

    def __init__(self, answer: Synthesis, num_grasps: int) -> None:
        """Keep at most `num_grasps` ranked; further ones were surplus."""
        passed = [grasp for grasp in answer.grasps if not grasp.reason]
        ranked, more = passed[:num_grasps], passed[num_grasps:]
        surplus = [dataclasses.replace(grasp, reason="surplus") for grasp in more]
        rejected = dict(answer.rejected)
        if surplus:
            rejected["surplus"] = rejected.get("surplus", 0) + len(surplus)
        self.answer = dataclasses.replace(answer, grasps=ranked, rejected=rejected)
        """As a synthesis without the rejected ones returns it."""
        self._lists: dict[str, list[RankedGrasp]] = {RANKED: ranked}
        for grasp in [*surplus, *(grasp for grasp in answer.grasps if grasp.reason)]:
            self._lists.setdefault(grasp.reason, []).append(grasp)

    @property
    def names(self) -> list[str]:
        """Of the lists: the ranked first, then the reasons, the most frequent first."""
        reasons = [name for name in self._lists if name != RANKED]
        return [RANKED, *sorted(reasons, key=lambda name: -len(self._lists[name]))]

    def __getitem__(self, name: str) -> list[RankedGrasp]:
        return self._lists.get(name, [])


def report(grasp: RankedGrasp, rank: int, of: int) -> str:
    """A grasp in markdown: score and what it is made of, or why it was rejected."""
    x, y, z = grasp.world_from_tcp[:3, 3]
    rows = [
        ("score", f"{grasp.score:.2f}"),
        ("confidence of the model", _number(grasp.confidence, 1, "", 2)),
        ("width between the fingers", _number(grasp.width, 1000, "mm", 1)),
        ("fingers start apart", _number(grasp.opening, 1000, "mm", 1)),
        ("clearance", _number(grasp.clearance, 1000, "mm", 1)),
        ("tilt", _number(math.degrees(grasp.tilt), 1, "degrees", 0)),
        ("of the gripper in unknown space", f"{100 * grasp.hidden_share:.1f} %"),
        ("TCP", f"{x:.3f} {y:.3f} {z:.3f} m"),
    ]
    if grasp.object is not None:
        rows.append(("object of the mask", str(grasp.object)))
    head = f"**{rank} of {of}**" + (f", rejected: **{grasp.reason}**" if grasp.reason else "")
    table = "\n".join(f"| {name} | {value} |" for name, value in rows)
    return f"{head}\n\n| | |\n|---|---|\n{table}"


def _number(value: float, factor: float, unit: str, digits: int) -> str:
    return f"{factor * value:.{digits}f} {unit}".strip() if math.isfinite(value) else "unknown"
