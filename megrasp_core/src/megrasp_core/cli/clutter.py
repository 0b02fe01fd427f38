"""The protocols packed and pile of `megrasp eval`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .common import emit, progress_bar, say

if TYPE_CHECKING:
    from megrasp_core.evaluation.clutter_removal.protocol import ClutterSettings
    from megrasp_core.evaluation.clutter_removal.report import ClutterResult
    from megrasp_core.evaluation.planners import Planner
    from megrasp_core.grippers import Gripper

__all__ = ["clutter_rates"]


def clutter_rates(
    settings: ClutterSettings,
    gripper: Gripper,
    planner: Planner,
    objects: Path | None,
    out: Path,
    picture: Path | None,
    planned_for: str,
    without: Sequence[str] = (),
) -> int:
    """Run the rounds, write the result file and, with `picture`, a sheet of the first round.

    Args:
        settings: of the rounds.
        gripper: in the simulation.
        planner: answers with grasps.
        objects: folder, or None: procedural ones.
        out: result file.
        picture: PNG, or None.
        planned_for: name of the gripper that the planner plans for.
        without: stages that the planner leaves out, for the result file.
    """
    from megrasp_core.evaluation.clutter_removal.object_files import clutter_pool, fitting
    from megrasp_core.evaluation.clutter_removal.picture import RoundPicture
    from megrasp_core.evaluation.clutter_removal.report import evaluate_clutter

    found = clutter_pool(objects)
    pool = fitting(found, gripper)
    say(f"{len(pool)} of {len(found)} objects fit {gripper.name}")
    sheet = None if picture is None else RoundPicture(gripper)
    out.parent.mkdir(parents=True, exist_ok=True)
    place = "procedural" if objects is None else "/".join(objects.resolve().parts[-2:])

    def content(of: ClutterResult) -> dict[str, Any]:
        found = of.to_json()
        if without:
            found["config"]["without"] = list(without)
        return found

    with progress_bar(settings.rounds, settings.scene) as bar:

        def tell(done: int, so_far: ClutterResult) -> None:
            bar.update(done - bar.n)
            rates = {"gsr": so_far.grasp_success(), "dr": so_far.declutter()}
            counts = {key: f"{rate.successes}/{rate.trials}" for key, rate in rates.items()}
            bar.set_postfix(counts)
            if bar.disable and done % 5 == 0:
                said = ", ".join(f"{key} {value}" for key, value in counts.items())
                say(f"{done} rounds: {said}")
            # A run that is stopped leaves what it has.
            out.write_text(json.dumps(content(so_far), indent=1) + "\n")
            if done == 1 and sheet is not None and picture is not None and sheet.save(picture):
                say(f"wrote {picture}")

        result = evaluate_clutter(
            settings,
            gripper,
            planner,
            pool,
            objects=place,
            planned_for=planned_for,
            on_round=tell,
            on_attempt=None if sheet is None else sheet.add,
        )
    for name, rate in (("GSR", result.grasp_success()), ("DR", result.declutter())):
        if rate.rate is not None and rate.ci95 is not None:
            low, high = rate.ci95
            say(
                f"{name:>4}: {rate.successes}/{rate.trials} = {100 * rate.rate:.1f} % "
                f"[{100 * low:.1f}, {100 * high:.1f}]"
            )
    emit(content(result), out)
    return 0 if result.grasp_success().successes else 1
