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
from megrasp_core.lie import PoseBatch, igso3, so3


@dataclass(frozen=True)
class PointMixture:
    """K poses with probabilities.

    Attributes:
        poses: K.
        weight: (K,), sums to 1.
        schedule: noise sizes.
    """

    poses: PoseBatch
    weight: Tensor
    schedule: NoiseSchedule

    def posterior(self, noisy: PoseBatch, s: Tensor) -> Tensor:
        """Probability (P, K) that each of P noisy poses at level s (P,) is from each of K."""
        log_f = igso3.log_density(so3.angle(self._back(noisy)), self._sigma(s))
        return self._posterior(noisy, s, log_f)

    def residual(self, noisy: PoseBatch, s: Tensor) -> Tensor:
        """E[y | noisy pose] (P, 6), the minimiser of the training loss."""
        share = self.posterior(noisy, s)
        return (share[..., None] * self._targets(noisy, s)).sum(1)

    def scaled_score(self, noisy: PoseBatch, s: Tensor) -> Tensor:
        """[s sigma_t, s sigma_r] times the body-frame score of the noisy density (P, 6)."""
        turn = so3.log(self._back(noisy))
        angle = turn.square().sum(-1).clamp(min=1e-12).sqrt()
        values = igso3.evaluate(angle, self._sigma(s))
        share = self._posterior(noisy, s, values.log_density)
        offset = self._targets(noisy, s)[..., :3]
        turn_score = (self._sigma(s) * values.score / angle)[..., None] * turn
        return (share[..., None] * torch.cat([offset, turn_score], -1)).sum(1)

    def nearest(self, poses: PoseBatch) -> Tensor:
        """Index (P,) of the nearest target, distances in units of the schedule's sigmas."""
        offset = self._offset(poses).norm(dim=-1) / self.schedule.sigma_t
        angle = so3.angle(self._back(poses)) / self.schedule.sigma_r
        return (offset.square() + angle.square()).argmin(-1)

    def _sigma(self, s: Tensor) -> Tensor:
        return (s * self.schedule.sigma_r)[:, None]

    def _posterior(self, noisy: PoseBatch, s: Tensor, log_f: Tensor) -> Tensor:
        offset = self._offset(noisy).square().sum(-1)
        log_p = -0.5 * offset / (s[:, None] * self.schedule.sigma_t).square() + log_f
        return (self.weight.log() + log_p).softmax(-1)

    def _offset(self, noisy: PoseBatch) -> Tensor:
        return noisy.translation[:, None] - self.poses.translation

    def _back(self, noisy: PoseBatch) -> Tensor:
        return self.poses.rotation.transpose(-1, -2) @ noisy.rotation[:, None]

    def _targets(self, noisy: PoseBatch, s: Tensor) -> Tensor:
        count = self.weight.shape[0]
        repeated = PoseBatch(
            noisy.rotation[:, None].expand(-1, count, 3, 3),
            noisy.translation[:, None].expand(-1, count, 3),
        )
        return target(self.poses, repeated, s[:, None], self.schedule)
