"""`megrasp data render`: from scene recipes back to a data set."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from megrasp_core.cli.common import progress_bar, say
from megrasp_core.errors import InvalidRequestError

__all__ = ["render"]


def render(recipes: tuple[Path, ...], out: Path) -> int:
    """Render the clouds of scene recipes, into a data set that `megrasp train` reads.

    A data set that exists is continued. Scans are looked for under MEGRASP_ASSETS.

    Try: megrasp data render --recipes models/scene_recipes/eleven*.npz --out data/scenes

    Args:
        recipes: files of `data pack`.
        out: data set folder.
    """
    from dataclasses import asdict

    from megrasp_core.jobs import StopSignals
    from megrasp_core.objects import ObjectSet
    from megrasp_core.scenes import SceneConfig, read_recipes, with_cloud
    from megrasp_core.storage import SceneWriter

    if not recipes:
        raise InvalidRequestError("--recipes names nothing; expected files of `data pack`.")
    scenes = [scene for file in recipes for scene in read_recipes(file)]
    twice = [seed for seed, count in Counter(s.seed for s in scenes).items() if count > 1]
    if twice:
        raise InvalidRequestError(
            f"{len(twice)} scenes, seed {twice[0]} for one, are in two of the files; expected "
            "each once. Render the files into different folders."
        )
    config, objects = SceneConfig(grippers=()), ObjectSet(())
    writer = SceneWriter(out, {"config": asdict(config), "from": "recipes"})
    made = 0
    try:
        with progress_bar(len(scenes), "scenes") as bar, StopSignals() as signals:
            for scene in scenes:
                if scene.seed not in writer:
                    record = with_cloud(scene, config, objects)
                    with signals.held_back():
                        writer.add(record)
                    made += 1
                bar.update()
    finally:
        writer.close()
    say(f"rendered {made} of {len(scenes)} scenes to {out}")
    return 0
