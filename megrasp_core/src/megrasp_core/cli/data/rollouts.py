"""`megrasp data rollouts`."""

from __future__ import annotations

from pathlib import Path

from megrasp_core.cli.common import progress_bar, say
from megrasp_core.errors import InvalidRequestError

__all__ = ["rollouts"]


def rollouts(
    out: Path,
    model: str | None = None,
    gripper: str = "robotiq_2f85",
    tables: bool = False,
    bins: int = 40,
    drawn: int = 100,
    judged: int = 10,
    procedural: int = 60,
    copies: int = 0,
    threads: int | None = None,
    seed: int = 7000,
) -> int:
    """Bins or tables that the model clears itself; its own grasps at every stage, labelled.

    Labelled in simulation. Filled with the training objects (scans where MEGRASP_ASSETS is set,
    and procedural ones). Resumable: run it again to go on.

    Try:
      megrasp data rollouts --model runs/small/model --out data/rollouts
      megrasp data rollouts --gripper allegro_hand --tables --bins 10 --out data/rollouts_allegro
      megrasp data rollouts --copies 3 --procedural 120 --bins 60 --out data/stretched
      megrasp train --data data/rollouts --heads-of runs/small/model --out runs/heads

    Args:
        out: data set folder; every stage of a bin or table becomes a scene.
        model: id or folder.
        gripper: name, or folder of a gripper.yaml.
        tables: heaps on tables instead of bins, as hands need.
        bins: how many, or how many tables.
        drawn: poses drawn per synthesis.
        judged: best ranked grasps tried at every stage.
        procedural: procedural objects among those that bins are filled from.
        copies: so many copies of every scan are among them, stretched along their axes and every
            other one mirrored, so that a confidence learns from more shapes than were scanned.
            Other copies, and other procedural objects, for another first seed.
        threads: torch threads.
        seed: of the first bin; the others follow.
    """
    if bins < 1:
        raise InvalidRequestError(f"--bins {bins} was given; expected at least 1.")
    if copies < 0:
        raise InvalidRequestError(f"--copies {copies} was given; expected at least 0.")
    from megrasp_core.objects import training_objects
    from megrasp_core.self_labelling.rollouts import (
        IN_BINS,
        ON_TABLES,
        RolloutSettings,
        label_rollouts,
    )
    from megrasp_core.synthesizer import GraspSynthesizer

    with progress_bar(bins, "tables" if tables else "bins") as bar:

        def tell(number: int, won: int, tried: int) -> None:
            bar.update(number - seed + 1 - bar.n)
            bar.set_postfix(successes=f"{won}/{tried}")
            if bar.disable and (number - seed) % 5 == 4:
                say(f"{number - seed + 1}/{bins} scenes, {won} successes of {tried} labels")

        done = label_rollouts(
            out,
            GraspSynthesizer.load(model, gripper, threads=threads),
            training_objects(procedural, copies=copies, start=seed if copies else 0),
            range(seed, seed + bins),
            RolloutSettings(judged=judged, drawn=drawn, scenes=ON_TABLES if tables else IN_BINS),
            on_scene=tell,
        )
    lost = f"; {done.failed} of {bins} scenes failed" if done.failed else ""
    say(f"wrote {done.stages} stages to {out}{lost}")
    return 0 if done.stages or not done.failed else 1
