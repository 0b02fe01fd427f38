"""`megrasp synthesize`."""

from __future__ import annotations

import dataclasses
import functools
import logging
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import tyro

from megrasp_core.errors import InvalidRequestError

from .common import Flag, progress_bar, read_region, say
from .viewing import Vector, gravity_of, length_factor, sensor_of

if TYPE_CHECKING:
    from megrasp_core.pointcloud import Cloud, Plane
    from megrasp_core.synthesizer import Synthesis

__all__ = ["assumed_sensor", "synthesize"]

LOGGER = logging.getLogger(__name__)
ASSUMED_HEIGHT = 1.0


def synthesize(
    file: Annotated[
        tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="[CLOUD ...]")
    ] = (),
    *,
    gripper: str,
    cloud: tyro.conf.UseAppendAction[tuple[Path, ...]] = (),
    depth: Path | None = None,
    intrinsics: Annotated[
        tuple[float, float, float, float] | None, tyro.conf.arg(metavar="FX FY CX CY")
    ] = None,
    depth_scale: float | None = None,
    color: Path | None = None,
    mask: Path | None = None,
    target: int | None = None,
    num_grasps: Annotated[int, tyro.conf.arg(aliases=["-n"])] = 20,
    drawn: int = 100,
    frame: Literal["world", "optical"] = "world",
    gravity: Vector = None,
    top_down: Flag = False,
    sensor: Vector = None,
    region: Path | None = None,
    floor: Annotated[tuple[float, ...] | None, tyro.conf.arg(metavar="H | NX NY NZ D")] = None,
    assume_empty: Flag = False,
    scale: float = 1.0,
    min_score: float = 0.0,
    prefer: Literal["score", "high", "clear"] = "score",
    max_tilt: float | None = None,
    approach_distance: float = 0.10,
    approach_direction: Literal["tool", "gravity"] = "tool",
    model: str | None = None,
    device: str = "cpu",
    threads: int | None = None,
    fast: Flag = False,
    all: Flag = False,
    seed: int | None = None,
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
        file: .ply, .pcd, .npz (array points, optional colors and viewpoint) or .npy; metres.
            Several: views of one scene in one frame, each with its own viewpoint.
        cloud: the same, once for each file.
        depth: depth image in place of a cloud: .png or .tif of 16 bits, .npy, or .npz with depth
            and K. The frame is optical then.
        intrinsics: of the depth image (pixels); the K of an .npz without it.
        depth_scale: metres per unit of the depth image; 0.001 for whole numbers, 1 for floats.
        color: picture of the same size as the depth image.
        mask: picture of whole numbers of the same size: one for each object, 0 elsewhere. Every
            grasp says then which object it takes.
        target: grasps of the object with this number only; the others are obstacles.
        gripper: registered name (megrasp gripper list) or folder of a gripper.yaml.
        num_grasps: most grasps to return.
        drawn: poses drawn; the best go through the restarts.
        frame: world: z up; optical: the camera's frame, gravity must be given.
        gravity: vector that points down in the frame of the cloud.
        top_down: with --frame optical: the camera looks straight down, gravity is +z.
        sensor: where the camera was. Default: the file's viewpoint; optical: the origin; world:
            1 m over the middle of the cloud.
        region: JSON or YAML file with pose (7 numbers) and size (3) of the bin's inside; walls:
            false where it is no bin.
        floor: height (m) of the surface under the objects over the origin, against gravity; or the
            plane nx x + ny y + nz z = d, whose normal points up. Where the cloud does not show it.
        assume_empty: where nothing was seen there is floor or wall, also in small patches.
        scale: metres per unit of the file: 0.001 for millimetres, 0.0254 for inches.
        min_score: grasps below this score are not returned.
        prefer: which grasp comes first: best score, highest, or most clearance.
        max_tilt: largest angle between gripper +Z and gravity (rad).
        approach_distance: from approach pose to pre-grasp (m).
        approach_direction: tool: along gripper Z; gravity: straight down.
        model: id or folder; the default model without it.
        device: cpu or cuda.
        threads: torch threads; as the process has them without it.
        fast: draw only as many poses as are returned.
        all: return the poses that fail the check as well, last.
        seed: of everything drawn; random without it, the one used is written.
        out: grasps.json.
        picture: PNG of the cloud and the best grasps.
    """
    clouds = (*file, *cloud)
    _check_sources(clouds, depth, {"intrinsics": intrinsics, "depth-scale": depth_scale,
                                   "color": color, "mask": mask})  # fmt: skip
    if depth is not None:
        frame = "optical"
    down = gravity_of(frame, gravity, top_down)
    box, walls = (None, True) if region is None else read_region(region)
    from megrasp_core.pointcloud import camera_matrix, check_view, read_depth_cloud
    from megrasp_core.synthesizer import GraspSynthesizer, SynthesisRequest

    # Before anything slow is loaded: bad numbers are told at once.
    request = SynthesisRequest(
        num_grasps=num_grasps,
        drawn=drawn,
        mode="fast" if fast else "default",
        gravity=down,
        region=box,
        walls=walls,
        floor=_floor(floor),
        assume_empty=assume_empty,
        max_tilt=max_tilt,
        approach_distance=approach_distance,
        approach_direction=approach_direction,
        seed=seed,
        keep_all=all,
        target=target,
        min_score=min_score,
        prefer=prefer,
    )
    if depth is not None:
        matrix = None if intrinsics is None else camera_matrix(*intrinsics)
        points = read_depth_cloud(depth, matrix, scale=depth_scale, color=color, mask=mask)
        points = points.scaled(length_factor(scale))
    else:
        points = _read_views(clouds, frame, length_factor(scale), given=sensor is not None)
    seen_from = sensor_of(points, frame, sensor)
    check_view(
        points.points, sensor=seen_from, gravity=down, region=box, optical=frame == "optical"
    )
    if seen_from is None:
        seen_from = assumed_sensor(points, down)
    request = dataclasses.replace(request, sensor=seen_from)
    synthesizer = GraspSynthesizer.load(model, gripper, device=device, threads=threads)
    with progress_bar(None, "synthesize") as bar:

        def tell(phase: str, step: int, total: int) -> None:
            bar.total = total
            bar.n = step
            bar.set_description(phase)

        result = synthesizer.synthesize(points, request, on_step=tell)
    _report(result)
    if out is not None:
        result.write_json(out, frame)
        say(f"wrote {out}")
    if picture is not None:
        from megrasp_core.drawing.grasp_picture import save_grasp_picture

        assert synthesizer.gripper is not None
        save_grasp_picture(picture, points, result, synthesizer.gripper, region=box, gravity=down)
        say(f"wrote {picture}")
    return 0 if any(grasp.collision_free for grasp in result.grasps) else 1


def _check_sources(
    clouds: tuple[Path, ...], depth: Path | None, of_depth: dict[str, object]
) -> None:
    given = [f"--{name}" for name, value in of_depth.items() if value is not None]
    if depth is None and given:
        raise InvalidRequestError(
            f"{', '.join(given)} {'was' if len(given) == 1 else 'were'} given without --depth; "
            "expected them with a depth image only."
        )
    if bool(clouds) == (depth is not None):
        what = (
            "a cloud and --depth were given" if clouds else "neither a cloud nor --depth is given"
        )
        raise InvalidRequestError(f"{what}; expected one of them.")


def _read_views(paths: tuple[Path, ...], frame: str, factor: float, *, given: bool) -> Cloud:
    """The points of all files; of several, each with where it was seen from."""
    from megrasp_core.pointcloud import Cloud, read_cloud

    clouds = [read_cloud(path).scaled(factor) for path in paths]
    if len(clouds) > 1 and not given:
        for path, cloud in zip(paths, clouds, strict=True):
            if cloud.viewpoint is None and frame == "world":
                raise InvalidRequestError(
                    f"{path} does not say where its sensor was, and there are {len(clouds)} "
                    "views; expected a viewpoint in each file. Save it (PCD: VIEWPOINT, .npz: "
                    "viewpoint), or give --sensor X Y Z if all views are from one place."
                )
            if cloud.viewpoint is None:
                raise InvalidRequestError(
                    f"{len(clouds)} views were given with --frame optical and {path} has no "
                    "viewpoint; expected all views in one frame, each with where its sensor was. "
                    "Transform them into a common frame first."
                )
    return functools.reduce(Cloud.joined, clouds)


def _floor(numbers: tuple[float, ...] | None) -> Plane | float | None:
    if numbers is None or len(numbers) == 1:
        return None if numbers is None else numbers[0]
    from megrasp_core.pointcloud import Plane

    return Plane.of(numbers)


def assumed_sensor(cloud: Cloud, down: tuple[float, float, float]) -> np.ndarray:
    """A place over the middle of a cloud that does not tell its sensor, with a warning."""
    direction = np.asarray(down) / np.linalg.norm(down)
    place = cloud.points.mean(axis=0) - ASSUMED_HEIGHT * direction
    LOGGER.warning(
        "the file does not say where the sensor was; assuming %s, %g m over the middle of the "
        "cloud. Give --sensor X Y Z.",
        np.round(place, 3).tolist(),
        ASSUMED_HEIGHT,
    )
    return place


def _report(result: Synthesis) -> None:
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
