"""`megrasp data pack`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from megrasp_core.cli.common import Flag, progress_bar, say
from megrasp_core.errors import InvalidRequestError

if TYPE_CHECKING:
    from megrasp_core.storage import PackSource

__all__ = ["pack"]


def pack(
    out: tuple[Path, ...],
    into: Path | None = None,
    device: Flag = False,
    points: int | None = None,
) -> int:
    """Pack a library, the recipes of a data set, or what training needs of data sets, into small
    files.

    Recipes hold bin, object poses, grasps and labels; clouds are rendered again from the seed. A
    device pack holds thinned surfaces and labels, and `megrasp train --data FILE` reads it as it
    is.

    Try: megrasp data pack --out data/scenes --into models/scene_recipes.npz
         megrasp data pack --out data/scenes_a data/scenes_b --device --into scenes.mgpack

    Args:
        out: folder of `data grasps` or `data scenes`; with --device several folders of scenes, or
            files of recipes, which are rendered.
        into: folder of a library, or file; by default grasp_library, scene_recipes.npz or
            scenes.mgpack beside the (first) folder.
        device: make a device pack.
        points: with --device, most points kept of a scene.
    """
    if len(out) < 1:
        raise InvalidRequestError("--out names nothing; expected a folder to pack.")
    if device:
        return _pack_device(out, into or out[0].parent / "scenes.mgpack", points)
    if len(out) > 1 or points is not None:
        raise InvalidRequestError(
            "several folders, or --points, were given without --device; expected one folder, or "
            "--device for a device pack."
        )
    from megrasp_core.jobs import add_runs, runs_of
    from megrasp_core.library import load_library, pack_library
    from megrasp_core.scenes import write_recipes
    from megrasp_core.storage import SceneDataset

    folder = out[0]
    if (folder / "manifest.json").is_file():
        target = into or folder.parent / "scene_recipes.npz"
        dataset = SceneDataset(folder)
        size = write_recipes(target, iter(dataset))
        say(f"wrote the recipes of {len(dataset)} scenes to {target}, {size / 1e6:.1f} MB")
        return 0
    library = load_library(folder)
    target = into or folder.parent / "grasp_library"
    size = pack_library(library, target)
    add_runs(target, runs_of(folder))
    say(f"wrote {len(library)} pairs of object and gripper to {target}, {size / 1e6:.1f} MB")
    return 0


def _pack_device(out: tuple[Path, ...], target: Path, points: int | None) -> int:
    from megrasp_core.storage import PackSettings, write_pack

    settings = PackSettings() if points is None else PackSettings(points)
    sources = [_source(path) for path in out]
    count = sum(source.count for source in sources)
    with progress_bar(count, "scenes") as bar:
        size = write_pack(target, sources, settings, bar.update)
    say(
        f"wrote {count} scenes to {target}, {size / 1e6:.1f} MB, {size / 1e3 / count:.1f} kB a "
        "scene"
    )
    return 0


def _source(path: Path) -> PackSource:
    """A data set, or recipes whose clouds are rendered one by one as they are packed."""
    from dataclasses import asdict

    from megrasp_core.objects import ObjectSet
    from megrasp_core.scenes import SceneConfig, read_recipes, with_cloud
    from megrasp_core.storage import PackSource, SceneDataset

    if not path.is_file():
        dataset = SceneDataset(path)
        return PackSource(path.name, dataset.manifests[0], dataset, len(dataset))
    recipes, config, objects = read_recipes(path), SceneConfig(grippers=()), ObjectSet(())
    return PackSource(
        path.name,
        {"recipes": path.name, "config": asdict(config)},
        (with_cloud(recipe, config, objects) for recipe in recipes),
        len(recipes),
    )
