"""`megrasp data look`: one scene as a depth camera sees it, without and with noise."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from megrasp_core.cli.common import say
from megrasp_core.errors import InvalidRequestError

__all__ = ["look"]

Views = Literal["dense", "sparse", "top_down"]
Noise = Literal["default", "structured_light", "stereo", "none"]


def look(
    out: Path = Path("look.png"),
    views: Views = "top_down",
    noise: Noise = "default",
    off: Annotated[tuple[str, ...], tyro.conf.arg(metavar="EFFECT [EFFECT ...]")] = (),
    seed: int = 0,
    objects: int = 8,
) -> int:
    """Draw a scene of procedural objects, clean and noisy side by side.

    Depth image, cloud, and which effect lost which pixel. Top-down views look into a bin, the
    others at a table.

    Try: megrasp data look --seed 3 --views top_down --noise structured_light --out look.png

    Args:
        out: picture to write.
        views: ten cameras around, one oblique camera, or one above a bin.
        noise: of the camera.
        off: effects to switch off: axial, edges, steep, shiny, quantisation, shadow, range,
            far_wall.
        seed: of the scene, the camera, the noise, the light and the paint.
        objects: how many fall.
    """
    import numpy as np

    from megrasp_core.drawing.noise_picture import noise_picture
    from megrasp_core.objects import training_objects
    from megrasp_core.scenes import SceneConfig, draw_layout
    from megrasp_core.simulation import Light, build_world, noise_named, rig

    if objects < 1:
        raise InvalidRequestError(f"--objects {objects} was given; expected at least 1.")
    in_bin = views == "top_down"
    config = SceneConfig(
        grippers=(), objects=(objects, objects), bin_share=float(in_bin), obstacle_share=0.0
    )
    chosen = training_objects(60, assets=False)
    layout = draw_layout(seed, config, chosen)
    world = build_world([chosen[name] for name in layout.object_names], bin=layout.bin)
    world.set_object_poses(layout.matrices)
    rng = np.random.default_rng(seed)
    model = noise_named(noise)
    if model is not None:
        model = model.without(*off)
    noise_picture(
        world,
        rig(views, rng),
        model,
        seed,
        Light.drawn(rng),
        out,
        f"view {views}, noise {noise}{' without ' + ', '.join(off) if off else ''}, seed {seed}",
    )
    say(f"wrote {out}")
    return 0
