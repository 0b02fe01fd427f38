"""`megrasp train`."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from megrasp_core.errors import InvalidRequestError

from .common import Flag, changed, progress_bar, say

if TYPE_CHECKING:
    from tqdm import tqdm

    from megrasp_core.network import GraspModel
    from megrasp_core.training import TrainConfig, TrainingRun

__all__ = ["train"]

Settings = Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE [NAME=VALUE ...]")]


def train(
    out: Path,
    data: tuple[Path, ...] = (),
    attempts: Path | None = None,
    resume: Flag = False,
    validation: tuple[Path, ...] = (),
    device: str = "cpu",
    processes: int = 1,
    compiled: Flag = False,
    minutes: float | None = None,
    total_poses: int | None = None,
    preset: Literal["tiny", "small", "base"] = "small",
    network: Settings = (),
    settings: Annotated[Settings, tyro.conf.arg(name="set")] = (),
    model_id: str | None = None,
    gripper: tuple[str, ...] = (),
    start_from: str | None = None,
    heads_of: str | None = None,
    seed: int = 1,
) -> int:
    """Train a model, or go on training it.

    SIGTERM, Ctrl-C or the end of --minutes saves a checkpoint and leaves with exit code 0; with
    --resume the run goes on, here or on another machine, with everything that it was begun with.

    Try:
      megrasp train --data data/scenes --out runs/small --total-poses 3_000_000
      megrasp train --data data/scenes --out runs/small --resume --minutes 170
      megrasp train --data data/scenes --out runs/fine --network fine_neighbours=24 s_min=0.015
      megrasp train --data scenes.mgpack --out runs/small --device cuda
      torchrun --nproc-per-node 4 -m megrasp_core train --data data/scenes --out runs/small \
        --set scenes_per_step=4
      megrasp train --start-from megrasp-base --model-id mine --data data/mine --out runs/mine \
        --gripper robotiq_2f85 --total-poses 500_000 --set learning_rate=3e-4
      megrasp train --heads-of megrasp-bin --attempts attempts --data samples --out runs/heads

    Args:
        out: checkpoint, loss curves and the averaged model.
        data: folders of `data scenes`, or device packs of `data pack`; a folder that still grows
            is read again.
        attempts: folder that a real cell recorded into (docs/attempts.md); its grasps are added
            to those of --data, for the heads alone.
        resume: go on from the checkpoint in `out`; of the other options only data, validation,
            device, processes, compiled, minutes and total poses count.
        validation: scenes of objects that training never sees; without them a tenth of the
            objects is held out.
        device: cpu or cuda.
        processes: that share the work, one thread each; a launcher of processes, such as
            torchrun, is obeyed without it.
        compiled: use compiled kernels, which are faster; they need the extra `kernels` (numba).
        minutes: end of this stretch; without, the plan is trained to its end.
        total_poses: noisy poses of the whole plan, which the learning rate follows; by default
            three million, with --resume as before.
        preset: size of the network.
        network: changes to the preset, by the names of `ModelConfig`.
        settings: further settings, by the names of `TrainConfig`.
        model_id: by default megrasp- and the preset, or that of the model it starts from.
        gripper: names of the grippers to learn; by default all that are meant for training.
            Procedural grippers in the data are always learnt.
        start_from: id or folder of a model whose weights, network and sampler the run begins
            with; with a tenth to a third of the usual learning rate it keeps what it knows.
        heads_of: id or folder of a model of which only the confidence is trained.
        seed: of weights, scenes and noise.
    """
    import torch

    from megrasp_core.network import load_model
    from megrasp_core.training import GRIPPERS, Team, TrainingJob, resume_training
    from megrasp_core.training import train as begin_training
    from megrasp_core.training.checkpoint import TENSORS as CHECKPOINT

    place = Team.launched(os.environ)
    leads = place is None or place.leads
    if attempts is not None:
        if heads_of is None and not resume:
            raise InvalidRequestError(
                "--attempts was given without --heads-of; expected the model whose confidence "
                "learns from them. Attempts say nothing of where all grasps are."
            )
        if place is not None:
            raise InvalidRequestError(
                "--attempts was given under torchrun; expected one process, which suffices for "
                "the heads."
            )
        scenes, recorded = _attempt_scenes(attempts, out)
        data = (*data, scenes)
        if not resume and not gripper:
            gripper = tuple(dict.fromkeys((*GRIPPERS, *recorded)))
    if not data:
        raise InvalidRequestError(
            "no --data was given; expected folders of scenes, or device packs."
        )
    job = TrainingJob(
        data=tuple(data),
        out=out,
        validation=tuple(validation),
        device=device,
        processes=processes,
        seconds=None if minutes is None else 60.0 * minutes,
        compiled=compiled,
        place=place,
    )
    # More threads than one wait for each other on a busy machine; processes do not.
    torch.set_num_threads(1)
    given = {"--network": network, "--set": settings, "--gripper": gripper,
             "--start-from": start_from, "--heads-of": heads_of,
             "--model-id": model_id}  # fmt: skip
    if resume and any(given.values()):
        raise InvalidRequestError(
            f"{', '.join(name for name in given if given[name])} was given with --resume; "
            "expected nothing that changes the run, which goes on as it was begun. Leave it out, "
            "or begin a new run."
        )
    starts = [name for name in ("--start-from", "--heads-of") if given[name]]
    if len(starts) + bool(network) > 1:
        raise InvalidRequestError(
            f"{' and '.join(starts + ['--network'] * bool(network))} were given; expected one of "
            "them, since a model that a run starts from brings its network."
        )
    with progress_bar(1000, "train") as bar:
        if resume:
            resume_training(job, total_poses=total_poses, on_progress=_Display(bar))
        else:
            if leads and (out / CHECKPOINT).exists():
                raise InvalidRequestError(
                    f"{out} holds a run already; expected --resume to go on with it, or another "
                    "--out."
                )
            start = load_model(given[starts[0]]) if starts else None
            config = _config(
                preset, start, heads_of is not None, network, settings, model_id, gripper,
                total_poses, seed,
            )  # fmt: skip
            begin_training(job, config, start_from=start, on_progress=_Display(bar))
    if leads:
        say(f"wrote checkpoint and model to {out}; --resume goes on from there")
    return 0


def _attempt_scenes(attempts: Path, out: Path) -> tuple[Path, list[str]]:
    """Folder with the attempts as scenes, brought up to date, and their grippers."""
    from megrasp_core.evaluation.attempts import require_enough
    from megrasp_core.self_labelling.attempts import write_attempt_scenes
    from megrasp_core.storage import AttemptFolder

    notes: list[str] = []
    folder = out / "attempts"
    found = AttemptFolder(attempts).read_all(notes)
    success, grippers = write_attempt_scenes(found, folder, notes)
    for note in notes:
        say(note)
    require_enough(success, "training")
    say(f"{len(success)} attempts, {int(success.sum())} of them successes")
    return folder, grippers


class _Display:
    """Progress as a bar, or as a line a minute where there is no terminal."""

    def __init__(self, bar: tqdm) -> None:
        self._bar = bar
        self._last = time.monotonic()
        self._begun = False

    def __call__(self, run: TrainingRun, losses: dict[str, float]) -> None:
        counters = run.counters
        if not self._begun:
            self._begun = True
            weights = sum(p.numel() for p in run.model.parameters())
            say(
                f"{run.scenes} scenes, {len(run.source.grippers)} grippers, "
                f"{len(run.pairs)} pairs of scene and gripper for validation, "
                f"{weights / 1e6:.2f} million parameters"
            )
        self._bar.n = int(1000 * counters.progress(run.config))
        self._bar.set_postfix({k: f"{v:.3f}" for k, v in losses.items()}, refresh=False)
        self._bar.refresh()
        if self._bar.disable and time.monotonic() - self._last > 60:
            self._last = time.monotonic()
            values = ", ".join(f"{k} {v:.3f}" for k, v in sorted(run.averages.items()))
            say(
                f"step {counters.steps}, {counters.planned(run.config)} of "
                f"{run.config.total_poses} poses, {counters.cpu_seconds:.0f} CPU-s: {values}"
            )


def _config(
    preset: str,
    start: GraspModel | None,
    heads_only: bool,
    network: tuple[str, ...],
    settings: tuple[str, ...],
    model_id: str | None,
    gripper: tuple[str, ...],
    total_poses: int | None,
    seed: int,
) -> TrainConfig:
    from megrasp_core.network import PRESETS
    from megrasp_core.training import TrainConfig

    config = TrainConfig(
        network=changed(PRESETS[preset], network, "--network"),
        model_id=model_id or f"megrasp-{preset}",
        seed=seed,
    )
    if start is not None:
        config = replace(
            config,
            network=start.config,
            model_id=model_id or start.model_id,
            sampler=start.info.sampler,
        )
    if heads_only:
        # The samples of a model say nothing of where all grasps are.
        config = replace(
            config, train_only="heads", graspability_weight=0.0, confidence_weight=1.0
        )
    if gripper:
        config = replace(config, grippers=tuple(gripper))
    if total_poses is not None:
        config = replace(config, total_poses=total_poses)
    config = changed(config, settings, "--set")
    if config.heads_only and not heads_only:
        raise InvalidRequestError(
            "train_only=heads was given without --heads-of; expected the model whose heads are "
            "trained."
        )
    return config
