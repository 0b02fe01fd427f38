"""`megrasp eval`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from megrasp_core.errors import InvalidRequestError

from .clutter import clutter_rates
from .common import Flag, emit, progress_bar, say
from .runs import Executor, executor_of

if TYPE_CHECKING:
    from megrasp_core.evaluation.kept_scenes import KeptScenes
    from megrasp_core.evaluation.planners import Planner
    from megrasp_core.evaluation.protocols import ProtocolSettings
    from megrasp_core.evaluation.report import EvaluationResult
    from megrasp_core.grippers import Gripper
    from megrasp_core.jobs import ExecutorConfig

__all__ = ["evaluation"]

Stage = Literal["openings", "sweep", "turns", "back_off", "polish"]
BASELINE_STAGES: tuple[Stage, ...] = ("openings", "sweep", "back_off")
"""Stages of the synthesis that the baseline shares."""


def evaluation(
    gripper: str,
    out: Path,
    protocol: Literal["binpick", "declutter", "single", "packed", "pile"] = "binpick",
    gripper_path: Path | None = None,
    execute_with: str | None = None,
    objects: Path | None = None,
    scenes: int = 50,
    samples: int = 100,
    drawn: int = 100,
    returned: int = 20,
    judged: int = 0,
    count_all: Flag = False,
    friction: float = 0.8,
    views: int = 10,
    crop_floor: Literal["known", "estimated"] | None = None,
    engine: Literal["pybullet", "mujoco"] = "pybullet",
    depth_noise: Literal["gaussian", "dexnet", "none"] = "gaussian",
    picture: Path | None = None,
    failures: Path | None = None,
    model: str | None = None,
    baseline: Flag = False,
    ceiling: Flag = False,
    without: tuple[Stage, ...] = (),
    device: str = "cpu",
    threads: int | None = None,
    executor: Executor = "local",
    address: str | None = None,
    workers: int = 1,
    seed: int = 1,
) -> int:
    """Success rates in simulation, with intervals.

    In binpick, a bin of 10 objects and 2 obstacles, one noisy top-down view, the first grasp is
    executed with its approach path until the bin is empty or the robot gives up. In declutter, a
    heap on a table, ten views. In single, one object on a table. packed and pile are the rounds of
    clutter removal of VGN, GIGA and Edge-Grasp, by default in PyBullet (extra `bench`): five
    objects, upright or dropped, one view from the side; GSR is successes / attempts, DR objects
    removed / objects.

    Scenes that are done are kept in OUT.part until the result is written: the same command goes on
    where it was stopped, also with more --scenes (not packed and pile).

    Try:
      megrasp eval --gripper robotiq_2f85 --out binpick.json
      megrasp eval --gripper robotiq_2f85 --objects $MEGRASP_ASSETS/objects/devtest --out o.json
      megrasp eval --gripper robotiq_2f85 --baseline --out baseline.json
      megrasp eval --gripper franka_hand --protocol declutter --views 1 --out side.json
      megrasp eval --gripper franka_hand --protocol declutter --crop-floor known --out c.json
      megrasp eval --gripper robotiq_2f140 --without openings sweep --out plain.json
      megrasp eval --gripper robotiq_2f85 --ceiling --samples 0 --out ceiling.json
      megrasp eval --gripper franka_hand --protocol packed --scenes 100 --out packed.json
      megrasp eval --gripper franka_hand --protocol pile --engine mujoco --out pile.json
      megrasp eval --gripper robotiq_3f --execute-with robotiq_3f_cad --judged 20 --out t.json
      megrasp eval --gripper robotiq_2f85 --samples 0 --failures failures --out seen.json
      megrasp eval --gripper robotiq_2f85 --executor ray --workers 32 --out many.json

    Args:
        gripper: name, or folder of a gripper.yaml.
        out: result file (JSON).
        protocol: what is run.
        gripper_path: folder with more grippers.
        execute_with: another model of the gripper, name or folder, that executes what was planned
            for the first: `<name>_cad` is the maker's CAD, and the nearest thing to another world.
        objects: every folder below it that holds a meta.json, for packed and pile every URDF file
            where there are any; by default procedural objects.
        scenes: bins, heaps or rounds.
        samples: poses judged one by one per scene for the unfiltered and filtered rates; 0: only
            first grasps. Not for packed and pile.
        drawn: poses drawn per synthesis.
        returned: grasps returned per synthesis.
        judged: so many of the returned grasps are judged at every stage, for the AUC of the
            score.
        count_all: count every attempt of binpick; by default only those made where a search with
            true geometry, or one of the returned grasps, can lift something.
        friction: of everything.
        views: cameras around a table; 1: one side view, 52 degrees down.
        crop_floor: cut the table from the cloud, as for planners that want segmented objects, and
            tell the planner its height and the region, or leave both to be estimated.
        engine: of packed and pile; pybullet takes grippers whose fingers slide.
        depth_noise: of packed and pile: 0.8 mm a point as in Edge-Grasp's simulator, that of
            Dex-Net 2.0 as in GIGA, or none.
        picture: PNG of the first round of packed or pile, attempt by attempt.
        failures: folder for a picture of every executed grasp that failed, and one sheet of all
            for each cause. Not for packed and pile.
        model: id or folder.
        baseline: the analytic antipodal baseline instead of the model.
        ceiling: a planner that knows the true geometry and tries grasps before it names one: how
            far the protocol can be passed at all. Use it with --samples 0.
        without: stages of the synthesis that are left out, to see what each of them gains; not of
            the ceiling, and of the baseline openings, sweep and back_off, since it has no others.
        device: cpu or cuda.
        threads: torch threads; where several processes run the scenes, one each without it.
        executor: local processes or a Ray cluster that run the scenes.
        address: of the Ray cluster.
        workers: processes or tasks in flight.
        seed: of scenes, noise and samples.
    """
    from megrasp_core.evaluation.clutter_removal.protocol import ClutterSettings
    from megrasp_core.evaluation.protocols import ProtocolSettings
    from megrasp_core.grippers import load_gripper

    spread = None
    if executor != "local" or workers != 1:
        spread = executor_of(executor, address, workers)
        if device != "cpu":
            raise InvalidRequestError(
                f"--device {device} was given with --executor {executor} --workers {workers}; "
                "expected cpu, since the processes that run the scenes have no other device. "
                "Leave one of them out."
            )
    in_rounds = protocol == "packed" or protocol == "pile"
    if in_rounds and (
        ceiling or crop_floor or views != 10 or judged or count_all or spread or failures
    ):
        raise InvalidRequestError(
            f"--ceiling, --crop-floor, --views, --judged, --count-all, --failures or workers were "
            f"given with {protocol}; expected none of them: its rounds have one side view of the "
            "whole table, count what was executed and run in one process. Leave them out."
        )
    if not in_rounds and (
        picture is not None or engine != "pybullet" or depth_noise != "gaussian"
    ):
        raise InvalidRequestError(
            f"--picture, --engine or --depth-noise was given with {protocol}; expected them with "
            "packed or pile. Leave them out."
        )
    paths = () if gripper_path is None else (gripper_path,)
    loaded = load_gripper(gripper, paths)
    executing = loaded if execute_with is None else load_gripper(execute_with, paths)
    chosen = "ceiling" if ceiling else "baseline" if baseline else "model"
    planner = _planner(chosen, without, loaded, executing, model, device, threads)
    if protocol == "packed" or protocol == "pile":
        rounds = ClutterSettings(
            scene=protocol, rounds=scenes, engine=engine, drawn=drawn, returned=returned,
            friction=friction, noise=depth_noise, seed=seed,
        )  # fmt: skip
        return clutter_rates(
            rounds, executing, planner, objects, out, picture, loaded.name, without
        )
    settings = ProtocolSettings(
        protocol=protocol, scenes=scenes, samples=samples, drawn=drawn, returned=returned,
        judged=judged, possible_only=protocol == "binpick" and not count_all,
        friction=friction, views=views, crop_floor=crop_floor, seed=seed,
    )  # fmt: skip
    content, kept = _rates(settings, executing, planner, objects, loaded, spread, out, failures)
    if without:
        content["config"]["without"] = list(without)
    emit(content, out)
    kept.remove()
    return 0 if content["first"]["successes"] else 1


def _planner(
    chosen: Literal["model", "baseline", "ceiling"],
    without: tuple[Stage, ...],
    gripper: Gripper,
    executing: Gripper,
    model: str | None,
    device: str,
    threads: int | None,
) -> Planner:
    """Who plans, without some stages of the synthesis.

    Raises:
        InvalidRequestError: it has no such stages.
    """
    from megrasp_core.evaluation.ceiling import CeilingPlanner
    from megrasp_core.evaluation.planners import AntipodalPlanner, ModelPlanner
    from megrasp_core.synthesizer import GraspSynthesizer, SynthesizerSettings

    known = {"model": without, "baseline": BASELINE_STAGES, "ceiling": ()}[chosen]
    if not set(without) <= set(known):
        raise InvalidRequestError(
            f"--without {' '.join(without)} was given with --{chosen}; expected "
            f"{'some of ' + ', '.join(known) if known else 'none of it'}, since it has no other "
            "stages of the synthesis. Leave it out."
        )
    stages = SynthesizerSettings().without(without)
    if chosen == "ceiling":
        return CeilingPlanner(executing)
    if chosen == "baseline":
        return AntipodalPlanner(gripper, synthesizer=stages)
    return ModelPlanner(
        GraspSynthesizer.load(model, gripper, device=device, threads=threads, settings=stages)
    )


def _rates(
    settings: ProtocolSettings,
    executing: Gripper,
    planner: Planner,
    objects: Path | None,
    planned_for: Gripper,
    spread: ExecutorConfig | None,
    out: Path,
    failures: Path | None,
) -> tuple[dict[str, Any], KeptScenes]:
    """Run a protocol of one's own simulation, tell the rates, and return the content of the result
    file and the scenes that were kept meanwhile.
    """
    from megrasp_core.evaluation.failure_pictures import FailurePictures
    from megrasp_core.evaluation.kept_scenes import KeptScenes
    from megrasp_core.evaluation.object_pool import graspable_objects, load_pool
    from megrasp_core.evaluation.report import evaluate

    pool = load_pool(objects)
    with progress_bar(len(pool), "graspable objects") as bar:
        usable = graspable_objects(
            executing, pool, on_progress=lambda done, _: bar.update(done - bar.n)
        )
    say(f"{len(usable)} of {len(pool)} objects can be held by {executing.name}")
    kept = KeptScenes.beside(out, settings, executing, planner, pool, usable, planned_for)
    if kept.outcomes:
        say(f"{len(kept.outcomes)} scenes are done already ({kept.path})")
    pictures = None if failures is None else FailurePictures(failures, executing)
    if pictures is not None and not kept.begun:
        pictures.require_new()
        kept.begin()
    place = "procedural" if objects is None else "/".join(objects.resolve().parts[-2:])
    with progress_bar(settings.scenes, settings.protocol) as bar:

        def tell(done: int, so_far: EvaluationResult) -> None:
            bar.update(done - bar.n)
            content = so_far.to_json()
            rates = {
                key: f"{content[key]['successes']}/{content[key]['trials']}"
                for key in ("first", "filtered", "unfiltered")
                if key in content
            }
            bar.set_postfix(rates)
            if bar.disable and done % 5 == 0:
                told = ", ".join(f"{key} {value}" for key, value in rates.items())
                say(f"{done} scenes: {told}")

        try:
            result = evaluate(
                settings, executing, planner, pool, usable, objects=place,
                planned_for=planned_for.name, executor=spread, kept=kept, pictures=pictures,
                on_scene=tell,
            )  # fmt: skip
        except KeyboardInterrupt:
            if kept.outcomes:
                say(f"{len(kept.outcomes)} scenes are kept; the same command goes on with them")
            raise
    if pictures is not None:
        told = ", ".join(path.name for path in pictures.sheets())
        say(f"pictures of what failed in {failures}: {told or 'none'}")
    content = result.to_json()
    for key in ("first", "first_all", "filtered", "unfiltered", "judged"):
        if content.get(key, {}).get("trials"):
            row = content[key]
            low, high = row["ci95"]
            say(
                f"{key:>10}: {row['successes']}/{row['trials']} = {100 * row['rate']:.1f} % "
                f"[{100 * low:.1f}, {100 * high:.1f}]"
            )
    return content, kept
