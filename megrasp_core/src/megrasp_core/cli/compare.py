"""`megrasp compare`."""

from __future__ import annotations

from pathlib import Path

from megrasp_core.errors import InvalidRequestError

from .common import Names, block_writer, changed, emit, progress_bar

__all__ = ["compare"]


def compare(
    models: tuple[Path, ...],
    data: Path,
    out: Path,
    gripper: Names = ("robotiq_2f85", "robotiq_3f", "shadow_dexee"),
    grasps: int = 200,
    sampler: tuple[str, ...] = (),
    seed: int = 1,
    page: Path | None = None,
) -> int:
    """Compare models by their raw samples in stored scenes, each tried in simulation.

    Without check and ranking, so that the networks are compared and nothing else; hands are
    sampled on tables alone. Beside the rates stand poses, CPU time and last losses of training.

    Try:
      megrasp data scenes --validation --out data/validation --library models/grasp_library -n 48
      megrasp compare --models runs/a runs/b --data data/validation --out comparison.json
      megrasp compare --models runs/a --data scenes --out s.json --sampler steps=8 kind=langevin

    Args:
        models: folders of `megrasp train`, or of models.
        data: data set of objects that the models were not trained with.
        out: result file (JSON).
        gripper: names of the grippers.
        grasps: per model and gripper, spread over the scenes.
        sampler: samplers that every model is tried with, each one text of NAME=VALUE by the names
            of `SamplerSettings` with blanks between; without, its own.
        seed: of the samples.
        page: markdown page whose lines between <!-- comparison --> and <!-- /comparison -->
            become the table.
    """
    import torch

    from megrasp_core.diffusion import SamplerSettings
    from megrasp_core.evaluation.sample_rates import compare_models, comparison_table

    if not models or grasps < 1:
        raise InvalidRequestError(
            f"{len(models)} models and --grasps {grasps} were given; expected at least one each."
        )
    samplers = {text: changed(SamplerSettings(), text.split(), "--sampler") for text in sampler}
    write = None if page is None else block_writer(page, "comparison")
    torch.set_num_threads(1)
    with progress_bar(None, "compare") as bar:

        def tell(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        content = compare_models(
            models,
            data,
            gripper,
            grasps=grasps,
            samplers=samplers,
            seed=seed,
            on_progress=tell,
        )
    emit(content, out)
    if write is not None:
        write(comparison_table(content))
    return 0
