"""Few-shot fine-tuning: a model learns a gripper from a handful of grasps and forgets no other.

Only the gripper encoder learns. What the scene encoder and the decoder know of surfaces and
grasps stays; what changes is how the new gripper is described to them. The codes of all other
grippers are held where they were, which needs their descriptions and no data. The network is
equivariant, so that turned copies of a scene would teach nothing; other choices of nodes, noise on
points, other samplings of the gripper's surface and its symmetric copies do.
"""

from __future__ import annotations

import copy
import dataclasses
import logging
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from megrasp_core.diffusion import NoiseSchedule, perturb
from megrasp_core.errors import InvalidRequestError, MegraspError, TrainingError
from megrasp_core.grippers import (
    Gripper,
    GripperTokens,
    cad_folders,
    gripper_folders,
    load_gripper,
    procedural_rack,
)
from megrasp_core.lie import PoseBatch, so3
from megrasp_core.network import GraspModel, GripperCode, SceneField
from megrasp_core.pointcloud import scene_nodes
from megrasp_core.ranges import COUNT, FROM_ONE, LENGTH, POSITIVE, WEIGHT, Range, check_ranges

from .batching import varied
from .given_grasps import GivenScene
from .losses import denoising
from .processes import tuned_process
from .rack import TOKEN_SEEDS
from .validation import BANDS

_log = logging.getLogger(__name__)

FEW = 3
"""Below so many grasps nothing can be left out to see what the others teach."""

SURE = 2.0
"""So many standard errors must be gained."""
PROCEDURAL_OTHERS = 8
"""Grippers of the procedural family whose codes are held, beside all that are registered."""

Progress = Callable[[int, int], None]
"""(steps done, steps in all)."""
States = dict[str, Tensor]


@dataclasses.dataclass(frozen=True)
class FinetuneConfig:
    """How a gripper is learnt."""

    steps: int = 90
    """Most steps; how many are taken is decided on grasps left out."""
    check_every: int = 15
    """Steps between two looks at the grasps left out."""
    folds: int = 5
    """Parts into which the grasps are divided; each is left out once."""
    learning_rate: float = 2e-3
    """Of AdamW, after `warmup_steps`."""
    warmup_steps: int = 10
    """Steps in which the learning rate rises from 0."""
    ema_decay: float = 0.95
    """Decay a step of the averaged weights, which are the model that comes out."""
    gradient_clip: float = 1.0
    """Longest gradient."""
    scenes_per_step: int = 2
    """Scenes whose gradients are averaged in a step."""
    poses_per_scene: int = 48
    """Noisy copies of the given grasp, a scene and step."""
    score_weight: float = 0.1
    """Weight of the rotation score's loss."""
    keep_weight: float = 10.0
    """Weight of what holds the codes of other grippers, in units of their variance."""
    head_weight: float = 0.01
    """Weight of what holds confidence and graspability of the new gripper, in logits squared."""
    head_poses: int = 16
    """Poses at which the confidence is held, a scene and step."""
    node_sets: int = 3
    """Choices of nodes of every scene."""
    point_jitter: float = 0.0005
    """Standard deviation (m) of noise on the points of all but the first."""
    validation_poses: int = 96
    """Noisy copies of each grasp that is left out."""
    seed: int = 1
    """Of everything drawn."""

    def __post_init__(self) -> None:
        check_ranges(
            self,
            steps=FROM_ONE,
            check_every=FROM_ONE,
            folds=Range(2, whole=True),
            learning_rate=POSITIVE,
            warmup_steps=FROM_ONE,
            ema_decay=Range(0, below=1),
            gradient_clip=POSITIVE,
            scenes_per_step=FROM_ONE,
            poses_per_scene=FROM_ONE,
            score_weight=WEIGHT,
            keep_weight=WEIGHT,
            head_weight=WEIGHT,
            head_poses=FROM_ONE,
            node_sets=FROM_ONE,
            point_jitter=LENGTH,
            validation_poses=FROM_ONE,
            seed=COUNT,
        )


