"""`megrasp data samples`."""

from __future__ import annotations

from pathlib import Path

from megrasp_core.cli.common import progress_bar, say

__all__ = ["samples"]


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
