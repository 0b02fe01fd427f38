"""What of a synthesizer is fixed between calls."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..diffusion import SamplerSettings
from ..pointcloud import SceneSettings
from ..ranking import (
    CheckSettings,
    ContactSettings,
    ObservationSettings,
    ProbeSettings,
    RankSettings,
)

__all__ = ["RankingSettings", "SynthesizerSettings"]


@dataclass(frozen=True)
class RankingSettings:
    """Settings of every part of the ranking."""

    observation: ObservationSettings = field(default_factory=ObservationSettings)
    check: CheckSettings = field(default_factory=CheckSettings)
    contact: ContactSettings = field(default_factory=ContactSettings)
    rank: RankSettings = field(default_factory=RankSettings)


@dataclass(frozen=True)
class SynthesizerSettings:
    """What is fixed between calls.

    Attributes:
        sampler: denoiser evaluations and restarts.
        refined: poses that go through the restarts in mode `default` on a CPU; on a GPU all do.
        ranking: check, contacts, score.
        probe: how densely the gripper is sampled for the check.
        scene: preprocessing; None: as the model was trained.
        gripper_seed: of the gripper's clouds and tokens.
    """

    sampler: SamplerSettings = field(default_factory=SamplerSettings)
    refined: int = 40
    ranking: RankingSettings = field(default_factory=RankingSettings)
    probe: ProbeSettings = field(default_factory=ProbeSettings)
    scene: SceneSettings | None = None
    gripper_seed: int = 0