@dataclasses.dataclass(frozen=True)
class FinetuneResult:
    """What came of it.

    Attributes:
        model: the new one; None where the grasps left out say that nothing is gained.
        steps: of the new model, or the best that there were.
        before: diffusion loss of grasps left out, by band of noise, with the parent.
        after: the same after these steps on the other grasps.
        gain: mean over the grasps of their loss before less that after, and
        gain_error: its standard error.
        curve: (steps, gain) of every number of steps that was looked at. It and the four before
            are empty or not a number where there were too few grasps to leave any out.
        others: root mean square by which the codes of other grippers moved, in standard
            deviations of codes; of the one that moved farthest.
    """

    model: GraspModel | None
    steps: int
    before: dict[str, float]
    after: dict[str, float]
    gain: float
    gain_error: float
    curve: tuple[tuple[int, float], ...]
    others: float

    def facts(self) -> dict[str, Any]:
        """As JSON."""
        facts: dict[str, Any] = {"steps": self.steps}
        if self.curve:
            facts["left_out"] = {
                "before": _rounded(self.before),
                "after": _rounded(self.after),
                "gain": round(self.gain, 5),
                "gain_error": round(self.gain_error, 5),
                "curve": [[steps, round(gain, 5)] for steps, gain in self.curve],
            }
        if self.model is not None:
            facts["others_moved"] = round(self.others, 5)
        return facts


def finetune(
    parent: GraspModel,
    gripper: Gripper,
    scenes: Sequence[GivenScene],
    config: FinetuneConfig | None = None,
    *,
    steps: int | None = None,
    on_progress: Progress | None = None,
) -> FinetuneResult:
    """Learn a gripper from a few grasps.

    How many steps are taken is decided by cross-validation: each grasp is left out once, and what
    the others teach must lower its loss by more than `SURE` standard errors.

    Args:
        parent: to begin with; not changed.
        gripper: a new one, or one that the parent knows.
        scenes: of `given_scene`, with a grasp each.
        config: see `FinetuneConfig`.
        steps: take so many, whatever the grasps left out say.
        on_progress: called after every step.

    Raises:
        InvalidRequestError: no grasps, or fewer than `FEW` and no number of steps.
        TrainingError: a gradient is no finite number.
    """
    config = config or FinetuneConfig()
    if not scenes or (len(scenes) < FEW and steps is None):
        raise InvalidRequestError(
            f"{len(scenes)} grasps were given; expected at least {FEW}, so that some can be left "
            "out to see whether the others teach anything. Give more, or say how many steps to "
            "take all the same."
        )
    if steps is not None and steps < 1:
        raise InvalidRequestError(f"{steps} steps were asked for; expected at least 1.")
    with tuned_process():
        return _Tuning(parent, gripper, scenes, config).run(steps, on_progress)


@dataclasses.dataclass(frozen=True, eq=False)
class _View:
    """A scene with one choice of nodes, and what the parent says of the new gripper in it.

    Attributes:
        field: the scene, encoded.
        copies: (n,) the given grasp and its symmetric copies, scene_from_tcp.
        graspability: `(n_1,)` logits; None without that head.
    """

    field: SceneField
    copies: PoseBatch
    graspability: Tensor | None


