"""Where the samples start, nodes at which a grasp is likely, or any node that is not on the
support plane; and what the sampler asks of the network.
"""

from __future__ import annotations

import torch
from torch import Tensor

from megrasp_core.diffusion import Denoise, SamplerSettings
from megrasp_core.lie import PoseBatch
from megrasp_core.network import GraspModel, GripperCode, SceneField

from .parts import in_parts

__all__ = ["denoiser", "draw_starts"]

UNIFORM_SHARE = 0.2
"""Share of the starts that are drawn uniformly even with graspability: coverage comes from the
starts."""


def draw_starts(
    model: GraspModel,
    scene: SceneField,
    code: GripperCode,
    count: int,
    generator: torch.Generator,
    allowed: tuple[Tensor, Tensor] | None = None,
) -> Tensor:
    """Points (count, 3) in centred scene coordinates (m); the sampler adds the noise of s = 1 to
    them.

    Args:
        model: whose graspability head is used where it was trained.
        scene: encoded scene.
        code: encoded gripper.
        count: how many.
        generator: on the device of the scene.
        allowed: masks of the fine and of the coarse nodes at which grasps are wanted; None: all.
    """
    fine = scene.points[0]
    wanted = ~scene.plane if allowed is None else allowed[0]
    free = torch.nonzero(wanted).flatten()
    if len(free) == 0:
        free = torch.arange(len(fine), device=fine.device)
    uniform = fine[
        free[torch.randint(len(free), (count,), generator=generator, device=fine.device)]
    ]
    if "graspability" not in model.info.heads:
        return uniform
    probability = model.graspability(scene, code).sigmoid() + 1e-6
    if allowed is not None and bool(allowed[1].any()):
        probability = torch.where(allowed[1], probability, torch.zeros_like(probability))
    index = torch.multinomial(probability, count, replacement=True, generator=generator)
    keep = torch.rand(count, generator=generator, device=fine.device) < UNIFORM_SHARE
    return torch.where(keep[:, None], uniform, scene.points[1][index])


def denoiser(
    model: GraspModel,
    scene: SceneField,
    code: GripperCode,
    sampler: SamplerSettings,
    at_once: int | None = None,
) -> Denoise:
    """What the steps of a sampler ask of a model: its residual, or with samplers that follow the
    score its rotation score beside the residual's translation.

    Args:
        model: of the scene and the gripper.
        scene: encoded scene.
        code: encoded gripper.
        sampler: whose steps ask.
        at_once: poses that the network takes at a time; None: all.
    """

    def some(poses: PoseBatch, s: Tensor) -> Tensor:
        found = model.predict(scene, code, poses, s)
        if sampler.uses_score:
            return torch.cat([found.residual[:, :3], found.score], dim=-1)
        return found.residual

    def denoise(poses: PoseBatch, s: Tensor) -> Tensor:
        return in_parts(lambda rows: some(poses.part(rows), s[rows]), len(poses), at_once)

    return denoise
