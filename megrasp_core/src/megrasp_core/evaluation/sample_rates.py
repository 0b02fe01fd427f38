"""How good a model's raw samples are in stored scenes: the measure by which networks are compared
(validation objects, never devtest).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from megrasp_core.diffusion import NoiseSchedule, SamplerSettings
from megrasp_core.errors import DataError
from megrasp_core.grippers import load_gripper
from megrasp_core.machine import processor
from megrasp_core.network import GraspModel, load_model
from megrasp_core.objects import ObjectSet
from megrasp_core.self_labelling.samples import SampleSettings, draw_poses, judge_poses, world_of
from megrasp_core.storage import SceneDataset, SceneRecord
from megrasp_core.training import (
    GripperRack,
    TrainConfig,
    TrainingEntry,
    read_entries,
    validate,
    validation_pairs,
)

from .collision_causes import CollisionCauses
from .statistics import cluster_bootstrap


def compare_models(
    runs: Sequence[Path],
    data: Path,
    grippers: Sequence[str],
    *,
    grasps: int = 200,
    samplers: Mapping[str, SamplerSettings] | None = None,
    seed: int = 1,
    on_progress: Callable[[int, int], object] | None = None,
) -> dict[str, Any]:
    """Sample with every model for every gripper in the same scenes and try each sample.

    Args:
        runs: folders of `megrasp train`, or of models.
        data: stored scenes, of objects that no model was trained with.
        grippers: names; hands are sampled on tables alone, since in most bins they find no free
            grasp.
        grasps: per model, sampler and gripper, spread evenly over the scenes.
        samplers: that every model is tried with, by what the rows call them; by default its own.
        seed: of the samples.
        on_progress: called with rows done and in all.

    Returns:
        Content of the result file: per model the diffusion loss on the scenes' grasps, by gripper
        and band of noise, for all grippers that training knows; per model and gripper the share
        of samples that hold (unfiltered) and that collide at the pre-grasp or, in bins, on the
        way to it, intervals by cluster bootstrap over the scenes; and of those that collide at
        the pre-grasp how deep and with what (`CollisionCauses`).

    Raises:
        DataError: no scene is left for a gripper.
    """
    objects, records = ObjectSet(()), list(SceneDataset(data))
    entries = read_entries([data])
    models = [
        load_model(run / "model" if (run / "model" / "config.json").is_file() else run)
        for run in runs
    ]
    # The same levels of noise for all, or those that know lower ones have the harder task.
    lowest = max(model.config.s_min for model in models)
    tried = dict(samplers) if samplers else {"": None}
    rows: list[dict[str, Any]] = []
    total, done = len(models) * len(tried) * len(grippers), 0
    for model in models:
        facts = {
            "model": model.model_id,
            **_training_facts(model),
            "validation": _losses(model, entries, lowest),
        }
        for called, sampler in tried.items():
            row = {**facts, "sampler": dataclasses.asdict(sampler or model.info.sampler)}
            if called:
                row["sampled_with"] = called
            for name in grippers:
                row[name] = sample_rates(
                    model, records, name, objects, grasps=grasps, sampler=sampler, seed=seed
                )
                done += 1
                if on_progress is not None:
                    on_progress(done, total)
            rows.append(row)
    return {
        "scenes": len(records),
        "grasps": grasps,
        "seed": seed,
        "grippers": list(grippers),
        "rows": rows,
        "hardware": processor(),
    }


def sample_rates(
    model: GraspModel,
    records: Sequence[SceneRecord],
    gripper_name: str,
    objects: ObjectSet,
    *,
    grasps: int,
    seed: int,
    sampler: SamplerSettings | None = None,
) -> dict[str, Any]:
    """Rates of one model, sampler (by default the model's) and gripper; see `compare_models`."""
    gripper = load_gripper(gripper_name)
    if gripper.description.kind == "hand":
        records = [record for record in records if record.bin is None]
    if not records:
        raise DataError(
            f"the scenes hold none for {gripper_name}; expected tables for a hand. Make some with "
            "`megrasp data scenes --bins 0`."
        )
    each = -(-grasps // len(records))
    settings = SampleSettings(
        samples=each, judged=each, colliding=each, sampler=sampler, seed=seed
    )
    held, hit, tried = [], [], []
    causes = CollisionCauses()
    for record in records:
        poses = draw_poses(record, model, gripper, settings)
        labels = judge_poses(record, gripper, objects, poses, settings)
        held.append(int((labels.label == 1).sum()))
        hit.append(int(np.char.endswith(labels.reason, "_collision").sum()))
        tried.append(len(labels))
        world_from_gripper = np.asarray(poses @ gripper.tcp_from_gripper, np.float64)
        causes.add(record, world_of(record, gripper, objects), world_from_gripper)
    return {
        "scenes": len(records),
        "unfiltered": cluster_bootstrap(held, tried).to_json(),
        "colliding": cluster_bootstrap(hit, tried).to_json(),
        "colliding_at_pre_grasp": dataclasses.asdict(causes),
        "evaluations": (settings.sampler or model.info.sampler).evaluations,
    }


def _training_facts(model: GraspModel) -> dict[str, Any]:
    # Of the run that taught the diffusion, where the last one taught the heads alone.
    counters = model.info.counters
    if not counters.get("poses"):
        counters = model.info.started_from.get("counters", counters)
    return {
        "parameters": sum(weight.numel() for weight in model.parameters()),
        "poses": counters.get("poses"),
        "cpu_seconds": counters.get("cpu_seconds"),
    }


def _losses(
    model: GraspModel, entries: Mapping[str, TrainingEntry], s_min: float
) -> dict[str, Any]:
    """Losses on the scenes' own grasps as training validates, against the target that the model
    was trained for, from the noise level `s_min` on.
    """
    nearest_copy = bool(model.info.training.get("nearest_copy", False))
    config = TrainConfig(network=model.config, nearest_copy=nearest_copy)
    rack = GripperRack(model.config.gripper_tokens)
    pairs = validation_pairs(list(entries.values()), config)
    names = {gripper for _, gripper in pairs}
    result = validate(
        model,
        entries,
        pairs,
        {name: rack.tokens(name) for name in names},
        config,
        model.info.scene,
        dataclasses.replace(NoiseSchedule.of(model.config), s_min=s_min),
        {name: rack.fold(name) for name in names},
    )
    return {
        "diffusion": round(result.losses["diffusion"], 4) if result.losses else None,
        "per_band": {name: round(value, 4) for name, value in result.per_band.items()},
        "per_gripper": {name: round(value, 4) for name, value in result.per_gripper.items()},
    }


def comparison_table(content: dict[str, Any]) -> str:
    """The result of `compare_models` as two Markdown tables: losses and rates; why samples
    collide.
    """
    grippers = content["grippers"]
    head = ["model", "parameters", "poses", "CPU-s", "loss s < 0.1", "0.1 to 0.3", "over 0.3"]
    head += [f"{name}: {what}" for name in grippers for what in ("holds", "collides")]
    rates, causes = [], []
    for row in content["rows"]:
        bands = row["validation"]["per_band"]
        cells = [
            _called(row),
            f"{row['parameters'] / 1e6:.2f} M",
            "-" if row["poses"] is None else f"{row['poses'] / 1e6:.2f} M",
            "-" if row["cpu_seconds"] is None else f"{row['cpu_seconds']:,.0f}",
            *(f"{bands[b]:.3f}" if b in bands else "-" for b in ("low", "middle", "high")),
        ]
        for name in grippers:
            for what in ("unfiltered", "colliding"):
                rate = row[name][what]
                low, high = rate["ci95"]
                cells.append(f"{100 * rate['rate']:.0f} % [{100 * low:.0f}, {100 * high:.0f}]")
        rates.append(cells)
        found = [row[name]["colliding_at_pre_grasp"] for name in grippers]
        causes.append(
            [
                _called(row),
                *(
                    f"{one['over_5_mm']} / {one['over_10_mm']} / {one['out_of_sight']}"
                    f" of {one['count']}"
                    for one in found
                ),
            ]
        )
    why = ["model", *(f"{name}: over 5 mm / over 10 mm / out of sight" for name in grippers)]
    return (
        _table(head, rates) + "\nSamples that collide at the pre-grasp:\n\n" + _table(why, causes)
    )


def _called(row: dict[str, Any]) -> str:
    if "sampled_with" not in row:
        return row["model"]
    evaluations = SamplerSettings(**row["sampler"]).evaluations
    return f"{row['model']}, {row['sampled_with']}: {evaluations} evaluations"


def _table(head: list[str], rows: list[list[str]]) -> str:
    return (
        "\n".join(
            ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
            + ["| " + " | ".join(cells) + " |" for cells in rows]
        )
        + "\n"
    )