class _Tuning:
    """Everything that several runs on the same scenes share.

    The scene encoder is frozen, so that scenes are encoded once.
    """

    def __init__(
        self,
        parent: GraspModel,
        gripper: Gripper,
        scenes: Sequence[GivenScene],
        config: FinetuneConfig,
    ) -> None:
        self.config, self.scenes = config, scenes
        self.parent = copy.deepcopy(parent).eval().requires_grad_(False)
        # Small steps would be lost in numbers of sixteen bits.
        self.parent.low_precision = False
        self.model = copy.deepcopy(self.parent)
        self.start = _copied(self.model.gripper_encoder.state_dict())
        self.schedule = NoiseSchedule.of(parent.config)
        self.bands = {name: band for name, band in BANDS.items() if band[1] > self.schedule.s_min}
        self.fold = max(1, int(gripper.description.symmetry))
        self.nearest = bool(parent.info.training.get("nearest_copy", False))
        count = parent.config.gripper_tokens
        self.own = [gripper.tokens(count, seed=seed) for seed in range(TOKEN_SEEDS)]
        with torch.no_grad():
            self.own_codes = self.parent.encode_grippers(self.own)
            self.others = self._told_apart(_other_tokens(gripper, count))
            self.held = _stacked(self.parent.encode_grippers(self.others))
            self.variance = self.held.var(0).mean().clamp(min=1e-6)
            self.views = [[self._view(s, n) for n in range(config.node_sets)] for s in scenes]

    def _told_apart(self, others: dict[str, GripperTokens]) -> list[GripperTokens]:
        """Those that are not the same gripper from another model file: their codes differ from the
        gripper's by more than other samplings of its own surface do.
        """
        own = _stacked(self.own_codes).mean(1)
        same = float((own - own[0]).norm(dim=-1).max())
        codes = _stacked(self.parent.encode_grippers(list(others.values()))).mean(1)
        distances = (codes - own[0]).norm(dim=-1).tolist()
        twins = [name for name, far in zip(others, distances, strict=True) if far <= same]
        if twins:
            _log.warning("%s looks the same to the model and changes with it", ", ".join(twins))
        return [tokens for name, tokens in others.items() if name not in twins]

    def _view(self, scene: GivenScene, which: int) -> _View:
        nodes = scene_nodes(scene.seen.surface, self.parent.info.scene, which)
        if which:
            rng = np.random.default_rng([self.config.seed, which])
            nodes = varied(nodes, rng, jitter=self.config.point_jitter, drop_gravity=False)
        field = self.parent.encode_scene(nodes)
        turns = torch.zeros(self.fold, 3, dtype=torch.float64)
        turns[:, 2] = torch.arange(self.fold) * (2.0 * math.pi / self.fold)
        rotation = torch.from_numpy(scene.world_from_tcp[:3, :3]) @ so3.exp(turns)
        place = torch.from_numpy(scene.world_from_tcp[:3, 3] - nodes.centroid)
        copies = PoseBatch(
            rotation.to(field.gravity), place.to(field.gravity).expand(self.fold, -1)
        )
        known = "graspability" in self.parent.info.heads
        said = self.parent.graspability(field, self.own_codes[0]) if known else None
        return _View(field, copies, said)

    def run(self, steps: int | None, on_progress: Progress | None) -> FinetuneResult:
        config, every = self.config, np.arange(len(self.scenes))
        parts: list[NDArray[np.intp]] = []
        if len(every) >= FEW:
            order = np.random.default_rng(config.seed).permutation(every)
            parts = np.array_split(order, min(config.folds, len(every)))
        most = config.steps if steps is None else steps
        looks = sorted({*range(config.check_every, most, config.check_every), most})
        total, done = (len(parts) + 1) * most, 0

        def tell() -> None:
            nonlocal done
            done += 1
            if on_progress is not None:
                on_progress(done, total)

        before = self._losses(self.start, every)
        after = {look: np.full_like(before, np.nan) for look in looks}
        for number, left_out in enumerate(parts, start=1):
            states = self._train(np.setdiff1d(every, left_out), looks, number, tell)
            for look, state in states.items():
                after[look][left_out] = self._losses(state, left_out)
        gains = {look: (before - rows).mean(1) for look, rows in after.items()}
        chosen = max(looks, key=lambda look: gains[look].mean()) if steps is None else steps
        gain = float(gains[chosen].mean())
        error = float(gains[chosen].std(ddof=1) / math.sqrt(len(every))) if parts else math.nan
        model, others = None, 0.0
        # Less than that is what chance does, the more so as the best of several looks is taken.
        if steps is not None or gain > SURE * error:
            state = self._train(every, [chosen], 0, tell)[chosen]
            others = self._moved(state)
            model = copy.deepcopy(self.parent)
            model.gripper_encoder.load_state_dict(state)
        return FinetuneResult(
            model,
            chosen,
            self._by_band(before) if parts else {},
            self._by_band(after[chosen]) if parts else {},
            gain,
            error,
            tuple((look, float(gains[look].mean())) for look in looks) if parts else (),
            others,
        )

    def _train(
        self, rows: NDArray[np.intp], looks: Sequence[int], number: int, tell: Callable[[], None]
    ) -> dict[int, States]:
        """Averaged weights of the gripper encoder after the given numbers of steps."""
        config, encoder = self.config, self.model.gripper_encoder
        encoder.load_state_dict(self.start)
        encoder.requires_grad_(True)
        trained = list(encoder.parameters())
        optimiser = torch.optim.AdamW(
            trained, lr=config.learning_rate, weight_decay=0.0, betas=(0.9, 0.99)
        )
        average, found = _copied(self.start), {}
        for step in range(1, max(looks) + 1):
            rng = np.random.default_rng([config.seed, number, step])
            generator = torch.Generator(self.model.device).manual_seed(int(rng.integers(2**62)))
            for group in optimiser.param_groups:
                group["lr"] = config.learning_rate * min(1.0, step / config.warmup_steps)
            optimiser.zero_grad(set_to_none=True)
            self._loss(rows, rng, generator).backward()
            norm = torch.nn.utils.clip_grad_norm_(trained, config.gradient_clip)
            if not torch.isfinite(norm):
                raise TrainingError(
                    f"the gradient of step {step} is no finite number; expected that of a model "
                    "that learns. Try a lower learning rate, and look at the clouds."
                )
            optimiser.step()
            decay = min(config.ema_decay, (1 + step) / (10 + step))
            for name, value in encoder.state_dict().items():
                average[name].lerp_(value, 1.0 - decay)
            if step in looks:
                found[step] = _copied(average)
            tell()
        encoder.requires_grad_(False)
        return found

    def _loss(
        self, rows: NDArray[np.intp], rng: np.random.Generator, generator: torch.Generator
    ) -> Tensor:
        config, model = self.config, self.model
        which = int(rng.integers(len(self.own)))
        code, *others = model.encode_grippers([self.own[which], *self.others])
        moved = (_stacked(others) - self.held).square().mean() / self.variance
        parts = [config.keep_weight * moved]
        # Every scene before any of them twice.
        for row in np.resize(rng.permutation(rows), config.scenes_per_step):
            view = self.views[int(row)][int(rng.integers(config.node_sets))]
            parts.append(self._scene_loss(view, code, which, rng, generator))
        return parts[0] + torch.stack(parts[1:]).mean()

    def _scene_loss(
        self,
        view: _View,
        code: GripperCode,
        which: int,
        rng: np.random.Generator,
        generator: torch.Generator,
    ) -> Tensor:
        config, model, parent = self.config, self.model, self.parent
        errors = self._denoising(view, code, config.poses_per_scene, rng, generator)[1:]
        loss = errors[0].mean() + config.score_weight * errors[1].mean()
        before = self.own_codes[which]
        if "confidence" in parent.info.heads:
            level = self.schedule.random_levels(config.head_poses, generator, device=model.device)
            picked = view.copies.part(rng.integers(self.fold, size=config.head_poses).tolist())
            poses = perturb(picked, level, self.schedule, generator)
            with torch.no_grad():
                said = parent.confidence(view.field, before, poses)
            says = model.confidence(view.field, code, poses)
            loss = loss + config.head_weight * (says - said).square().mean()
        if view.graspability is not None:
            says = model.graspability(view.field, code)
            loss = loss + config.head_weight * (says - view.graspability).square().mean()
        return loss

    def _denoising(
        self,
        view: _View,
        code: GripperCode,
        count: int,
        rng: np.random.Generator,
        generator: torch.Generator,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Levels, and errors of residual and score, of noisy copies of the given grasp."""
        device = self.model.device
        level = self.schedule.random_levels(count, generator, device=device)
        copies = view.copies.part(rng.integers(self.fold, size=count).tolist())
        fold = torch.full((count,), self.fold, device=device) if self.nearest else None
        found = denoising(
            self.model, view.field, code, copies, level, self.schedule, generator, fold
        )
        return level, found.residual, found.score

    @torch.no_grad()
    def _losses(self, state: States, rows: NDArray[np.intp]) -> NDArray[np.float64]:
        """Diffusion loss of some grasps (R, bands), with the same noise every time."""
        encoder = self.model.gripper_encoder
        encoder.load_state_dict(state)
        code = self.model.encode_gripper(self.own[0])
        losses = []
        for row in rows.tolist():
            rng = np.random.default_rng([self.config.seed, row])
            generator = torch.Generator(self.model.device).manual_seed(row)
            level, error, _ = self._denoising(
                self.views[row][0], code, self.config.validation_poses, rng, generator
            )
            inside = [(level > low) & (level <= high) for low, high in self.bands.values()]
            losses.append([float(error[band].mean()) for band in inside])
        return np.array(losses)

    def _by_band(self, losses: NDArray[np.float64]) -> dict[str, float]:
        return dict(zip(self.bands, losses.mean(0).tolist(), strict=True))

    @torch.no_grad()
    def _moved(self, state: States) -> float:
        self.model.gripper_encoder.load_state_dict(state)
        codes = _stacked(self.model.encode_grippers(self.others))
        squares = (codes - self.held).square().mean((1, 2)) / self.variance
        return float(squares.max().sqrt())


def _other_tokens(gripper: Gripper, count: int) -> dict[str, GripperTokens]:
    """Of all registered grippers but this one and CAD twins, and of some of the procedural
    family.
    """
    tokens: dict[str, GripperTokens] = {}
    own = set(gripper_folders()) - set(cad_folders())
    for name in [*sorted(own), *procedural_rack(PROCEDURAL_OTHERS)]:
        try:
            other = load_gripper(name)
        except MegraspError as error:
            _log.warning("%s is not held where it was: %s", name, error)
            continue
        if other.hash != gripper.hash:
            tokens[name] = other.tokens(count, seed=0)
    return tokens


def _stacked(codes: Sequence[GripperCode]) -> Tensor:
    return torch.stack([code.tokens for code in codes])


def _copied(state: Mapping[str, Tensor]) -> States:
    return {name: value.detach().clone() for name, value in state.items()}


def _rounded(values: Mapping[str, float]) -> dict[str, float]:
    return {name: round(value, 5) for name, value in values.items()}
