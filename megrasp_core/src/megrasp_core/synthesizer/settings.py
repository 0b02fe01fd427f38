"""What of a synthesizer is fixed between calls."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from typing import Literal

from megrasp_core.diffusion import SamplerSettings
from megrasp_core.pointcloud import SceneSettings
from megrasp_core.ranges import COUNT, FROM_ONE, LENGTH, SHARE, check_ranges
from megrasp_core.ranking import (
    CheckSettings,
    ContactSettings,
    ObservationSettings,
    ProbeSettings,
    RankSettings,
    SweepSettings,
)

__all__ = ["REPAIRS", "PolishSettings", "RankingSettings", "Stage", "SynthesizerSettings"]


Stage = Literal["openings", "sweep", "turns", "back_off", "polish"]
"""What `SynthesizerSettings.without` can leave out."""

REPAIRS: tuple[Stage, ...] = ("turns", "back_off", "polish")
"""Stages that move samples."""


@dataclass(frozen=True)
class RankingSettings:
    """Settings of every part of the ranking.

    Attributes:
        observation: what was seen and what was not.
        check: when a grasp is refused.
        contact: what lies between the fingers.
        rank: score and near duplicates.
        sweep: the way of the fingers.
        least_room: a gripper that starts less than fully open is opened so much wider than what is
            to come between its fingers (m).
    """

    observation: ObservationSettings = field(default_factory=ObservationSettings)
    check: CheckSettings = field(default_factory=CheckSettings)
    contact: ContactSettings = field(default_factory=ContactSettings)
    rank: RankSettings = field(default_factory=RankSettings)
    sweep: SweepSettings = field(default_factory=SweepSettings)
    least_room: float = 0.012

    def __post_init__(self) -> None:
        check_ranges(
            self,
            least_room=LENGTH,
        )


@dataclass(frozen=True)
class PolishSettings:
    """How the best samples are moved.

    Attributes:
        candidates: so many samples are polished; 0: none.
        rounds: of moves.
        moves: tried per candidate and round.
        distance: standard deviation of a move in the first round (m).
        angle: that of a turn (rad).
        shrink: of both from round to round.
    """

    candidates: int = 12
    rounds: int = 2
    moves: int = 6
    distance: float = 0.004
    angle: float = 0.09
    shrink: float = 0.7

    def __post_init__(self) -> None:
        check_ranges(
            self,
            candidates=COUNT,
            rounds=COUNT,
            moves=FROM_ONE,
            distance=LENGTH,
            angle=LENGTH,
            shrink=LENGTH,
        )


@dataclass(frozen=True)
class SynthesizerSettings:
    """What is fixed between calls.

    Attributes:
        sampler: denoiser evaluations and restarts; None: as the model says.
        polish: local search about the best samples in mode `default`.
        turns: grasps from below or in collision from the side are tried from the other side.
        back_off: grasps whose fingers hit something while they close are tried further back.
        sure: from this score on a grasp is good enough for no more poses to be drawn.
        refined: poses that go through the restarts in mode `default` on a CPU; on a GPU all do.
        ranking: check, contacts, score.
        probe: how densely the gripper is sampled for the check.
        scene: preprocessing; None: as the model was trained.
        gripper_seed: of the gripper's clouds and tokens.
    """

    sampler: SamplerSettings | None = None
    polish: PolishSettings = field(default_factory=PolishSettings)
    turns: bool = True
    back_off: bool = True
    sure: float = 0.6
    refined: int = 40
    ranking: RankingSettings = field(default_factory=RankingSettings)
    probe: ProbeSettings = field(default_factory=ProbeSettings)
    scene: SceneSettings | None = None
    gripper_seed: int = 0

    def __post_init__(self) -> None:
        check_ranges(
            self,
            sure=SHARE,
            refined=COUNT,
            gripper_seed=COUNT,
        )

    def without(self, stages: Collection[Stage]) -> SynthesizerSettings:
        """The same without some stages, to measure what each of them gains."""
        changed = self
        if "openings" in stages:
            changed = replace(changed, probe=replace(changed.probe, narrower=()))
        if "sweep" in stages:
            sweep = replace(changed.ranking.sweep, steps=0)
            changed = replace(changed, ranking=replace(changed.ranking, sweep=sweep))
        if "turns" in stages:
            changed = replace(changed, turns=False)
        if "back_off" in stages:
            changed = replace(changed, back_off=False)
        if "polish" in stages:
            changed = replace(changed, polish=replace(changed.polish, candidates=0))
        return changed
