"""Beginning or resuming a run: its processes, its signals, its end."""

from __future__ import annotations

import dataclasses
import multiprocessing
import signal
from collections.abc import Callable
from multiprocessing.process import BaseProcess

import torch

from megrasp_core.errors import InvalidRequestError, TrainingError
from megrasp_core.jobs import StopSignals, deaf_to_ctrl_c
from megrasp_core.network import GraspModel

from .checkpoint import read_state
from .config import TrainConfig
from .job import TrainingJob
from .loop import Progress, TrainingRun
from .processes import PeerLostError, Team, free_port, tuned_process

__all__ = ["resume_training", "train"]


def train(
    job: TrainingJob,
    config: TrainConfig,
    *,
    start_from: GraspModel | None = None,
    on_progress: Progress | None = None,
) -> GraspModel:
    """Begin a run and train until the plan or the stretch is over, or SIGTERM or Ctrl-C comes.

    Args:
        job: where.
        config: what is learnt, and how.
        start_from: weights to begin with (fine-tuning, training of the heads).
        on_progress: called after every step with the run and the losses of the step.

    Returns:
        The model with averaged weights.

    Raises:
        DataError: no scenes.
    """
    return _run(job, config, start_from, False, on_progress)


def resume_training(
    job: TrainingJob,
    *,
    total_poses: int | None = None,
    on_progress: Progress | None = None,
) -> GraspModel:
    """Go on with the run whose checkpoint lies in `job.out`, with the config it was begun with.

    Args:
        job: where.
        total_poses: another length of the plan.
        on_progress: called after every step with the run and the losses of the step.

    Raises:
        DataError: no checkpoint to resume, or no scenes.
    """
    config = read_state(job.out).config
    if total_poses is not None:
        config = dataclasses.replace(config, total_poses=total_poses)
    return _run(job, config, None, True, on_progress)


def _run(
    job: TrainingJob,
    config: TrainConfig,
    start_from: GraspModel | None,
    resume: bool,
    on_progress: Progress | None,
) -> GraspModel:
    if job.size > config.scenes_per_step:
        raise InvalidRequestError(
            f"{job.size} processes were asked for and a step has {config.scenes_per_step} "
            "scenes; expected at most one process a scene. Give more scenes_per_step."
        )
    followers: list[BaseProcess] = []
    team = Team()
    try:
        if job.place is not None:
            team = job.place.met()
        elif job.processes > 1:
            followers, team = _gathered(job, config, start_from, resume)
        with tuned_process(), StopSignals() as signals:
            run = TrainingRun(job, config, team, start_from)
            if resume:
                run.resume()
            run.read()
            ended = False
            try:
                # The first signal ends the stretch after the step at work, a second one at once.
                with signals.held_back():
                    _go_on(run, lambda: bool(signals.received), on_progress)
                    if team.leads:
                        run.save()
                    ended = True
            except KeyboardInterrupt:
                if not ended:
                    raise
            return run.averaged()
    finally:
        team.leave()
        for follower in followers:
            follower.join(timeout=10.0)
            # They are deaf to the signal of `terminate`.
            follower.kill()


def _gathered(
    job: TrainingJob, config: TrainConfig, start_from: GraspModel | None, resume: bool
) -> tuple[list[BaseProcess], Team]:
    """Start the other processes and meet them."""
    followers: list[BaseProcess] = []
    port = free_port()
    context = multiprocessing.get_context("spawn")
    with deaf_to_ctrl_c():
        for rank in range(1, job.processes):
            arguments = (rank, port, job, config, start_from, resume)
            followers.append(context.Process(target=_follow, args=arguments, daemon=True))
            followers[-1].start()
    return followers, Team(0, job.processes).met(port)


def _go_on(run: TrainingRun, stopped: Callable[[], bool], on_progress: Progress | None) -> None:
    """Train; save what there is when another process is lost."""
    try:
        run.go_on(stopped, on_progress if run.team.leads else None)
    except PeerLostError as error:
        # The step at work changed nothing: weights and counters are those of the one before.
        if run.team.leads:
            run.save()
        raise TrainingError(f"{error} What was trained until then is saved.") from error


def _follow(
    rank: int,
    port: int,
    job: TrainingJob,
    config: TrainConfig,
    start_from: GraspModel | None,
    resume: bool,
) -> None:
    """What the other processes do."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    torch.set_num_threads(1)
    team = Team(rank, job.processes).met(port)
    with tuned_process():
        run = TrainingRun(job, config, team, start_from)
        if resume:
            run.resume()
        run.read()
        run.go_on(lambda: False, None)
    team.leave()
