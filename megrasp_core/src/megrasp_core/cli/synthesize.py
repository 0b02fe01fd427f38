"""`megrasp synthesize`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro

from .common import Flag, say
from .synthesis_options import SynthesisOptions, with_bar

if TYPE_CHECKING:
    from megrasp_core.synthesizer import Synthesis

__all__ = ["report", "synthesize"]


def synthesize(
    synthesis: Annotated[SynthesisOptions, tyro.conf.OmitArgPrefixes],
    *,
    all: Flag = False,
    out: Path | None = None,
    picture: Path | None = None,
) -> int:
    """Ranked grasps for a point cloud, several of them, or a depth image.

    Try:
      megrasp synthesize bin.ply --gripper robotiq_2f85 -n 20 --out grasps.json --picture bin.png
      megrasp synthesize view.npz --gripper robotiq_3f --frame optical --top-down --region bin.yaml
      megrasp synthesize view.pcd --gripper my_gripper/ --frame optical --gravity 0 0.5 0.87
      megrasp synthesize mm.ply --gripper franka_hand --scale 0.001 --sensor 0 0 0.8
      megrasp synthesize left.ply right.ply --gripper franka_hand --region bin.yaml
      megrasp synthesize --depth d.png --intrinsics 615 615 320 240 --top-down --gripper my_gripper
      megrasp synthesize --depth d.npz --mask m.png --target 3 --top-down --gripper franka_hand

    Args:
        synthesis: what is asked for, and of which cloud.
        all: return the poses that fail the check as well, last.
        out: grasps.json.
        picture: PNG of the cloud and the best grasps.
    """
    # Before anything slow is loaded: bad numbers are told at once.
    request = synthesis.request(keep_all=all)
    cloud, request = synthesis.read(request)
    request = synthesis.placed(cloud, request)
    synthesizer = synthesis.load()
    result = with_bar(synthesizer.synthesize, cloud, request)
    report(result)
    if out is not None:
        result.write_json(out, synthesis.cloud_frame)
        say(f"wrote {out}")
    if picture is not None:
        from megrasp_core.drawing.grasp_picture import save_grasp_picture

        assert synthesizer.gripper is not None
        save_grasp_picture(
            picture,
            cloud,
            result,
            synthesizer.gripper,
            region=request.region,
            gravity=request.gravity,
        )
        say(f"wrote {picture}")
    return 0 if any(grasp.collision_free for grasp in result.grasps) else 1


def report(result: Synthesis) -> None:
    """Say what was found and why the rest was not returned."""
    for note in result.notes:
        say(f"note: {note}")
    if result.bin_empty:
        say(
            "nothing to grasp: only the support surface is left, nothing stands out of it by "
            "10 mm. Check the region if there is something."
        )
        return
    free = sum(grasp.collision_free for grasp in result.grasps)
    counts = ", ".join(f"{name} {number}" for name, number in result.rejected.items() if number)
    say(
        f"{free} grasps for {result.gripper} with {result.model}: {result.drawn} drawn, "
        f"{result.evaluations} evaluations, {result.timing['total']:.2f} s, seed {result.seed}"
    )
    say(f"not returned: {counts or 'none'}")
    if not free:
        for hint in result.hints:
            say(f"  {hint}")
    for rank, grasp in enumerate(result.grasps[:5], start=1):
        x, y, z = grasp.world_from_tcp[:3, 3]
        width = "" if np.isnan(grasp.width) else f", width {1000 * grasp.width:.0f} mm"
        if grasp.share:
            width += f", fingers start {1000 * grasp.opening:.0f} mm apart"
        if grasp.object is not None:
            width += f", object {grasp.object}"
        note = "" if grasp.collision_free else f", fails: {grasp.reason}"
        say(f"{rank:3d}  score {grasp.score:.2f}  TCP {x:.3f} {y:.3f} {z:.3f}{width}{note}")
