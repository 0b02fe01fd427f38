"""`megrasp calibrate`."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from .common import Flag, emit, progress_bar, say

__all__ = ["calibrate"]


def calibrate(
    out: Path,
    model: str | None = None,
    gripper: tuple[str, ...] = ("robotiq_2f85", "robotiq_3f", "shadow_dexee"),
    scenes: int = 20,
    judged: int = 8,
    drawn: int = 100,
    threads: int | None = None,
    write: Flag = False,
    seed: int = 41,
) -> int:
    """Fit the score to the verdict on the model's own grasps, so that it reads as a probability.

    Bins are cleared as in `eval --protocol binpick`, with objects that neither training nor
    evaluation draws; hands, which find little in bins, clear tables. At every stage the best
    ranked grasps are judged one by one. Kinds of grippers with grasps enough get a fit of their
    own, which grippers of the training take; others take the one for all.

    Try:
      megrasp calibrate --out models/megrasp-small/evaluation/calibration.json --write

    Args:
        out: result file (JSON).
        model: id or folder.
        gripper: names of grippers.
        scenes: bins or tables per gripper.
        judged: grasps judged per stage.
        drawn: poses drawn per synthesis.
        threads: torch threads.
        write: put the result into the model's config.json, where every synthesis finds it.
        seed: of scenes, noise and samples.
    """
    from megrasp_core.evaluation.calibration import calibrate as fit
    from megrasp_core.evaluation.calibration import calibrate_kinds, judged_grasps
    from megrasp_core.evaluation.object_pool import graspable_objects, validation_pool
    from megrasp_core.evaluation.planners import ModelPlanner
    from megrasp_core.evaluation.protocols import ProtocolSettings
    from megrasp_core.grippers import load_gripper
    from megrasp_core.network import find_model, load_model, save_model
    from megrasp_core.synthesizer import GraspSynthesizer

    pool = validation_pool()
    parts = []
    for name in gripper:
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
        with progress_bar(scenes, name) as bar:

            def tell(done: int, won: int, tried: int) -> None:
                bar.update(done - bar.n)
                bar.set_postfix(first=f"{won}/{tried}")
                if bar.disable and done % 5 == 0:
                    say(f"{done} scenes: first {won}/{tried}")

            parts.append(judged_grasps(settings, loaded, planner, pool, usable, on_scene=tell))
    calibration, report = fit(parts)
    by_kind, reports = calibrate_kinds(parts)
    folder = find_model(model)
    emit({"model": folder.name, "seed": seed, "drawn": drawn, **report, "kinds": reports}, out)
    say(
        f"{sum(len(part.success) for part in parts)} grasps; left-out scenes: log loss "
        f"{report['held_out']['log_loss']}, AUC {report['held_out']['auc']} (confidence alone: "
        f"{report['confidence']['log_loss']}, {report['confidence']['auc']})"
    )
    if write:
        loaded_model = load_model(folder)
        loaded_model.info = dataclasses.replace(
            loaded_model.info, calibration=calibration, calibration_by_kind=by_kind
        )
        save_model(loaded_model, folder)
        say(f"wrote the calibration into {folder}")
    return 0
