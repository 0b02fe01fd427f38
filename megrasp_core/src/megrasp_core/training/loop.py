"""The training loop: draw, denoise, step, average, check, save."""

from __future__ import annotations

import dataclasses
import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..datasets import open_scenes
from ..diffusion import NoiseSchedule
from ..errors import DataError
from ..grippers import GripperTokens, load_gripper
from ..network import GraspModel, save_model
from ..pointcloud import SceneSettings
from . import checkpoint
from .batching import SceneSource
from .config import Counters, TrainConfig
from .curves import plot_curves
from .losses import scene_losses

Progress = Callable[[Counters, dict[str, float]], None]


def train(
    data: str | Path | list[str | Path],
    out: str | Path,
    config: TrainConfig,
    *,
    resume: bool = False,
    start_from: GraspModel | None = None,
    device: str = "cpu",
    on_progress: Progress | None = None,
) -> GraspModel:
    """Train, or go on training, a model.

    Args:
        data: folders of scene data sets, or device packs; one that still grows is read again at
            checkpoints.
        out: folder for the checkpoint, `losses.jsonl`, `losses.png` and the averaged model.
        config: hyper-parameters; when resuming, the ends of the run are taken from it, all else
        from the
            checkpoint.
        resume: go on from the checkpoint in `out`.
        start_from: weights to begin with (fine-tuning, training of the heads).
        device: where to train.
        on_progress: called after every step with the counters and the losses of the step.

    Returns:
        The model with averaged weights.

    Raises:
        DataError: no scenes, or no checkpoint to resume.
    """
    run = _Run(Path(out), config, device, start_from)
    if resume:
        run.resume(config)
    run.read(data)
    last_save = time.monotonic()
    while run.counters.progress(run.config) < 1.0:
        losses = run.step()
        if on_progress is not None:
            on_progress(run.counters, losses)
        if time.monotonic() - last_save > run.config.checkpoint_seconds:
            run.save()
            run.read(data)
            last_save = time.monotonic()
    run.save()
    return run.averaged()


