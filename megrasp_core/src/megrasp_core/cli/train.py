"""`megrasp train`."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from ..errors import InvalidRequestError
from .common import Flag, progress_bar, say

if TYPE_CHECKING:
    from ..training import Counters

__all__ = ["train"]


def train(
    data: tuple[Path, ...],
    out: Path,
    resume: Flag = False,
    device: str = "cpu",
    threads: int | None = None,
    preset: Literal["tiny", "small", "base"] = "small",
    model_id: str | None = None,
    gripper: tuple[str, ...] = ("robotiq_2f85", "franka_hand", "robotiq_3f"),
    minutes: float | None = 60.0,
    poses: int | None = None,
    learning_rate: float = 1e-3,
    scenes_per_step: int = 1,
    poses_per_gripper: int = 128,
    heads_of: str | None = None,
    seed: int = 1,
) -> int:
    """Train a model, or go on training it.

    Try:
      megrasp train --data data/scenes --out runs/small --minutes 120
      megrasp train --data data/scenes --out runs/small --resume --minutes 240
      megrasp train --data scenes.mgpack --out runs/small --device cuda

    Args:
        data: folders of `data scenes`, or device packs of `data pack`; a folder that still grows
            is read again.
        out: checkpoint, loss curves and the averaged model.
        resume: go on from the checkpoint in `out`; everything but the end of the run and the
            device is taken from it.
        device: cpu or cuda.
        threads: torch threads.
        preset: size of the network.
        model_id: by default megrasp- and the preset.
        gripper: names of the grippers to learn.
        minutes: end after so much training time, resumed runs included.
        poses: or after so many noisy poses.
        learning_rate: after the warm-up.
        scenes_per_step: scenes per step.
        poses_per_gripper: noisy poses per gripper, scene and step.
        heads_of: id or folder of a model of which only the confidence is trained.
        seed: of weights, batches and noise.
    """
    if threads is not None and threads < 1:
        raise InvalidRequestError(f"--threads {threads} was given; expected at least 1.")
    import torch

    from ..network import load_model
    from ..training import TrainConfig
    from ..training import train as run_training

    config = TrainConfig(
        preset=preset,
        model_id=model_id or f"megrasp-{preset}",
        grippers=tuple(gripper),
        total_seconds=None if minutes is None else 60.0 * minutes,
        total_poses=poses,
        learning_rate=learning_rate,
        scenes_per_step=scenes_per_step,
        poses_per_gripper=poses_per_gripper,
        train_only="all" if heads_of is None else "heads",
        # The samples of a model say nothing of where all grasps are.
        graspability_weight=0.1 if heads_of is None else 0.0,
        confidence_weight=0.1 if heads_of is None else 1.0,
        seed=seed,
    )
    if threads is not None:
        torch.set_num_threads(threads)
    last = time.monotonic()
    with progress_bar(1000, "train") as bar:

        def tell(counters: Counters, losses: dict[str, float]) -> None:
            nonlocal last
            bar.n = int(1000 * counters.progress(config))
            bar.set_postfix({key: f"{value:.3f}" for key, value in losses.items()}, refresh=False)
            bar.refresh()
            if bar.disable and time.monotonic() - last > 60:
                last = time.monotonic()
                values = ", ".join(f"{key} {value:.3f}" for key, value in losses.items())
                say(
                    f"step {counters.steps}, {counters.poses} poses, {counters.seconds:.0f} s: "
                    f"{values}"
                )

        run_training(
            list(data),
            out,
            config,
            resume=resume,
            start_from=None if heads_of is None else load_model(heads_of),
            device=device,
            on_progress=tell,
        )
    say(f"wrote the model to {out}")
    return 0
