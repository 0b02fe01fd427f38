"""The options of commands that synthesize grasps for a cloud, and what they make of them."""

from __future__ import annotations

import dataclasses
import functools
import logging
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import numpy as np
import tyro

from megrasp_core.errors import InvalidRequestError

from .common import Flag, progress_bar, read_region
from .viewing import Vector, gravity_of, length_factor, sensor_of

if TYPE_CHECKING:
    from megrasp_core.pointcloud import Cloud, Plane
    from megrasp_core.synthesizer import GraspSynthesizer, SynthesisRequest

__all__ = ["SynthesisOptions", "assumed_sensor", "floor_of", "with_bar"]

Answer = TypeVar("Answer")

LOGGER = logging.getLogger(__name__)
ASSUMED_HEIGHT = 1.0


@dataclasses.dataclass(frozen=True)
class SynthesisOptions:
    """What is asked of a synthesis, and of which cloud.

    Attributes:
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
        more_rounds: while no grasp is good, as many are drawn once more, at most so often; 0 is
            quickest.
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
        model: id or folder; the default for the kind of the gripper without it.
        device: cpu or cuda.
        threads: torch threads; as the process has them without it.
        fast: draw only as many poses as are returned.
        seed: of everything drawn; random without it, the one used is written.
    """

    gripper: str
    file: Annotated[
        tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="[CLOUD ...]")
    ] = ()
    cloud: tyro.conf.UseAppendAction[tuple[Path, ...]] = ()
    depth: Path | None = None
    intrinsics: Annotated[
        tuple[float, float, float, float] | None, tyro.conf.arg(metavar="FX FY CX CY")
    ] = None
    depth_scale: float | None = None
    color: Path | None = None
    mask: Path | None = None
    target: int | None = None
    num_grasps: Annotated[int, tyro.conf.arg(aliases=["-n"])] = 20
    drawn: int = 100
    more_rounds: int = 3
    frame: Literal["world", "optical"] = "world"
    gravity: Vector = None
    top_down: Flag = False
    sensor: Vector = None
    region: Path | None = None
    floor: Annotated[tuple[float, ...] | None, tyro.conf.arg(metavar="H | NX NY NZ D")] = None
    assume_empty: Flag = False
    scale: float = 1.0
    min_score: float = 0.0
    prefer: Literal["score", "high", "clear"] = "score"
    max_tilt: float | None = None
    approach_distance: float = 0.10
    approach_direction: Literal["tool", "gravity"] = "tool"
    model: str | None = None
    device: str = "cpu"
    threads: int | None = None
    fast: Flag = False
    seed: int | None = None

    @property
    def cloud_frame(self) -> str:
        """Name of the frame that everything is in."""
        return self.frame if self.depth is None else "optical"

    def request(self, **more: Any) -> SynthesisRequest:
        """What is asked for, without the sensor.

        Args:
            more: further attributes of `SynthesisRequest`.

        Raises:
            InvalidRequestError, GravityError: options contradict each other or are out of range.
        """
        _check_sources(
            self._clouds,
            self.depth,
            {"intrinsics": self.intrinsics, "depth-scale": self.depth_scale,
             "color": self.color, "mask": self.mask},
        )  # fmt: skip
        down = gravity_of(self.cloud_frame, self.gravity, self.top_down)
        box, walls = (None, True) if self.region is None else read_region(self.region)
        from megrasp_core.synthesizer import SynthesisRequest

        return SynthesisRequest(
            num_grasps=self.num_grasps,
            drawn=self.drawn,
            more_rounds=self.more_rounds,
            mode="fast" if self.fast else "default",
            gravity=down,
            region=box,
            walls=walls,
            floor=floor_of(self.floor),
            assume_empty=self.assume_empty,
            max_tilt=self.max_tilt,
            approach_distance=self.approach_distance,
            approach_direction=self.approach_direction,
            seed=self.seed,
            target=self.target,
            min_score=self.min_score,
            prefer=self.prefer,
            **more,
        )

    def read(self, request: SynthesisRequest) -> tuple[Cloud, SynthesisRequest]:
        """The cloud, and the request with where it was seen from.

        Raises:
            CloudError, InvalidRequestError: it cannot be read, or options contradict each other.
        """
        from megrasp_core.pointcloud import camera_matrix, read_depth_cloud

        factor, frame = length_factor(self.scale), self.cloud_frame
        if self.depth is not None:
            matrix = None if self.intrinsics is None else camera_matrix(*self.intrinsics)
            points = read_depth_cloud(
                self.depth, matrix, scale=self.depth_scale, color=self.color, mask=self.mask
            ).scaled(factor)
        else:
            points = _read_views(self._clouds, frame, factor, given=self.sensor is not None)
        return points, dataclasses.replace(request, sensor=sensor_of(points, frame, self.sensor))

    def placed(self, cloud: Cloud, request: SynthesisRequest) -> SynthesisRequest:
        """The request with a sensor over the middle of the cloud where nobody says where it was.

        Raises:
            CloudError, GravityError: units, frame or gravity cannot be what they are said to be.
        """
        from megrasp_core.pointcloud import check_view

        check_view(
            cloud.points,
            sensor=request.sensor,
            gravity=request.gravity,
            region=request.region,
            optical=self.cloud_frame == "optical",
        )
        if request.sensor is not None:
            return request
        assert request.gravity is not None
        x, y, z = (float(v) for v in request.gravity)
        return dataclasses.replace(request, sensor=assumed_sensor(cloud, (x, y, z)))

    def load(self) -> GraspSynthesizer:
        """Model and gripper.

        Raises:
            ModelError, UnknownGripperError, DescriptionError.
        """
        from megrasp_core.synthesizer import GraspSynthesizer

        return GraspSynthesizer.load(
            self.model, self.gripper, device=self.device, threads=self.threads
        )

    @property
    def _clouds(self) -> tuple[Path, ...]:
        return (*self.file, *self.cloud)


def with_bar(synthesize: Callable[..., Answer], *args: Any) -> Answer:
    """Call `GraspSynthesizer.synthesize`, or what takes on_step as it does, with a bar."""
    with progress_bar(None, "synthesize") as bar:

        def tell(phase: str, step: int, total: int) -> None:
            bar.total = total
            bar.n = step
            bar.set_description(phase)

        return synthesize(*args, on_step=tell)


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

    clouds = [read_cloud(path, optical=frame == "optical").scaled(factor) for path in paths]
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
    own = [
        path
        for path, cloud in zip(paths, clouds, strict=True)
        if cloud.viewpoint is not None and not cloud.viewpoint.any()
    ]
    if len(own) > 1 and not given:
        raise InvalidRequestError(
            f"{', '.join(map(str, own))} have their sensors at the origin, so each is in its own "
            "camera's frame; expected all views in one frame, each with where its sensor was. "
            "Transform them into a common frame first, or give --sensor 0 0 0 if all were taken "
            "from one place."
        )
    return functools.reduce(Cloud.joined, clouds)


def floor_of(numbers: tuple[float, ...] | None) -> Plane | float | None:
    """The surface that --floor gives: its height (m) of one number, else a plane of four.

    Raises:
        InvalidRequestError: they are no plane.
    """
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
