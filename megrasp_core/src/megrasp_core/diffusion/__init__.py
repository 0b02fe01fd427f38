"""Diffusion on SE(3): noise schedule, forward process, samplers."""

from megrasp_core.diffusion.forward import apply_residual, perturb, score_target, target
from megrasp_core.diffusion.mixture import PointMixture
from megrasp_core.diffusion.sampler import (
    Denoise,
    SamplerStep,
    descend,
    last_step,
    refine,
    sample_steps,
)
from megrasp_core.diffusion.schedule import NoiseSchedule
from megrasp_core.diffusion.settings import SamplerSettings

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
