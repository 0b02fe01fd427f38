"""Bin clearing without ROS: a synthesizer empties a simulated bin."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from megrasp_core.drawing.grasp_picture import save_grasp_picture
from megrasp_core.synthesizer import GraspSynthesizer

from .clearing import ClearingPlan, PickRecord
from .pick_sheet import sheet_of_picks
from .robot_cell import RobotCell

if TYPE_CHECKING:
    from megrasp_core.synthesizer import Mode, Synthesis

DEFAULT_GRIPPERS = ("robotiq_2f85", "robotiq_3f")


def run_demo(
    *,
    grippers: Sequence[str] = DEFAULT_GRIPPERS,
    objects: int = 8,
    seed: int = 1,
    model: str | Path | None = None,
    device: str = "cpu",
    threads: int | None = None,
    num_grasps: int = 20,
    drawn: int = 100,
    mode: Mode = "default",
    tries: int = 3,
    picture: str | Path | None = None,
    on_pick: Callable[[PickRecord], None] | None = None,
) -> dict[str, object]:
    """Empty a simulated bin of procedural objects; nothing is printed.

    Args:
        grippers: names, used in this order, each for an equal share of the objects.
        objects: how many lie in the bin.
        seed: of the scene, the camera's noise and the samples.
        model: id or folder; None: the default for the kind of each gripper.
        device: of the model.
        threads: see `GraspSynthesizer`.
        num_grasps: returned by a synthesis.
        drawn: poses drawn by a synthesis.
        mode: of the synthesis.
        tries: failures in a row after which an object is given up.
        picture: PNG for one contact sheet of all picks; the picture of every pick goes into a
            folder beside it, named after it.
        on_pick: called after each attempt.

    Returns:
        `ClearingPlan.summary`, the seed and the seconds.

    Raises:
        ModelError, UnknownGripperError, InvalidRequestError, SimulationError.
    """
    synthesizer = GraspSynthesizer.load(model, gripper=grippers[0], device=device, threads=threads)
    cell = RobotCell.procedural(objects, grippers, seed=seed)
    return clear_bin(
        cell,
        synthesizer,
        grippers=grippers,
        seed=seed,
        num_grasps=num_grasps,
        drawn=drawn,
        mode=mode,
        tries=tries,
        picture=None if picture is None else Path(picture),
        on_pick=on_pick,
    )


def clear_bin(
    cell: RobotCell,
    synthesizer: GraspSynthesizer,
    *,
    grippers: Sequence[str],
    seed: int,
    num_grasps: int = 20,
    drawn: int = 100,
    mode: Mode = "default",
    tries: int = 3,
    picture: Path | None = None,
    on_pick: Callable[[PickRecord], None] | None = None,
) -> dict[str, object]:
    """Empty a cell's bin; nothing is printed.

    Args:
        cell: with its objects at rest.
        synthesizer: its gripper is changed with the cell's.
        grippers: in the cell's rack, used in this order.
        seed: the n-th synthesis uses seed + n.
        num_grasps: as of `run_demo`, like all that follow.
        drawn: poses drawn by a synthesis.
        mode: of the synthesis.
        tries: failures in a row after which an object is given up.
        picture: PNG for one contact sheet of all picks.
        on_pick: called after each attempt.

    Returns:
        `ClearingPlan.summary`, the seed and the seconds.

    Raises:
        UnknownGripperError, InvalidRequestError, SimulationError.
    """
    started = time.monotonic()
    plan = ClearingPlan(grippers, cell.objects_left, tries=tries)
    with _picture_folder(picture) as folder:
        while (gripper := plan.gripper) is not None:
            if cell.gripper.name != gripper:
                cell.change_tool(gripper)
            # Free for the gripper in use: the synthesizer keeps what it has encoded.
            synthesizer.set_gripper(cell.gripper)
            attempt = len(plan.records) + 1
            begun = time.monotonic()
            cloud = cell.capture()
            synthesis = plan.failures.ask(
                lambda failed, cloud=cloud, attempt=attempt: synthesizer.synthesize(
                    cloud,
                    num_grasps=num_grasps,
                    drawn=drawn,
                    mode=mode,
                    gravity=(0.0, 0.0, -1.0),
                    sensor=cloud.viewpoint,
                    region=cell.region,
                    exclude=failed,
                    exclude_radius=plan.exclude_radius,
                    seed=seed + attempt,
                ),
                lambda answer: bool(answer.grasps),
            )
            seconds = time.monotonic() - begun
            chosen = plan.choose([grasp.world_from_tcp for grasp in synthesis.grasps])
            shot = None
            if folder is not None:
                shot = folder / f"pick_{attempt:02d}.png"
                save_grasp_picture(
                    shot,
                    cloud,
                    synthesis,
                    cell.gripper,
                    chosen=chosen,
                    title=f"pick {attempt}: {gripper}, {len(synthesis.grasps)} grasps",
                    region=cell.region,
                )
            record = _attempt(cell, plan, synthesis, chosen, attempt, seconds, shot)
            plan.record(
                record, None if chosen is None else synthesis.grasps[chosen].world_from_tcp
            )
            if on_pick is not None:
                on_pick(record)
        if picture is not None:
            sheet_of_picks(plan.records, picture)
    return plan.summary() | {"seed": seed, "seconds": time.monotonic() - started}


def _attempt(
    cell: RobotCell,
    plan: ClearingPlan,
    synthesis: Synthesis,
    chosen: int | None,
    attempt: int,
    seconds: float,
    shot: Path | None,
) -> PickRecord:
    common = {
        "attempt": attempt,
        "gripper": cell.gripper.name,
        "returned": len(synthesis.grasps),
        "synthesis_seconds": seconds,
        "rejected": dict(synthesis.rejected),
        "picture": None if shot is None else str(shot),
    }
    if chosen is None:
        return PickRecord(
            success=False,
            reason="given_up" if synthesis.grasps else "no_grasp",
            removed=(),
            objects_left=cell.objects_left,
            **common,
        )
    grasp = synthesis.grasps[chosen]
    begun = time.monotonic()
    result = cell.execute_grasp(grasp)
    return PickRecord(
        success=result.success,
        reason=result.error,
        removed=result.removed,
        objects_left=result.objects_left,
        score=float(grasp.score),
        width=float(grasp.width),
        width_tolerance=float(grasp.width_tolerance),
        closed_width=float(result.width),
        execution_seconds=time.monotonic() - begun,
        **common,
    )


@contextmanager
def _picture_folder(picture: Path | None) -> Iterator[Path | None]:
    """Folder for the pictures of the picks: beside the contact sheet, named after it."""
    if picture is None:
        yield None
        return
    folder = picture.with_suffix("")
    folder.mkdir(parents=True, exist_ok=True)
    yield folder
