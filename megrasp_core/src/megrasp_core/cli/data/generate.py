"""`megrasp data grasps | scenes | stats`."""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from megrasp_core.cli.common import Flag, emit, progress_bar, say
from megrasp_core.cli.runs import Executor, executor_of, finished, run_bar
from megrasp_core.errors import InvalidRequestError

if TYPE_CHECKING:
    from megrasp_core.objects import ObjectSet

__all__ = ["grasps", "scenes", "stats"]

Grippers = Annotated[tuple[str, ...], tyro.conf.arg(aliases=["--grippers"])]
TRAINED = ("robotiq_2f85", "franka_hand", "robotiq_3f")


def grasps(
    out: Path,
    gripper: Grippers = TRAINED,
    procedural: int = 60,
    assets: bool = True,
    target: int | None = None,
    start: Path | None = None,
    executor: Executor = "local",
    address: str | None = None,
    workers: int = 1,
    seed: int = 0,
) -> int:
    """Label grasps of single objects in free space; a folder that exists is continued.

    Try: megrasp data grasps --out data/library --gripper robotiq_2f85 --workers 2
         megrasp data grasps --out data/library --start models/grasp_library --workers 2

    Args:
        out: library folder.
        gripper: names or folders.
        procedural: number of procedural objects.
        assets: take the train scans under MEGRASP_ASSETS as well, where it is set.
        target: successes, and as many failures, of an object and gripper; the generator's default
            without it.
        start: library, such as a packed one, whose pairs are taken over, so that it is continued.
        executor: local processes or a Ray cluster.
        address: of the Ray cluster.
        workers: processes or tasks in flight.
        seed: of the candidates.
    """
    from megrasp_core.jobs import add_runs, runs_of
    from megrasp_core.library import (
        LabelSettings,
        LibraryConfig,
        continue_library,
        generate_library,
        load_library,
    )

    settings = LabelSettings() if target is None else LabelSettings(target=target)
    config = LibraryConfig(tuple(gripper), _objects(procedural, assets), seed, settings)
    where = executor_of(executor, address, workers)
    if start is not None:
        say(f"{continue_library(load_library(start), out)} pairs taken over from {start}")
        add_runs(out, runs_of(start))
    with run_bar("grasps") as tell:
        summary = generate_library(out, config, where, on_progress=tell)
    return finished(summary, "pairs of object and gripper", out)


def scenes(
    out: Path,
    library: Path,
    num_scenes: Annotated[int, tyro.conf.arg(aliases=["-n"])] = 100,
    gripper: Grippers = TRAINED,
    grippers_per_scene: int | None = None,
    procedural_grippers: int = 0,
    trials: int = 12,
    moved: int = 2,
    bins: float = 0.75,
    obstacles: float = 0.3,
    hands_in_bins: float = 1.0,
    hands_on_tables: float = 1.0,
    procedural: int = 60,
    assets: bool = True,
    validation: Flag = False,
    executor: Executor = "local",
    address: str | None = None,
    workers: int = 1,
    seed: int = 0,
) -> int:
    """Build labelled scenes; a data set that exists is continued, the same seed gives the same
    scene on one machine.

    Try: megrasp data scenes --out data/scenes --library data/library -n 500 --workers 2

    Args:
        out: data set folder.
        library: grasp library: folder of `data grasps` or a packed file.
        num_scenes: how many, with the seeds seed, seed + 1, ...
        gripper: names or folders.
        grippers_per_scene: so many of them are labelled in a scene, drawn anew for each; all
            without it.
        procedural_grippers: one of so many procedural grippers is labelled besides in each scene.
        trials: free grasps tried in the heap, a gripper and scene.
        moved: successes moved a little and tried again, a gripper and scene.
        bins: share of the scenes that lie in a bin; the rest lie on a table.
        obstacles: share of the scenes with one to three things that must not be lifted.
        hands_in_bins: how often a hand is drawn for a bin for every time that a jaw is.
        hands_on_tables: the same for tables.
        procedural: number of procedural objects to draw from.
        assets: draw from the train scans under MEGRASP_ASSETS as well, where it is set.
        validation: draw from objects that training never sees instead: the validation tenth of
            the scans, and other procedural ones.
        executor: local processes or a Ray cluster.
        address: of the Ray cluster.
        workers: processes or tasks in flight.
        seed: of the first scene.
    """
    from megrasp_core.scenes import SceneConfig, SceneJob, generate_scenes

    if num_scenes < 1:
        raise InvalidRequestError(f"--num-scenes {num_scenes} was given; expected at least 1.")
    least = {"trials": trials, "moved": moved, "procedural-grippers": procedural_grippers}
    for name, value in least.items():
        if value < 0:
            raise InvalidRequestError(f"--{name} {value} was given; expected 0 or more.")
    for name, value in {"bins": bins, "obstacles": obstacles}.items():
        if not 0.0 <= value <= 1.0:
            raise InvalidRequestError(f"--{name} {value} was given; expected a share from 0 to 1.")
    if min(hands_in_bins, hands_on_tables) < 0.0:
        raise InvalidRequestError(
            f"--hands-in-bins {hands_in_bins} and --hands-on-tables {hands_on_tables} were "
            "given; expected 0 or more."
        )
    scene = SceneConfig(
        grippers=tuple(gripper),
        grippers_per_scene=grippers_per_scene,
        procedural_grippers=procedural_grippers,
        # A third of them from the library alone, whose grasps hold more often.
        judged=trials - trials // 3,
        judged_library=trials // 3,
        perturbed=moved,
        bin_share=bins,
        obstacle_share=obstacles,
        hands_in_bins=hands_in_bins,
        hands_on_tables=hands_on_tables,
    )
    job = SceneJob(scene, library, _objects(procedural, assets, validation))
    seeds = range(seed, seed + num_scenes)
    with run_bar("scenes") as tell:
        summary = generate_scenes(
            out, job, seeds, executor_of(executor, address, workers), on_progress=tell
        )
    return finished(summary, "scenes", out)


