"""Forward process: noise on grasp poses, and what the network has to say about the noisy pose.

Poses are r = (R, t) = world_from_tcp: rotations (..., 3, 3), translations (..., 3) in metres;
levels s have the leading shape (...). Twists are 6 numbers [translation, rotation] in the frame
of the noisy pose, in units of the level's noise, so their size is about one at every level. See
docs/architecture.md, "Diffusion".
"""

from __future__ import annotations

import torch
from torch import Tensor

from megrasp_core.lie import PoseBatch, full_precision, igso3, so3

from .schedule import NoiseSchedule


@full_precision
def perturb(
    poses: PoseBatch,
    s: Tensor,
    schedule: NoiseSchedule,
    generator: torch.Generator | None = None,
) -> PoseBatch:
    """Noisy poses (R_s, t_s) at the levels s.

    t_s = t_0 + s sigma_t R_0 eps, R_s = R_0 Exp(w n) with w n ~ IGSO3(s sigma_r). The translation
    noise is drawn in the frame of the pose: the same distribution, and with equal generator
    states noise turns with the pose.

    Args:
        poses: (R_0, t_0) of shape (...).
        s: (...) levels.
        schedule: noise sizes.
        generator: on the device of the poses.
    """
    rotation, place = poses.rotation, poses.translation
    eps = torch.randn(place.shape, generator=generator, dtype=place.dtype, device=place.device)
    offset = (schedule.sigma_t * s)[..., None] * eps
    moved = place + (rotation @ offset[..., None]).squeeze(-1)
    turn = igso3.sample(schedule.sigma_r * s, generator)
    return PoseBatch(rotation @ so3.exp(turn), moved)


@full_precision
def target(poses: PoseBatch, noisy: PoseBatch, s: Tensor, schedule: NoiseSchedule) -> Tensor:
    """Residual y (..., 6) that leads from the noisy pose to the clean one.

    y = [R_s^T (t_0 - t_s) / (s sigma_t), Log(R_s^T R_0) / (s sigma_r)]; loss mean |F - y|^2.
    """
    back = noisy.rotation.transpose(-1, -2)
    offset = (back @ (poses.translation - noisy.translation)[..., None]).squeeze(-1)
    turn = so3.log(back @ poses.rotation)
    return torch.cat(
        [offset / (schedule.sigma_t * s)[..., None], turn / (schedule.sigma_r * s)[..., None]], -1
    )


@full_precision
def score_target(poses: PoseBatch, noisy: PoseBatch, s: Tensor, schedule: NoiseSchedule) -> Tensor:
    """Target (..., 3) of the rotation score head: s sigma_r (d log f/dw)(w; s sigma_r) n.

    w n = Log(R_0^T R_s): the derivative of the log density along body-frame turns of the noisy
    pose, in units of the level's noise. For s sigma_r <= 0.5 it equals the residual within 2 %.
    """
    turn = so3.log(poses.rotation.transpose(-1, -2) @ noisy.rotation)
    return scaled_rotation_score(turn, schedule.sigma_r * s)


def scaled_rotation_score(turn: Tensor, sigma: Tensor) -> Tensor:
    """Score along rotation vectors `turn` (..., 3), times sigma (...): sigma (d log f/dw) n."""
    squared = (turn * turn).sum(-1)
    # The score is linear in w near 0, so a floor on w keeps direction and value.
    w = squared.clamp(min=1e-12).sqrt()
    return (sigma * igso3.score(w, sigma) / w)[..., None] * turn
