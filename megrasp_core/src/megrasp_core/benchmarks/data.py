"""Rates of the data generator, in CPU-seconds of one process (`megrasp bench --stage data`)."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from megrasp_core.evaluation.report import hardware
from megrasp_core.grippers import Gripper, gripper_folders, load_gripper
from megrasp_core.library import CandidateSettings, ObjectSurface, antipodal
from megrasp_core.objects import (
    ObjectModel,
    ObjectSeeds,
    ObjectSet,
    procedural_names,
    procedural_object,
)
from megrasp_core.simulation import (
    START_DEPTH,
    Bin,
    FreeSpaceRig,
    Reason,
    World,
    label_timestep,
    settle,
    start_depths,
)

from .trial_profile import profile_trials

REFERENCE_TIMESTEP = 0.002
NOISE = 5e-5
"""Standard deviation of the moves that show how far two runs at 2 ms agree (m)."""

FIRST_OBJECT = ObjectSeeds.DATA_BENCH.start

PROFILED = 4
"""Objects whose trials are profiled."""


def bench_data(
    grippers: Sequence[str],
    *,
    objects: int = 12,
    candidates: int = 20,
    poses: int = 4000,
    on_progress: Callable[[int, int], object] | None = None,
) -> dict[str, Any]:
    """Measure trials, their agreement with smaller steps and free joints, what a trial spends its
    time on, trials of the CAD model where there is one, and collision tests.

    Args:
        grippers: names or folders.
        objects: procedural objects, `candidates` grasps each.
        candidates: drawn per object and gripper.
        poses: tested for collision in a bin of ten objects.
        on_progress: called with grippers done and in all.

    Returns:
        Content of the result file; rates are per CPU-second of one process.
    """
    names = procedural_names(objects, FIRST_OBJECT)
    models = ObjectSet(names)
    heap = [procedural_object(FIRST_OBJECT + index) for index in range(10)]
    scene = settle(heap, bin=Bin(), rng=np.random.default_rng(0))
    rows = []
    for done, name in enumerate(grippers):
        gripper = load_gripper(name)
        world = scene.world(gripper=gripper, visual=False)
        rows.append(
            {
                "gripper": gripper.name,
                **_trials(gripper, models, candidates),
                "cad_full_trials_per_second": _plain_rate(f"{name}_cad", models, candidates),
                **_collisions(gripper, world, poses),
            }
        )
        if on_progress is not None:
            on_progress(done + 1, len(grippers))
    return {
        "stage": "data",
        "objects": objects,
        "candidates": candidates,
        "poses": poses,
        "reference_timestep": REFERENCE_TIMESTEP,
        "rows": rows,
        "hardware": hardware(),
    }


def _trials(gripper: Gripper, models: ObjectSet, candidates: int) -> dict[str, Any]:
    """Free-space trials: rate, yield with and without the span of the fingers, agreement."""
    seconds, count = {"label": 0.0, "reference": 0.0}, 0
    reasons: dict[str, int] = {}
    at_tcp = {"held": 0, "drawn": 0}
    same, same_moved, profiles = 0, 0, []
    for number, name in enumerate(models.names):
        model = models[name]
        surface = ObjectSurface(model)
        rig = FreeSpaceRig(gripper, model)
        reference = FreeSpaceRig(gripper, model, timestep=REFERENCE_TIMESTEP, locked=False)
        rng = np.random.default_rng(0)
        drawn = _draw(gripper, model, surface, candidates, rng, at_tcp=False)
        for pose in drawn:
            start = time.process_time()
            result = rig.trial(pose)
            spent = time.process_time() - start
            reasons[result.reason.value] = reasons.get(result.reason.value, 0) + 1
            if result.reason is Reason.START_COLLISION:
                continue
            count += 1
            seconds["label"] += spent
            start = time.process_time()
            finer = reference.trial(pose).success
            seconds["reference"] += time.process_time() - start
            moved = pose.copy()
            moved[:3, 3] += rng.normal(scale=NOISE, size=3)
            same += result.success == finer
            same_moved += reference.trial(moved).success == finer
        if number < PROFILED:
            profiles.append(profile_trials(rig, drawn))
        if gripper.description.kind == "hand":
            for pose in _draw(gripper, model, surface, candidates, rng, at_tcp=True):
                at_tcp["drawn"] += 1
                at_tcp["held"] += rig.trial(pose).success
    tested = sum(reasons.values())
    return {
        "timestep": label_timestep(gripper),
        "full_trials": count,
        "full_trials_per_second": count / max(seconds["label"], 1e-9),
        "plain_full_trials_per_second": count / max(seconds["reference"], 1e-9),
        "drawn": tested,
        "reasons": dict(sorted(reasons.items())),
        "yield": reasons.get(Reason.SUCCESS.value, 0) / max(tested, 1),
        "yield_at_tcp": at_tcp["held"] / at_tcp["drawn"] if at_tcp["drawn"] else None,
        "agrees_with_plain": same / max(count, 1),
        "plain_agrees_with_itself_moved": same_moved / max(count, 1),
        "profile": _mean_profile(profiles),
    }


def _mean_profile(profiles: list[dict[str, Any]]) -> dict[str, Any]:
    """Means over objects, weighted by their trials."""
    weights = [profile["trials"] for profile in profiles]
    if not sum(weights):
        return {}

    def mean(values: list[float]) -> float:
        return float(np.average(values, weights=weights))

    return {
        "trials": sum(weights),
        **{
            name: mean([profile[name] for profile in profiles])
            for name in ("steps", "contacts", "constraints", "iterations")
        },
        "shares": {
            stage: mean([profile["shares"][stage] for profile in profiles])
            for stage in profiles[0]["shares"]
        },
    }


def _plain_rate(name: str, models: ObjectSet, candidates: int) -> float | None:
    """Full trials a second at 2 ms with all joints free, of a gripper that may not be here."""
    if name not in gripper_folders():
        return None
    gripper, count, seconds = load_gripper(name), 0, 0.0
    for object_name in models.names:
        model = models[object_name]
        rig = FreeSpaceRig(gripper, model, timestep=REFERENCE_TIMESTEP, locked=False)
        rng, surface = np.random.default_rng(0), ObjectSurface(model)
        for pose in _draw(gripper, model, surface, candidates, rng, at_tcp=False):
            start = time.process_time()
            result = rig.trial(pose)
            if result.reason is not Reason.START_COLLISION:
                count, seconds = count + 1, seconds + time.process_time() - start
    return count / max(seconds, 1e-9)


def _draw(
    gripper: Gripper,
    model: ObjectModel,
    surface: ObjectSurface,
    count: int,
    rng: np.random.Generator,
    *,
    at_tcp: bool,
) -> NDArray[np.float64]:
    settings = CandidateSettings(finger_span=not at_tcp)
    return antipodal(
        model, gripper, count, rng, settings=settings, surface=surface
    ).object_from_gripper


def _collisions(gripper: Gripper, world: World, count: int) -> dict[str, Any]:
    """Start-collision tests of steep poses in a bin of ten objects."""
    rng = np.random.default_rng(1)
    pose = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (count, 1, 1))
    tip = rng.uniform([-0.18, -0.13, 0.0], [0.18, 0.13, 0.12], size=(count, 3))
    angle = rng.uniform(-np.pi, np.pi, size=count)
    pose[:, 0, 0], pose[:, 0, 1] = np.cos(angle), np.sin(angle)
    pose[:, 1, 0], pose[:, 1, 1] = np.sin(angle), -np.cos(angle)
    pose[:, :3, 3] = tip - np.einsum("nij,j->ni", pose[:, :3, :3], gripper.tcp)
    start = time.process_time()
    colliding = float((start_depths(world, pose) > START_DEPTH).mean())
    seconds = time.process_time() - start
    return {"collision_tests_per_second": count / max(seconds, 1e-9), "colliding": colliding}