class _Run:
    """State of one training run."""

    def __init__(
        self, out: Path, config: TrainConfig, device: str, start_from: GraspModel | None
    ) -> None:
        self.out, self.config, self.device = out, config, device
        torch.manual_seed(config.seed)
        self.model = GraspModel(config.network, model_id=config.model_id)
        self.before: dict[str, Any] = {}
        if start_from is not None:
            self.model.load_state_dict(start_from.state_dict())
            self.before = start_from.info
        self.model.to(device).low_precision = config.low_precision
        if config.train_only == "heads":
            for name, parameter in self.model.named_parameters():
                parameter.requires_grad_(name.startswith(("confidence", "graspability")))
        self.ema = {k: v.detach().clone() for k, v in self.model.state_dict().items()}
        self.optimiser = torch.optim.AdamW(
            [p for p in self.model.parameters() if p.requires_grad],
            lr=config.learning_rate,
            weight_decay=config.weight_decay,
            betas=(0.9, 0.99),
        )
        self.rng = np.random.default_rng(config.seed)
        self.generator = torch.Generator(device).manual_seed(config.seed)
        self.counters = Counters()
        self.schedule = NoiseSchedule(
            sigma_t=config.network.sigma_t,
            sigma_r=config.network.sigma_r,
            s_min=config.network.s_min,
        )
        grippers = {name: load_gripper(name) for name in config.grippers}
        self.hashes = {name: gripper.hash for name, gripper in grippers.items()}
        self._tokens: dict[str, list[GripperTokens]] = {
            name: [gripper.tokens(config.network.gripper_tokens, seed=seed) for seed in range(8)]
            for name, gripper in grippers.items()
        }
        self.source: SceneSource | None = None
        self.validation: SceneSource | None = None
        self.scenes = -1
        self.averages: dict[str, float] = {}

    def read(self, data: str | Path | list[str | Path]) -> None:
        """(Re)read the data set: a tenth of the scenes, by their place in the list, validates."""
        dataset = open_scenes(data)
        if len(dataset) == self.scenes:
            return
        if len(dataset) < 2:
            raise DataError(
                f"{data} holds {len(dataset)} scenes; expected at least 2. Make some with "
                "`megrasp data scenes --out DIR`."
            )
        self.scenes = len(dataset)
        held_out = [i for i in range(len(dataset)) if i % 20 == 7][: self.config.validation_scenes]
        used = [i for i in range(len(dataset)) if i not in set(held_out)]
        self.source = SceneSource(dataset, self.config, self.config.network, used)
        self.validation = SceneSource(dataset, self.config, self.config.network, held_out)

    def resume(self, config: TrainConfig) -> None:
        """Go on from the checkpoint; only the ends of the run may change."""
        stored, self.counters = checkpoint.load_checkpoint(
            self.out, self.model, self.ema, self.optimiser, self.rng, self.generator
        )
        self.config = dataclasses.replace(
            stored, total_poses=config.total_poses, total_seconds=config.total_seconds
        )

    def step(self) -> dict[str, float]:
        """One optimiser step."""
        assert self.source is not None
        began, cpu = time.monotonic(), time.process_time()
        config = self.config
        self.model.train()
        for group in self.optimiser.param_groups:
            group["lr"] = config.learning_rate * self._rate()
        self.optimiser.zero_grad(set_to_none=True)
        codes = {
            name: self.model.encode_gripper(options[int(self.rng.integers(len(options)))])
            for name, options in self._tokens.items()
        }
        total = torch.zeros((), device=self.device)
        parts: list[dict[str, float]] = []
        for _ in range(config.scenes_per_step):
            batch = self.source.draw(self.rng)
            loss, values = scene_losses(
                self.model, codes, batch, config, self.schedule, self.generator
            )
            total = total + loss / config.scenes_per_step
            parts.append(values)
            if config.train_only == "all":
                self.counters.poses += sum(len(p.label) for p in batch.positives.values())
            self.counters.labelled_poses += sum(len(p.label) for p in batch.labelled.values())
            self.counters.scenes += 1
        total.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.model.parameters(), config.gradient_clip)
        if torch.isfinite(norm):
            self.optimiser.step()
            self._average()
        self.counters.steps += 1
        self.counters.seconds += time.monotonic() - began
        self.counters.cpu_seconds += time.process_time() - cpu
        losses = {k: float(np.mean([p[k] for p in parts if k in p])) for k in parts[0]}
        for name, value in losses.items():
            self.averages[name] = 0.98 * self.averages.get(name, value) + 0.02 * value
        return losses

    def _rate(self) -> float:
        """Learning rate factor: warm-up, constant, linear decay to 2 %."""
        warm = min(1.0, (self.counters.steps + 1) / self.config.warmup_steps)
        left = (1.0 - self.counters.progress(self.config)) / self.config.decay_share
        return warm * max(0.02, min(1.0, left))

    @torch.no_grad()
    def _average(self) -> None:
        decay = min(self.config.ema_decay, (1 + self.counters.steps) / (10 + self.counters.steps))
        for name, value in self.model.state_dict().items():
            self.ema[name].lerp_(value.to(self.ema[name].dtype), 1.0 - decay)

    def averaged(self) -> GraspModel:
        """A copy of the model with averaged weights."""
        model = GraspModel(self.config.network, model_id=self.config.model_id)
        model.load_state_dict({k: v.cpu() for k, v in self.ema.items()})
        model.low_precision = self.config.low_precision
        return model.to(self.device).eval().requires_grad_(False)

    def save(self) -> None:
        """Checkpoint, averaged model, loss line and curves."""
        checkpoint.save_checkpoint(
            self.out, self.model, self.ema, self.optimiser, self.config, self.counters, self.rng,
            self.generator,
        )  # fmt: skip
        model = self.averaged()
        validation = self._validate(model)
        line = {
            **dataclasses.asdict(self.counters),
            **{f"train_{k}": round(v, 5) for k, v in self.averages.items()},
            **{f"validation_{k}": round(v, 5) for k, v in validation.items()},
            "data_scenes": self.scenes,
        }
        with (self.out / "losses.jsonl").open("a") as file:
            file.write(json.dumps(line) + "\n")
        plot_curves(self.out / "losses.jsonl", self.out / "losses.png")
        facts = ("model_id", "counters", "training", "data_scenes", "sha256")
        before = {name: self.before[name] for name in facts if name in self.before}
        save_model(
            model,
            self.out / "model",
            {
                **({"started_from": before} if before else {}),
                "counters": dataclasses.asdict(self.counters),
                "training": self.config.to_dict(),
                "trained_grippers": self.hashes,
                "data_scenes": self.scenes,
                "heads": self.heads(),
                "scene": dataclasses.asdict(SceneSettings()),
                "low_precision": self.config.low_precision,
            },
        )

    def heads(self) -> list[str]:
        """Heads that were trained and may be used."""
        weights = {
            "confidence": self.config.confidence_weight,
            "graspability": self.config.graspability_weight,
        }
        trained = {name for name, weight in weights.items() if weight > 0}
        return sorted(trained | set(self.before.get("heads", ())))

    @torch.no_grad()
    def _validate(self, model: GraspModel) -> dict[str, float]:
        """Losses of the averaged model on the held-out scenes, same noise every time."""
        assert self.validation is not None
        rng = np.random.default_rng(0)
        generator = torch.Generator(self.device).manual_seed(0)
        codes = {name: model.encode_gripper(options[0]) for name, options in self._tokens.items()}
        found: dict[str, list[float]] = {}
        for index in self.validation.indices:
            batch = self.validation.batch(self.validation.record(index), rng, augment=False)
            _, values = scene_losses(model, codes, batch, self.config, self.schedule, generator)
            for name, value in values.items():
                found.setdefault(name, []).append(value)
        return {
            k: float(np.mean(v)) for k, v in found.items() if not math.isnan(float(np.mean(v)))
        }
