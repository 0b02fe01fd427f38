"""What a synthesis returns, and `grasps.json`."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from megrasp_core.lie import pose7_from_matrix

__all__ = ["RankedGrasp", "Synthesis"]


@dataclass(frozen=True, eq=False)
class RankedGrasp:
    """One grasp, poses (4, 4) in the frame of the cloud.

    Attributes:
        world_from_tcp: pre-grasp, TCP frame.
        world_from_gripper: pre-grasp, gripper frame, fingers at `share` of their way.
        world_from_gripper_approach: gripper frame at the stand-off.
        world_from_gripper_retreat: gripper frame where to go with the object.
        score: 0..1, higher is better; with a calibrated model the probability of success.
        width: extent of what is between the fingers along X (m); NaN where undefined.
        clearance: distance of the open gripper to the nearest seen point or wall (m).
        tilt: angle between gripper +Z and gravity (rad); NaN where gravity is not known.
        collision_free: the grasp passed the whole check.
        reason: why it did not, "" where it did.
        confidence: the model's, before the check had its say; NaN without that head.
        hidden_share: share of the open gripper that lies where nothing was seen.
        width_tolerance: the fingers stop within this of `width` when they hold what was seen (m);
            NaN where undefined.
        opening: between the fingers before they close (m); NaN for hands.
        share: of the way from the open to the closed posture at which the fingers start.
        object: label of what is grasped; None where the cloud has no labels or it is none.
    """

    world_from_tcp: np.ndarray
    world_from_gripper: np.ndarray
    world_from_gripper_approach: np.ndarray
    world_from_gripper_retreat: np.ndarray
    score: float
    width: float
    clearance: float
    tilt: float
    collision_free: bool
    reason: str = ""
    confidence: float = float("nan")
    hidden_share: float = 0.0
    width_tolerance: float = float("nan")
    opening: float = float("nan")
    share: float = 0.0
    object: int | None = None

    def moved(self, offset: np.ndarray) -> RankedGrasp:
        """The same grasp, moved by `offset` (3,) (m)."""
        poses = {name: np.array(getattr(self, name)) for name in _POSES}
        for pose in poses.values():
            pose[:3, 3] += offset
        return replace(self, **poses)

    def to_json(self) -> dict[str, Any]:
        """Entry of `grasps` in grasps.json; undefined numbers become null."""
        content: dict[str, Any] = {
            **{name: _pose(getattr(self, name)) for name in _POSES},
            "score": _number(self.score),
            "width": _number(self.width),
            "width_tolerance": _number(self.width_tolerance),
            "opening": _number(self.opening),
            "object": self.object,
            "clearance": _number(self.clearance),
            "tilt": _number(self.tilt),
            "collision_free": self.collision_free,
            "confidence": _number(self.confidence),
            "hidden_share": _number(self.hidden_share),
        }
        if self.reason:
            content["reason"] = self.reason
        return content


@dataclass(frozen=True, eq=False)
class Synthesis:
    """Outcome of one synthesis.

    Attributes:
        grasps: best first; those that fail the check last (only with keep_all).
        rejected: number of drawn poses per reason; together with the returned ones that passed
            they make `drawn`.
        timing: seconds of perceive, encode, sample, rank and total.
        seed: the one used.
        drawn: poses drawn.
        evaluations: evaluations of the denoiser that a fully refined pose went through.
        gripper: name.
        model: id.
        bin_empty: nothing but the support surface was seen, so that nothing was drawn.
        notes: what was taken for granted or looks wrong, in sentences.
        hints: what most of the drawn poses failed for and what to do about it, in sentences.
        extra: further entries of grasps.json.
    """

    grasps: list[RankedGrasp]
    rejected: dict[str, int]
    timing: dict[str, float]
    seed: int
    drawn: int
    evaluations: int
    gripper: str
    model: str
    bin_empty: bool = False
    notes: tuple[str, ...] = ()
    hints: tuple[str, ...] = ()
    extra: dict[str, Any] = field(default_factory=dict)

    def to_json(self, frame: str = "world") -> dict[str, Any]:
        """Content of grasps.json (docs/frames.md).

        Args:
            frame: name of the frame that the poses are in.
        """
        return {
            "frame": frame,
            "gripper": self.gripper,
            "model": self.model,
            "seed": self.seed,
            "drawn": self.drawn,
            "evaluations": self.evaluations,
            "grasps": [grasp.to_json() for grasp in self.grasps],
            "rejected": dict(self.rejected),
            "timing": {key: round(value, 5) for key, value in self.timing.items()},
            **({"bin_empty": True} if self.bin_empty else {}),
            **({"notes": list(self.notes)} if self.notes else {}),
            **({"hints": list(self.hints)} if self.hints else {}),
            **self.extra,
        }

    def write_json(self, path: str | Path, frame: str = "world") -> None:
        """Write grasps.json; missing folders are made."""
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(self.to_json(frame), indent=1, allow_nan=False) + "\n")


_POSES = (
    "world_from_tcp",
    "world_from_gripper",
    "world_from_gripper_approach",
    "world_from_gripper_retreat",
)


def _pose(matrix: np.ndarray) -> list[float]:
    return [round(float(v), 9) for v in pose7_from_matrix(matrix)]


def _number(value: float) -> float | None:
    return round(float(value), 6) if math.isfinite(value) else None
