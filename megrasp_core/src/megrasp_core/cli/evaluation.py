"""`megrasp eval`, `megrasp bench` and `megrasp data samples`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from megrasp_core.errors import InvalidRequestError

from .common import Flag, block_writer, emit, progress_bar, say

if TYPE_CHECKING:
    from megrasp_core.evaluation.planners import Planner
    from megrasp_core.evaluation.report import EvaluationResult

__all__ = ["bench", "evaluation", "samples"]


def evaluation(
    gripper: str,
    out: Path,
    protocol: Literal["binpick", "declutter", "single"] = "binpick",
    gripper_path: Path | None = None,
    objects: Path | None = None,
    scenes: int = 50,
    samples: int = 100,
    drawn: int = 100,
    returned: int = 20,
    friction: float = 0.8,
    model: str | None = None,
    baseline: Flag = False,
    ceiling: Flag = False,
    device: str = "cpu",
    threads: int | None = None,
    seed: int = 1,
) -> int:
    """Success rates in simulation, with intervals.

    In binpick, a bin of 10 objects and 2 obstacles, one noisy top-down view, the first grasp is
    executed with its approach path until the bin is empty or the robot gives up. In declutter, a
    heap on a table, ten views. In single, one object on a table.

    Try:
      megrasp eval --gripper robotiq_2f85 --out binpick.json
      megrasp eval --gripper robotiq_2f85 --objects $MEGRASP_ASSETS/objects/devtest --out o.json
      megrasp eval --gripper robotiq_2f85 --baseline --out baseline.json
      megrasp eval --gripper robotiq_2f85 --ceiling --samples 0 --out ceiling.json

    Args:
        gripper: name, or folder of a gripper.yaml.
        out: result file (JSON).
        protocol: what is run.
        gripper_path: folder with more grippers.
        objects: every folder below it that holds a meta.json; by default procedural objects.
        scenes: bins or heaps.
        samples: poses judged one by one per scene for the unfiltered and filtered rates; 0: only
            first grasps.
        drawn: poses drawn per synthesis.
        returned: grasps returned per synthesis.
        friction: of everything.
        model: id or folder.
        baseline: the analytic antipodal baseline instead of the model.
        ceiling: a planner that knows the true geometry and tries grasps before it names one: how
            far the protocol can be passed at all. Use it with --samples 0.
        device: cpu or cuda.
        threads: torch threads.
        seed: of scenes, noise and samples.
    """
    from megrasp_core.evaluation.ceiling import CeilingPlanner
    from megrasp_core.evaluation.object_pool import graspable_objects, load_pool
    from megrasp_core.evaluation.planners import AntipodalPlanner, ModelPlanner
    from megrasp_core.evaluation.protocols import ProtocolSettings
    from megrasp_core.evaluation.report import evaluate
    from megrasp_core.grippers import load_gripper
    from megrasp_core.synthesizer import GraspSynthesizer

    settings = ProtocolSettings(
        protocol=protocol, scenes=scenes, samples=samples, drawn=drawn, returned=returned,
        friction=friction, seed=seed,
    )  # fmt: skip
    loaded = load_gripper(gripper, () if gripper_path is None else (gripper_path,))
    planner: Planner
    if ceiling:
        planner = CeilingPlanner(loaded)
    elif baseline:
        planner = AntipodalPlanner(loaded)
    else:
        planner = ModelPlanner(
            GraspSynthesizer.load(model, loaded, device=device, threads=threads)
        )
    pool = load_pool(objects)
    with progress_bar(len(pool), "graspable objects") as bar:
        usable = graspable_objects(
            loaded, pool, on_progress=lambda done, _: bar.update(done - bar.n)
        )
    say(f"{len(usable)} of {len(pool)} objects can be held by {loaded.name}")
    place = "procedural" if objects is None else "/".join(objects.resolve().parts[-2:])
    with progress_bar(settings.scenes, protocol) as bar:

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
                say(
                    f"{done} scenes: "
                    + ", ".join(f"{key} {value}" for key, value in rates.items())
                )

        result = evaluate(settings, loaded, planner, pool, usable, objects=place, on_scene=tell)
    content = result.to_json()
    for key in ("first", "filtered", "unfiltered"):
        if content.get(key, {}).get("trials"):
            row = content[key]
            low, high = row["ci95"]
            say(
                f"{key:>10}: {row['successes']}/{row['trials']} = {100 * row['rate']:.1f} % "
                f"[{100 * low:.1f}, {100 * high:.1f}]"
            )
    emit(content, out)
    return 0 if content["first"]["successes"] else 1


def bench(
    out: Path | None = None,
    device: Literal["cpu", "cuda"] = "cpu",
    stage: Literal["synthesis", "render", "data", "training"] = "synthesis",
    gripper: str = "robotiq_2f85",
    model: str | None = None,
    threads: int | None = None,
    repeats: int = 7,
    page: Path | None = None,
    data: Path | None = None,
    against: Path | None = None,
) -> int:
    """Seconds, CPU-seconds and memory of a synthesis, from cloud to ranked list.

    Or CPU-seconds: `render`, to render the open and closed cloud of all registered and of 50
    procedural grippers; `data`, rates of the data generator for the grippers that are trained;
    `training`, poses a second in training beside those of an older checkout.

    Try:
      megrasp bench --threads 2 --out bench.json
      megrasp bench --stage render --out render.json
      megrasp bench --stage data --out docs/results/data_bench.json --page docs/data.md
      git worktree add ../before 1540005
      megrasp bench --stage training --data data/scenes --against ../before --repeats 3

    Args:
        out: result file (JSON); by default printed.
        device: cpu or cuda.
        stage: what is timed.
        gripper: name or folder (synthesis).
        model: id or folder (synthesis).
        threads: torch threads (synthesis); rendering takes one.
        repeats: timed calls per row.
        page: markdown page whose lines between <!-- rates --> and <!-- /rates --> become tables
            of the result (data).
        data: data set of scenes labelled for four grippers each (training).
        against: checkout to compare with (training).
    """
    if repeats < 1:
        raise InvalidRequestError(f"--repeats {repeats} was given; expected at least 1.")
    if page is not None and stage != "data":
        raise InvalidRequestError(
            f"--page was given with --stage {stage}; expected --stage data, whose tables it takes."
        )
    if (stage == "training") != (data is not None and against is not None):
        raise InvalidRequestError(
            f"--stage {stage} was given with --data {data} and --against {against}; expected both "
            "with --stage training and none otherwise."
        )
    if data is not None and against is not None:
        from megrasp_core.benchmarks.training import bench_training

        with progress_bar(None, stage) as bar:
            content = bench_training(
                data,
                against,
                repeats=repeats,
                on_progress=lambda done, _: bar.update(done - bar.n),
            )
        emit(content, out)
        return 0
    if stage == "render":
        from megrasp_core.benchmarks.rendering import bench_rendering

        with progress_bar(None, stage) as bar:
            content = bench_rendering(
                repeats=repeats, on_progress=lambda done, _: bar.update(done - bar.n)
            )
        emit(content, out)
        return 0
    if stage == "data":
        from megrasp_core.benchmarks.data import bench_data
        from megrasp_core.benchmarks.rate_tables import rate_tables
        from megrasp_core.training import GRIPPERS

        write = block_writer(page, "rates") if page is not None else None
        with progress_bar(len(GRIPPERS), stage) as bar:
            content = bench_data(GRIPPERS, on_progress=lambda done, _: bar.update(done - bar.n))
        emit(content, out)
        if write is not None:
            write(rate_tables(content))
        return 0
    from megrasp_core.benchmarks.synthesis import bench_synthesis
    from megrasp_core.synthesizer import GraspSynthesizer

    synthesizer = GraspSynthesizer.load(model, gripper, device=device, threads=threads)
    with progress_bar(None, stage) as bar:
        content = bench_synthesis(
            synthesizer, repeats=repeats, on_progress=lambda done, _: bar.update(done - bar.n)
        )
    emit(content, out)
    return 0


def samples(
    data: Path,
    out: Path,
    model: str | None = None,
    gripper: tuple[str, ...] = ("robotiq_2f85", "franka_hand", "robotiq_3f"),
    samples: int = 48,
    judged: int = 16,
    scenes: int | None = None,
    seed: int = 1,
) -> int:
    """The model's own samples in the scenes of a data set, labelled in simulation; resumable.

    Try:
      megrasp data samples --data data/scenes --model runs/small/model --out data/samples
      megrasp train --data data/samples --heads-of runs/small/model --out runs/heads

    Args:
        data: folder of `data scenes`.
        out: folder for the copies of the scenes that hold the new labels.
        model: id or folder.
        gripper: names of the grippers.
        samples: drawn per scene and gripper.
        judged: most of those free of collision that are tried in the heap.
        scenes: only the first so many scenes.
        seed: of the samples.
    """
    from megrasp_core.network import load_model
    from megrasp_core.objects import ObjectSet
    from megrasp_core.self_labelling.samples import SampleSettings, label_samples

    won = tried = 0
    with progress_bar(scenes, "samples") as bar:

        def tell(done: int, total: int, counts: dict[str, tuple[int, int]]) -> None:
            nonlocal won, tried
            bar.total = total
            bar.update(done - bar.n)
            won += sum(c[0] for c in counts.values())
            tried += sum(c[1] for c in counts.values())
            if bar.disable and done % 20 == 0:
                say(f"{done}/{total} scenes, {won} successes of {tried} labels")

        written = label_samples(
            data, out, load_model(model), gripper, ObjectSet(()),
            SampleSettings(samples=samples, judged=judged, seed=seed),
            indices=None if scenes is None else range(scenes), on_scene=tell,
        )  # fmt: skip
    say(f"wrote {written} scenes to {out}")
    return 0
