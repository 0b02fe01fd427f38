"""Numbers that stay as they are, on any processor: `python tests/golden/values.py` writes them.

All in float64, with inputs that nothing but arithmetic makes, so that processors differ in the
last digits only. A change that means to alter them writes them anew and says why.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import torch
from network_scenes import scene, tokens

from megrasp_core.diffusion import NoiseSchedule, SamplerSettings, last_step, sample_steps, target
from megrasp_core.lie import PoseBatch, igso3, so3, wigner_matrices
from megrasp_core.network import PRESETS, GraspModel, build_graph
from megrasp_core.ranking import Calibration, logistic_features
from megrasp_core.simulation import DepthNoise, look_at
from megrasp_core.storage import TextCodes, pack_quaternions, unpack_poses

FILE = Path(__file__).with_name("values.json")
F64 = torch.float64


def values() -> dict[str, list[float]]:
    """Every number by what it is."""
    return {
        "network": _network(),
        "sampler": _sampler(),
        "igso3": _igso3(),
        "wigner": wigner_matrices(_rotation(0.3))[2].flatten().tolist(),
        "score": _score(),
        "codec": _codec(),
        "camera": look_at((0.3, -0.2, 0.8), (0.0, 0.1, 0.0)).ravel().tolist(),
        "noise sizes": [float(v) for v in vars(DepthNoise()).values() if isinstance(v, float)],
    }


def _rotation(angle: float) -> torch.Tensor:
    return so3.exp(torch.tensor([[angle, -0.5 * angle, 0.2]], dtype=F64))


def _network() -> list[float]:
    """Residual, score, confidence and graspability of a model whose weights are waves."""
    model = GraspModel(PRESETS["tiny"]).double().eval().requires_grad_(False)
    for index, weight in enumerate(model.state_dict().values()):
        wave = torch.sin(torch.arange(weight.numel(), dtype=F64) * 1.7 + index)
        weight.copy_(0.3 * wave.view(weight.shape))
    nodes = scene(200)
    field = model.encode_scene(nodes, build_graph(nodes, model.config))
    code = model.encode_gripper(tokens(model.config.gripper_tokens))
    poses = PoseBatch(
        torch.cat([_rotation(a) for a in (0.1, 0.7, 2.0)]),
        torch.tensor([[0.0, 0.0, 0.05], [0.05, -0.02, 0.1], [-0.1, 0.03, 0.0]], dtype=F64),
    )
    found = model.predict(field, code, poses, torch.tensor([0.05, 0.3, 1.0], dtype=F64))
    graspable = model.graspability(field, code)
    parts = (found.residual, found.score, model.confidence(field, code, poses), graspable[:5])
    return torch.cat([part.flatten() for part in parts]).tolist()


def _sampler() -> list[float]:
    """Where the default sampler takes fixed starts that are drawn to one of two poses."""
    clean = PoseBatch(
        torch.cat([_rotation(0.4), _rotation(-1.1)]),
        torch.tensor([[0.1, 0.0, 0.02], [-0.1, 0.05, 0.0]], dtype=F64),
    )
    schedule = NoiseSchedule()

    def denoise(poses: PoseBatch, s: torch.Tensor) -> torch.Tensor:
        return 0.9 * target(clean, poses, s, schedule)

    settings = SamplerSettings(kind="deterministic", steps=5, restarts=0)
    starts = torch.tensor([[0.2, 0.1, 0.0], [0.0, -0.1, 0.1]], dtype=F64)
    generator = torch.Generator().manual_seed(3)
    end = last_step(sample_steps(denoise, starts, settings, schedule, generator)).poses
    return [*end.rotation.flatten().tolist(), *end.translation.flatten().tolist()]


def _igso3() -> list[float]:
    angle = torch.linspace(0.1, 3.0, 7, dtype=F64)
    return [
        float(value)
        for sigma in (0.05, 0.4, 0.6, 2.0)
        for value in igso3.log_density(angle, torch.full_like(angle, sigma))
    ]


def _score() -> list[float]:
    features = logistic_features(
        np.array([0.1, 0.5, 0.99, 0.0]),
        np.array([0.0, 0.4, np.nan, 1.0]),
        np.array([0.0, 0.01, 0.3, 1.0]),
        np.array([0.0, 0.003, 0.02, 0.001]),
    )
    calibration = Calibration(-0.3, 0.8, -0.2, -0.7, 46.0)
    return calibration.of_features(features).tolist()


def _codec() -> list[float]:
    quaternion = np.array([[0.1, -0.2, 0.3, 0.9], [0.0, 0.0, 0.0, 1.0]])
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    packed = pack_quaternions(quaternion)
    position = np.array([[100, -200, 300], [1, 2, 3]], np.int16)
    codes = TextCodes.sorted(["slip", "", "slip", "empty"]).codes(["slip", "empty", ""])
    return [
        *packed.ravel().tolist(),
        *unpack_poses(position, packed, 2e-5).ravel().tolist(),
        *codes.tolist(),
    ]


if __name__ == "__main__":
    FILE.write_text(json.dumps(values(), indent=1) + "\n")
