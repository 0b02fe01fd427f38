"""The training loop: draw, denoise, step, average, check, save."""

from __future__ import annotations

import dataclasses
import logging
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import psutil
import torch

from megrasp_core.diffusion import NoiseSchedule
from megrasp_core.drawing.training_curves import append_losses, plot_curves
from megrasp_core.errors import DataError, TrainingError
from megrasp_core.grippers import is_procedural
from megrasp_core.network import GraspModel, ModelInfo, low_precision_pays, move_to, save_model
from megrasp_core.pointcloud import SceneSettings

from .batching import SceneSource
from .checkpoint import CheckpointState, load_checkpoint, save_checkpoint
from .config import Counters, TrainConfig, rate_factor
from .job import TrainingJob
from .losses import scene_losses
from .processes import Team
from .rack import GripperRack
from .scenes import TrainingEntry, divided, read_entries, scene_keys, without_objects
from .validation import validate, validation_pairs

_log = logging.getLogger(__name__)

MOST_SKIPPED = 50
"""Steps in a row without a finite gradient after which a run gives up."""

Progress = Callable[["TrainingRun", dict[str, float]], None]


class TrainingRun:
    """State of one training run in one process."""

    def __init__(
        self,
        job: TrainingJob,
        config: TrainConfig,
        team: Team | None = None,
        start_from: GraspModel | None = None,
    ) -> None:
        self.job, self.config, self.team = job, config, team or Team()
        torch.manual_seed(config.seed)
        self.model = GraspModel(config.network, model_id=config.model_id)
        self.facts: dict[str, Any] = {}
        if start_from is not None:
            self.model.load_state_dict(start_from.state_dict())
            self.facts = {"started_from": start_from.info.as_start()}
        move_to(self.model, job.device)
        self.model.low_precision = low_precision_pays(job.device)
        if job.compiled:
            self.model.use_kernels()
        if config.heads_only:
            for name, parameter in self.model.named_parameters():
                parameter.requires_grad_(name.startswith(("confidence", "graspability")))
        self.ema = {k: v.detach().clone() for k, v in self.model.state_dict().items()}
        self.trained = [p for p in self.model.parameters() if p.requires_grad]
        self.optimiser = torch.optim.AdamW(
            self.trained,
            lr=config.learning_rate,
            weight_decay=config.weight_decay,
            betas=(0.9, 0.99),
            fused=True,
        )
        self.counters = Counters()
        self.schedule = NoiseSchedule.of(config.network)
        self.settings = SceneSettings()
        self.rack = GripperRack(config.network.gripper_tokens)
        self.hashes = {name: self.rack.gripper(name).hash for name in config.grippers}
        self.averages: dict[str, float] = {}
        self._skipped = 0
        self.pairs: tuple[tuple[str, str], ...] = ()
        self.validation: dict[str, TrainingEntry] = {}
        self._entries: dict[str, TrainingEntry] = {}
        self._held_out: dict[str, TrainingEntry] = {}
        self._source: SceneSource | None = None

    @property
    def source(self) -> SceneSource:
        """What is drawn from."""
        if self._source is None:
            self.read()
        assert self._source is not None
        return self._source

    @property
    def scenes(self) -> int:
        """How many scenes the data holds."""
        return len(self._entries)

    def resume(self) -> None:
        """Go on from the checkpoint; how much is planned may have changed."""
        state = load_checkpoint(self.job.out, self.model, self.ema, self.optimiser)
        if state.own_validation != bool(self.job.validation):
            before, now = (
                "with" if own else "without"
                for own in (state.own_validation, bool(self.job.validation))
            )
            raise DataError(
                f"the run in {self.job.out} was begun {before} scenes of its own for validation "
                f"and is resumed {now}; expected the same, or it would train with what it "
                "validates on. Give the same --validation."
            )
        changed = sorted(n for n, h in state.hashes.items() if self.hashes.get(n) != h)
        if changed:
            _log.warning(
                "the descriptions of %s have changed since the run was begun; the model will be "
                "listed as trained for them as they were",
                ", ".join(changed),
            )
        self.hashes = state.hashes
        self.counters, self.pairs, self.facts = state.counters, state.validation, state.facts

    def read(self) -> None:
        """Read the data.

        Raises:
            DataError: fewer than two scenes with anything to learn, an object that trains and
                validates, or nothing left of what validated before.
        """
        # All processes must see the same scenes, however fast the data grows.
        self._take(self.team.told(scene_keys(self.job.data)))
        if self.pairs and not any(key in self.validation for key, _ in self.pairs):
            raise DataError(
                f"none of the {len(self.pairs)} pairs of scene and gripper that validated when "
                f"the run was begun, {self.pairs[0]} for one, is in the data; expected the same "
                "data sets in the same order, grown at most. Give --data and --validation as "
                "before."
            )
        if not self.pairs:
            self.pairs = validation_pairs(list(self.validation.values()), self.config)

    def read_again(self) -> None:
        """Take in what has come to the data; when it cannot be read, go on with what there is."""
        keys: list[str] = []
        if self.team.leads:
            try:
                keys = scene_keys(self.job.data)
            except (DataError, OSError) as error:
                _log.warning("the data was not read again: %s", error)
        keys = self.team.told(keys)
        if not keys or keys == list(self._entries):
            return
        before = self._entries, self._source, self.validation
        try:
            self._take(keys)
        except (DataError, OSError) as error:
            if self.team.size > 1:
                raise
            self._entries, self._source, self.validation = before
            _log.warning("what came to the data is left out: %s", error)

    def _take(self, keys: list[str]) -> None:
        job = self.job
        self._entries = read_entries(job.data, self._entries, keys=keys)
        if job.validation:
            if not self._held_out:
                self._held_out = read_entries(job.validation)
            division = without_objects(self._entries.values(), self._held_out.values())
        else:
            division = divided(self._entries.values())
        grippers = {name for entry in division.train for name in entry.tables}
        hands = {name for name in grippers & set(self.config.grippers) if self.rack.is_hand(name)}
        source = SceneSource(division.train, self.config, self.settings, frozenset(hands))
        if len(self._entries) < 2 or not source.pools:
            raise DataError(
                f"{', '.join(map(str, job.data))}: {len(self._entries)} scenes, with "
                f"{'grasps' if source.pools else 'no grasp'} of the grippers "
                f"{', '.join(self.config.grippers)}; expected at least 2 scenes with grasps. Make "
                "some with `megrasp data scenes --out DIR`."
            )
        self._source = source
        self.validation = {entry.key: entry for entry in division.validation}

    def go_on(self, stopped: Callable[[], bool], on_progress: Progress | None) -> None:
        """Train until the plan or the stretch is over, or somebody wants to stop."""
        began = last_save = time.monotonic()
        self.counters.stretches += 1
        seconds = self.job.seconds
        while self.counters.progress(self.config) < 1.0:
            over = seconds is not None and time.monotonic() - began > seconds
            losses, stop = self.step(stop=over or stopped())
            if on_progress is not None:
                on_progress(self, losses)
            if stop:
                return
            due = time.monotonic() - last_save > self.config.checkpoint_seconds
            if self.team.told(["save"] if due else []):
                if self.team.leads:
                    self.save()
                self.read_again()
                last_save = time.monotonic()

    def step(self, *, stop: bool = False) -> tuple[dict[str, float], bool]:
        """One optimiser step; also says whether any process wants to stop after it.

        The scenes of a step, their poses and their noise depend on the data, the seed, the step
        and the place in the step: neither on how many processes share them nor on when the run
        was resumed.
        """
        began, cpu = time.monotonic(), time.process_time()
        config, counters = self.config, self.counters
        self.model.train()
        for group in self.optimiser.param_groups:
            group["lr"] = config.learning_rate * rate_factor(counters, config)
        self.optimiser.zero_grad(set_to_none=True)
        confidence = counters.steps % config.confidence_every == 0 or config.heads_only
        parts: list[dict[str, float]] = []
        noisy = labelled = 0
        for slot in self.team.slots(config.scenes_per_step):
            rng = np.random.default_rng([config.seed, counters.steps, slot])
            batch = self.source.draw(rng, confidence=confidence)
            generator = torch.Generator(self.job.device).manual_seed(int(rng.integers(2**62)))
            names = batch.grippers
            codes = self.model.encode_grippers([self.rack.tokens(name, rng) for name in names])
            losses = scene_losses(
                self.model,
                dict(zip(names, codes, strict=True)),
                batch,
                config,
                self.schedule,
                generator,
                {name: self.rack.fold(name) for name in names},
            )
            (losses.total / config.scenes_per_step).backward()
            parts.append(losses.values)
            noisy, labelled = noisy + batch.noisy_poses, labelled + batch.labelled_poses
        used = time.process_time() - cpu
        numbers = torch.tensor(
            [noisy, labelled, len(parts), used, float(stop)], dtype=torch.float64
        )
        numbers = self.team.add_up(self.trained, numbers)
        noisy, labelled, scenes, used, stop_votes = numbers.tolist()
        cpu = time.process_time()
        norm = torch.nn.utils.clip_grad_norm_(self.trained, config.gradient_clip)
        counters.steps += 1
        counters.seconds += time.monotonic() - began
        if torch.isfinite(norm):
            self.optimiser.step()
            self._average()
            counters.poses += int(noisy)
            counters.labelled_poses += int(labelled)
            counters.scenes += int(scenes)
            self._skipped = 0
        else:
            counters.skipped += 1
            self._skipped += 1
            if self._skipped >= MOST_SKIPPED:
                raise TrainingError(
                    f"the gradient has been no finite number for {MOST_SKIPPED} steps; expected "
                    "that of a model that learns. Go on from the last checkpoint with a lower "
                    "learning_rate, or look for broken scenes with `megrasp data verify`."
                )
        counters.cpu_seconds += used + (time.process_time() - cpu) * self.team.size
        found = {name for part in parts for name in part}
        values = {k: float(np.mean([part[k] for part in parts if k in part])) for k in found}
        for name, value in values.items():
            if np.isfinite(value):
                self.averages[name] = 0.98 * self.averages.get(name, value) + 0.02 * value
        return values, stop_votes > 0

    @torch.no_grad()
    def _average(self) -> None:
        steps = self.counters.steps
        decay = min(self.config.ema_decay, (1 + steps) / (10 + steps))
        weights = self.model.state_dict()
        for name, average in self.ema.items():
            average.lerp_(weights[name], 1.0 - decay)

    def averaged(self) -> GraspModel:
        """A copy of the model with averaged weights."""
        model = GraspModel(self.config.network, model_id=self.config.model_id)
        model.load_state_dict({k: v.cpu() for k, v in self.ema.items()})
        model.low_precision = self.model.low_precision
        model.info = self._info()
        return model.to(self.job.device).eval().requires_grad_(False)

    def save(self) -> None:
        """Checkpoint, averaged model, loss line and curves."""
        out = self.job.out
        state = CheckpointState(
            self.config,
            self.counters,
            self.pairs,
            own_validation=bool(self.job.validation),
            hashes=self.hashes,
            facts=self.facts,
        )
        save_checkpoint(out, self.model, self.ema, self.optimiser, state)
        model = self.averaged()
        result = validate(
            model,
            self.validation,
            self.pairs,
            {name: self.rack.tokens(name) for _, name in self.pairs},
            self.config,
            self.settings,
            self.schedule,
            {name: self.rack.fold(name) for _, name in self.pairs},
        )
        line = {
            **dataclasses.asdict(self.counters),
            **_rounded("train_", self.averages),
            **_rounded("validation_", result.losses),
            "per_gripper": _rounded("", result.per_gripper),
            "per_band": _rounded("", result.per_band),
            "data_scenes": self.scenes,
            "memory_mb": round(psutil.Process().memory_info().rss / 1e6),
        }
        append_losses(out / "losses.jsonl", line)
        plot_curves(out / "losses.jsonl", out / "losses.png")
        save_model(model, out / "model")

    def _info(self) -> ModelInfo:
        """What `config.json` of the model says of it."""
        weights = {
            "confidence": self.config.confidence_weight,
            "graspability": self.config.graspability_weight,
        }
        heads = {name for name, weight in weights.items() if weight > 0}
        before = self.facts.get("started_from", {})
        return ModelInfo(
            network=self.config.network,
            model_id=self.config.model_id,
            heads=tuple(sorted(heads | set(before.get("heads", ())))),
            sampler=self.config.sampler,
            scene=self.settings,
            low_precision=True,
            trained_grippers=self.hashes,
            procedural_grippers=sum(is_procedural(name) for name in self.source.grippers),
            data_scenes=self.scenes,
            counters=dataclasses.asdict(self.counters),
            training=self.config.to_dict(),
            started_from=before,
        )


def _rounded(prefix: str, values: dict[str, float]) -> dict[str, float]:
    return {prefix + name: round(value, 5) for name, value in values.items()}
