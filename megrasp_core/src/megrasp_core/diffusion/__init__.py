"""Diffusion on SE(3): noise schedule, forward process, samplers."""

from .forward import perturb, score_target, target
from .sampler import Denoise, SamplerStep, descend, last_step, refine, sample_steps
from .schedule import LOW_LEVEL, NoiseSchedule
from .settings import SamplerSettings

__all__ = [
    "LOW_LEVEL",
    "Denoise",
    "NoiseSchedule",
    "SamplerSettings",
    "SamplerStep",
    "descend",
    "last_step",
    "perturb",
    "refine",
    "sample_steps",
    "score_target",
    "target",
]
