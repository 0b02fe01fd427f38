"""Diffusion on SE(3): noise schedule, forward process, samplers."""

from .forward import apply_residual, perturb, score_target, target
from .mixture import PointMixture
from .sampler import Denoise, SamplerStep, descend, last_step, refine, sample_steps
from .schedule import NoiseSchedule
from .settings import SamplerSettings

__all__ = [
    "Denoise",
    "NoiseSchedule",
    "PointMixture",
    "SamplerSettings",
    "SamplerStep",
    "apply_residual",
    "descend",
    "last_step",
    "perturb",
    "refine",
    "sample_steps",
    "score_target",
    "target",
]
