"""`megrasp calibrate`."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from megrasp_core.errors import InvalidRequestError

from .common import Flag, emit, progress_bar, say
from .runs import executor_of

if TYPE_CHECKING:
    from megrasp_core.evaluation.calibration import JudgedGrasps
    from megrasp_core.evaluation.kept_scenes import KeptScenes
    from megrasp_core.network import GraspModel
    from megrasp_core.storage import Attempt

__all__ = ["calibrate"]

DEFAULT = (
    "robotiq_2f85",
    "franka_hand",
    "robotiq_3f",
    "allegro_hand",
    "shadow_hand_3f",
    "shadow_dexee",
)


def calibrate(
    out: Path,
    model: str | None = None,
    gripper: tuple[str, ...] = (),
    attempts: Path | None = None,
    rows: tuple[Path, ...] = (),
    scenes: int = 20,
    judged: int = 8,
    drawn: int = 100,
    copies: int = 0,
    threads: int | None = None,
    workers: int = 1,
    write: Flag = False,
    seed: int = 41,
) -> int:
    """Fit the score to the verdict on the model's own grasps, so that it reads as a probability.

    Bins are cleared as in `eval --protocol binpick`, with objects that neither training nor
    evaluation draws; hands, which find little in bins, clear tables. At every stage the best
    ranked grasps are judged one by one. Kinds of grippers with grasps enough get a fit of their
    own, which grippers of the training take; others take the one for all. Scenes that are done are
    kept until the judged grasps are written, so that the same command goes on where it was
    stopped. With --attempts a real
    cell has judged the grasps (docs/attempts.md), and nothing is simulated.

    Try:
      megrasp calibrate --out models/megrasp-bin/evaluation/calibration.json --write
      megrasp calibrate --attempts attempts --model megrasp-bin --out calibration.json
      megrasp calibrate --rows first.judged.npz second.judged.npz --out calibration.json --write

    Args:
        out: result file (JSON).
        model: id or folder.
        gripper: names of grippers; by default six of all kinds, and of attempts all.
        attempts: folder that a cell recorded into, instead of the simulation.
        rows: judged grasps that earlier runs left beside their results (`NAME.judged.npz`),
            instead of the simulation.
        scenes: bins or tables per gripper.
        judged: grasps judged per stage.
        drawn: poses drawn per synthesis.
        copies: stretched and mirrored ones of every scan besides.
        threads: torch threads; one a process where several run the scenes, without it.
        workers: processes that run the scenes.
        write: put the result into the model's config.json, where every synthesis finds it; that
            of attempts for the kinds of grippers that were tried.
        seed: of scenes, noise and samples.
    """
    from megrasp_core.evaluation.attempts import recalibrated
    from megrasp_core.evaluation.calibration import calibrate as fit
    from megrasp_core.evaluation.calibration import calibrate_kinds, read_judged, write_judged
    from megrasp_core.network import find_model, load_model, save_model

    folder = find_model(model)
    extra: dict[str, Any] = {}
    if rows:
        if attempts is not None or gripper:
            raise InvalidRequestError(
                "--rows was given with --attempts or --gripper; expected it alone, since the rows "
                "are judged already. Leave the others out."
            )
        parts = [part for path in rows for part in read_judged(path)]
        extra = {"rows": [path.name for path in rows]}
    elif attempts is None:
        parts, kept = _simulated(
            model, gripper or DEFAULT, scenes, judged, drawn, copies, threads, workers, seed, out
        )
        # Before the fit: it may find that all of these hold, and they took hours.
        rows_file = out.with_suffix(".judged.npz")
        write_judged(parts, rows_file)
        say(f"wrote {rows_file}")
        for scenes_of in kept:
            scenes_of.remove()
        extra = {"seed": seed, "drawn": drawn, "copies": copies}
    else:
        parts, extra = _recorded(attempts, load_model(folder), gripper)
    calibration, report = fit(parts)
    by_kind, reports = calibrate_kinds(parts)
    emit({"model": folder.name, **extra, **report, "kinds": reports}, out)
    say(
        f"{sum(len(part.success) for part in parts)} grasps; left-out "
        f"{'scenes' if attempts is None else 'attempts'}: log loss "
        f"{report['held_out']['log_loss']}, AUC {report['held_out']['auc']} (confidence alone: "
        f"{report['confidence']['log_loss']}, {report['confidence']['auc']})"
    )
    if write:
        changed = load_model(folder)
        if attempts is None:
            changed.info = dataclasses.replace(
                changed.info, calibration=calibration, calibration_by_kind=by_kind
            )
        else:
            changed.info = recalibrated(changed.info, parts, calibration, by_kind)
        save_model(changed, folder)
        say(f"wrote the calibration into {folder}")
    return 0


def _recorded(
    folder: Path, model: GraspModel, grippers: tuple[str, ...]
) -> tuple[list[JudgedGrasps], dict[str, Any]]:
    from megrasp_core.evaluation.attempts import judged_attempts
    from megrasp_core.storage import AttemptFolder

    notes: list[str] = []
    found = AttemptFolder(folder)
    with progress_bar(len(found.paths), "attempts") as bar:

        def chosen() -> Iterator[Attempt]:
            for attempt in found.read_all(notes):
                bar.update()
                if not grippers or attempt.gripper in grippers:
                    yield attempt

        try:
            parts, quality = judged_attempts(chosen(), model, notes)
        finally:
            for note in notes:
                say(note)
    return parts, {"attempts": folder.name, "notes": notes, **quality}


def _simulated(
    model: str | None,
    grippers: tuple[str, ...],
    scenes: int,
    judged: int,
    drawn: int,
    copies: int,
    threads: int | None,
    workers: int,
    seed: int,
    out: Path,
) -> tuple[list[JudgedGrasps], list[KeptScenes]]:
    from megrasp_core.evaluation.calibration import judged_grasps
    from megrasp_core.evaluation.kept_scenes import KeptScenes
    from megrasp_core.evaluation.object_pool import graspable_objects, validation_pool
    from megrasp_core.evaluation.planners import ModelPlanner
    from megrasp_core.evaluation.protocols import ProtocolSettings
    from megrasp_core.grippers import load_gripper
    from megrasp_core.synthesizer import GraspSynthesizer

    spread = None if workers == 1 else executor_of("local", None, workers)
    pool = validation_pool(copies=copies)
    parts, kept = [], []
    for name in grippers:
        loaded = load_gripper(name)
        settings = ProtocolSettings(
            protocol="declutter" if loaded.description.kind == "hand" else "binpick",
            scenes=scenes,
            judged=judged,
            drawn=drawn,
            seed=seed,
        )
        planner = ModelPlanner(GraspSynthesizer.load(model, loaded, threads=threads))
        usable = graspable_objects(loaded, pool)
        say(f"{name}: {len(usable)} of {len(pool)} objects can be held")
        place = out.with_suffix(f".{loaded.name}")
        kept.append(KeptScenes.beside(place, settings, loaded, planner, pool, usable))
        if kept[-1].outcomes:
            say(f"{len(kept[-1].outcomes)} scenes are done already ({kept[-1].path})")
        with progress_bar(scenes, name) as bar:

            def tell(done: int, won: int, tried: int) -> None:
                bar.update(done - bar.n)
                bar.set_postfix(first=f"{won}/{tried}")
                if bar.disable and done % 5 == 0:
                    say(f"{done} scenes: first {won}/{tried}")

            parts.append(
                judged_grasps(
                    settings, loaded, planner, pool, usable,
                    executor=spread, kept=kept[-1], on_scene=tell,
                )
            )  # fmt: skip
    return parts, kept