def stats(
    out: Annotated[tuple[Path, ...], tyro.conf.arg(aliases=["--data"])],
    pictures: Path | None = None,
    card: Path | None = None,
    command: str | None = None,
) -> int:
    """Counts of a data set or a library, as JSON, and pictures of them.

    Try:
      megrasp data stats --out data/library --pictures data/pictures --card data/card.md
      megrasp data stats --data models/scene_recipes/eleven*.npz

    Args:
        out: folder of `data grasps` or a packed library; or folders of `data scenes` or `data
            robust`, files of recipes and device packs, which are counted together.
        pictures: folder to draw into: of a library yield.png, grippers_per_object.png, objects.png
            and grasps.png, of scenes scenes.png.
        card: markdown file to write about a library; the counts go to stats.json beside it.
        command: with --card, the command that made the library.
    """
    from megrasp_core.storage.device_pack import SUFFIX

    if command is not None and card is None:
        raise InvalidRequestError("--command was given without --card; expected both.")
    if not out:
        raise InvalidRequestError("--out was given without a path; expected at least one.")
    scenes = [(p / "manifest.json").is_file() or p.suffix in (SUFFIX, ".npz") for p in out]
    if len(out) == 1 and not scenes[0]:
        return _library_stats(out[0], pictures, card, command)
    if card is not None:
        raise InvalidRequestError(
            f"--card was given and {out[0]} holds scenes; expected a grasp library."
        )
    return _scene_stats(out, pictures)


def _scene_stats(paths: tuple[Path, ...], pictures: Path | None) -> int:
    from megrasp_core.jobs import runs_of
    from megrasp_core.scenes import read_recipes
    from megrasp_core.storage import DevicePack, SceneDataset, scene_stats

    recipes = [path for path in paths if path.suffix == ".npz"]
    others = [path for path in paths if path.suffix != ".npz"]
    if recipes and others:
        raise InvalidRequestError(
            f"recipes ({recipes[0]}) and data with clouds ({others[0]}) were given; expected one "
            "or the other, since recipes have no points. Ask for them one after another."
        )
    parts = [read_recipes(path) for path in recipes]
    parts += [DevicePack(path) if path.is_file() else SceneDataset(path) for path in others]
    runs = [run for path in others for run in runs_of(path)]
    with progress_bar(sum(map(len, parts)), "scenes") as bar:
        content = scene_stats(chain.from_iterable(parts), runs, lambda _: bar.update())
    emit(content, None)
    if pictures is not None:
        from megrasp_core.drawing.data_charts import draw_scene_stats

        say(f"wrote {draw_scene_stats(content, pictures / 'scenes.png')}")
    return 0


def _library_stats(
    out: Path, pictures: Path | None, card: Path | None, command: str | None
) -> int:
    from megrasp_core.jobs import runs_of
    from megrasp_core.library import library_card, library_stats, load_library, object_facts
    from megrasp_core.library.card import STATS
    from megrasp_core.objects import ObjectSet

    library, objects = load_library(out), ObjectSet(())
    names = sorted({entry.object_name for entry in library})
    with progress_bar(len(names), "objects") as bar:
        facts, missing = object_facts(names, objects, bar.update)
    content = {**library_stats(library, facts), "runs": runs_of(out)}
    emit(content, None if card is None else card.with_name(STATS))
    if pictures is not None:
        from megrasp_core.drawing.library_pictures import library_pictures

        drawn, notes = library_pictures(
            library, content, facts, missing, pictures, objects=objects
        )
        for file in drawn:
            say(f"wrote {file}")
        for note in notes:
            say(f"note: {note}")
    if card is not None:
        card.write_text(library_card(content, command))
        say(f"wrote {card}")
    return 0


def _objects(procedural: int, assets: bool, validation: bool = False) -> ObjectSet:
    import os

    from megrasp_core.objects import training_objects, validation_objects

    if procedural < 0:
        raise InvalidRequestError(f"--procedural {procedural} was given; expected 0 or more.")
    objects = validation_objects if validation else training_objects
    return objects(procedural, assets=assets and bool(os.environ.get("MEGRASP_ASSETS")))
