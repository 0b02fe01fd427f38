"""Exact denoiser of a few point targets: what a perfect network would say.

For a distribution of K weighted poses the posterior of the clean pose given a noisy one is a
softmax, so the conditional mean of the residual and the score are known in closed form. Serves to
study samplers apart from any network error.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from megrasp_core.diffusion import NoiseSchedule, target
from megrasp_core.lie import igso3, so3


@dataclass(frozen=True)
class PointMixture:
    """K poses with probabilities.

    Attributes:
        rotation: (K, 3, 3).
        translation: (K, 3), metres.
        weight: (K,), sums to 1.
        schedule: noise sizes.
    """

    rotation: Tensor
    translation: Tensor
    weight: Tensor
    schedule: NoiseSchedule

    def posterior(self, rotation: Tensor, translation: Tensor, s: Tensor) -> Tensor:
        """Probability (P, K) that a noisy pose (P, 3, 3), (P, 3) at level s (P,) is from each."""
        log_f = igso3.log_density(so3.angle(self._back(rotation)), self._sigma(s))
        return self._posterior(translation, s, log_f)

    def residual(self, rotation: Tensor, translation: Tensor, s: Tensor) -> Tensor:
        """E[y | noisy pose] (P, 6), the minimiser of the training loss."""
        share = self.posterior(rotation, translation, s)
        return (share[..., None] * self._targets(rotation, translation, s)).sum(1)

    def scaled_score(self, rotation: Tensor, translation: Tensor, s: Tensor) -> Tensor:
        """[s sigma_t, s sigma_r] times the body-frame score of the noisy density (P, 6)."""
        turn = so3.log(self._back(rotation))
        angle = turn.square().sum(-1).clamp(min=1e-12).sqrt()
        values = igso3.evaluate(angle, self._sigma(s))
        share = self._posterior(translation, s, values.log_density)
        offset = self._targets(rotation, translation, s)[..., :3]
        turn_score = (self._sigma(s) * values.score / angle)[..., None] * turn
        return (share[..., None] * torch.cat([offset, turn_score], -1)).sum(1)

    def nearest(self, rotation: Tensor, translation: Tensor) -> Tensor:
        """Index (P,) of the nearest target, distances in units of the schedule's sigmas."""
        offset = (translation[:, None] - self.translation).norm(dim=-1) / self.schedule.sigma_t
        angle = so3.angle(self._back(rotation)) / self.schedule.sigma_r
        return (offset.square() + angle.square()).argmin(-1)

    def _sigma(self, s: Tensor) -> Tensor:
        return (s * self.schedule.sigma_r)[:, None]

    def _posterior(self, translation: Tensor, s: Tensor, log_f: Tensor) -> Tensor:
        offset = (translation[:, None] - self.translation).square().sum(-1)
        log_p = -0.5 * offset / (s[:, None] * self.schedule.sigma_t).square() + log_f
        return (self.weight.log() + log_p).softmax(-1)

    def _back(self, rotation: Tensor) -> Tensor:
        return self.rotation.transpose(-1, -2) @ rotation[:, None]

    def _targets(self, rotation: Tensor, translation: Tensor, s: Tensor) -> Tensor:
        count = self.weight.shape[0]
        return target(
            self.rotation,
            self.translation,
            rotation[:, None].expand(-1, count, 3, 3),
            translation[:, None].expand(-1, count, 3),
            s[:, None],
            self.schedule,
        )
