"""`megrasp bench`."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from megrasp_core.errors import InvalidRequestError

from .common import block_writer, emit, progress_bar, say

__all__ = ["bench"]


def bench(
    out: Path | None = None,
    device: Literal["cpu", "cuda"] = "cpu",
    stage: Literal[
        "synthesis", "render", "data", "training", "learning", "bins", "serve", "startup", "ros"
    ] = "synthesis",
    gripper: str = "robotiq_2f85",
    model: str | None = None,
    threads: int | None = None,
    repeats: int = 7,
    page: Path | None = None,
    data: Path | None = None,
    against: Path | None = None,
    validation: Path | None = None,
    minutes: float = 60.0,
    share: float = 0.6,
    scenes: int = 200,
    seed: int = 0,
    note: str = "",
) -> int:
    """Seconds, CPU-seconds and memory of a synthesis, from cloud to ranked list.

    Or CPU-seconds: `render`, to render the open and closed cloud of all registered and of 50
    procedural grippers; `data`, rates of the data generator for the grippers that are trained;
    `training`, poses a second in training beside those of an older checkout; `learning`, the loss
    after a share of the CPU time that the older one has, side by side on two cores. `bins`: how
    often and how well bins are found in simulated clouds, and how often one on a table without.
    `serve`: a request to the resident planner beside the same call in the process. `startup`:
    CPU-seconds until a command can begin, beside those of an older checkout. `ros`: answers of
    grasp_server as its clients see them, clouds lost, idle load; source the workspace.

    Try:
      megrasp bench --threads 2 --out bench.json
      megrasp bench --stage render --out render.json
      megrasp bench --stage data --out docs/results/data_bench.json --page docs/data.md
      megrasp bench --stage bins --out docs/results/bin_finder.json --page docs/bins.md
      megrasp bench --stage ros --out docs/results/ros_bench.json
      git worktree add ../before 1540005
      megrasp bench --stage training --data data/scenes --against ../before --repeats 3
      megrasp bench --stage learning --data d --validation v --against ../before --out l.json
      megrasp bench --stage serve --out docs/results/serve_bench.json
      megrasp bench --stage startup --against ../before --out docs/results/startup.json --page X.md

    Args:
        out: result file (JSON); by default printed.
        device: cpu or cuda.
        stage: what is timed.
        gripper: name or folder (synthesis, serve).
        model: id or folder (synthesis, serve).
        threads: torch threads (synthesis); rendering takes one.
        repeats: timed calls per row.
        page: markdown page whose lines between <!-- rates --> and <!-- /rates --> (data),
            <!-- bins --> and <!-- /bins -->, or <!-- startup --> and <!-- /startup --> become
            tables of the result.
        data: data set of scenes (training, where each is labelled for four grippers; learning).
        against: checkout to compare with (training, learning, startup).
        validation: data set of scenes with other objects (learning).
        minutes: of CPU time of the older checkout (learning).
        share: of them, for the present code (learning).
        scenes: scenes with a bin, and as many tables (bins).
        seed: of the first scene; the others follow (bins).
        note: what else the machine was doing, for the result file (ros).
    """
    if scenes < 1:
        raise InvalidRequestError(f"--scenes {scenes} was given; expected at least 1.")
    if repeats < 1:
        raise InvalidRequestError(f"--repeats {repeats} was given; expected at least 1.")
    if page is not None and stage not in ("data", "bins", "startup"):
        raise InvalidRequestError(
            f"--page was given with --stage {stage}; expected --stage data, bins or startup, "
            "whose tables it takes."
        )
    if stage == "startup":
        return _startup(against, repeats, out, page)
    if stage == "learning":
        return _learning(data, validation, against, minutes, share, out)
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
    if stage == "ros":
        from megrasp_core.benchmarks.ros import bench_ros

        emit(bench_ros(repeats=repeats, note=note), out)
        return 0
    if stage == "render":
        from megrasp_core.benchmarks.rendering import bench_rendering

        with progress_bar(None, stage) as bar:
            content = bench_rendering(
                repeats=repeats, on_progress=lambda done, _: bar.update(done - bar.n)
            )
        emit(content, out)
        return 0
    if stage == "bins":
        from megrasp_core.benchmarks.bins import bench_bins, bin_tables

        write = block_writer(page, "bins") if page is not None else None
        with progress_bar(2 * scenes, stage) as bar:
            content = bench_bins(
                scenes, seed, on_progress=lambda done, _: bar.update(done - bar.n)
            )
        emit(content, out)
        if write is not None:
            write(bin_tables(content))
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
    from megrasp_core.benchmarks.serving import bench_serving
    from megrasp_core.benchmarks.synthesis import bench_synthesis
    from megrasp_core.synthesizer import GraspSynthesizer

    run = bench_serving if stage == "serve" else bench_synthesis
    synthesizer = GraspSynthesizer.load(model, gripper, device=device, threads=threads)
    with progress_bar(None, stage) as bar:
        content = run(
            synthesizer, repeats=repeats, on_progress=lambda done, _: bar.update(done - bar.n)
        )
    emit(content, out)
    return 0


def _learning(
    data: Path | None,
    validation: Path | None,
    against: Path | None,
    minutes: float,
    share: float,
    out: Path | None,
) -> int:
    from megrasp_core.benchmarks.learning import bench_learning

    if data is None or validation is None or against is None or out is None:
        raise InvalidRequestError(
            "--stage learning was given without --data, --validation, --against or --out; "
            "expected all of them. Models that are trained meanwhile lie beside --out."
        )
    if minutes <= 0 or share <= 0:
        raise InvalidRequestError(
            f"--minutes {minutes} and --share {share} were given; expected both above 0."
        )
    work = out.with_name(f"{out.stem}_models")
    say(f"trains for {minutes:g} and {minutes * share:g} minutes of CPU time, models in {work}")
    with progress_bar(100, "learning") as bar:
        content = bench_learning(
            data, validation, against, work, cpu_seconds=60 * minutes, share=share,
            on_progress=lambda done: bar.update(int(100 * done) - bar.n),
        )  # fmt: skip
    emit(content, out)
    return 0


def _startup(against: Path | None, repeats: int, out: Path | None, page: Path | None) -> int:
    from megrasp_core.benchmarks.startup import bench_startup, startup_table

    if against is None:
        raise InvalidRequestError(
            "--stage startup was given without --against; expected a checkout to compare with. "
            "Make one with `git worktree add DIR COMMIT`."
        )
    write = block_writer(page, "startup") if page is not None else None
    with progress_bar(None, "startup") as bar:
        content = bench_startup(
            against, repeats=repeats, on_progress=lambda done, _: bar.update(done - bar.n)
        )
    emit(content, out)
    if write is not None:
        write(startup_table(content))
    return 0
