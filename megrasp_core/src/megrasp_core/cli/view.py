"""`megrasp view`."""

from __future__ import annotations

import dataclasses
import logging
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from .common import Flag, read_region, say
from .synthesis_options import assumed_sensor
from .viewing import gravity_of, length_factor, sensor_of

if TYPE_CHECKING:
    from viser import ViserServer

    from megrasp_core.pointcloud import Cloud
    from megrasp_core.synthesizer import GraspSynthesizer, RankedGrasp, SynthesisRequest
    from megrasp_core.viewer import CloudFile, Outcome, SceneViewer

__all__ = ["serve", "view"]

Vector = Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y Z")]
PERIOD = 0.5
"""Between two looks at a file that is followed (s)."""


def view(
    cloud: tyro.conf.Positional[Path | None] = None,
    gripper: str = "robotiq_2f85",
    num_grasps: Annotated[int, tyro.conf.arg(aliases=["-n"])] = 20,
    drawn: int = 100,
    frame: Literal["world", "optical"] = "world",
    gravity: Vector = None,
    top_down: Flag = False,
    sensor: Vector = None,
    region: Path | None = None,
    scale: float = 1.0,
    follow: Flag = False,
    objects: int = 8,
    model: str | None = None,
    device: str = "cpu",
    threads: int | None = None,
    fast: Flag = False,
    seed: int = 1,
    host: str = "127.0.0.1",
    port: int = 8080,
) -> int:
    """Look at a cloud, its grasps and why others were rejected, in a browser; Ctrl-C ends it.

    Without a cloud: a simulated bin, whose grasps can be executed. There is no login: only this
    machine reaches the page, unless --host says otherwise; over SSH use the command it prints.

    Try:
      megrasp view
      megrasp view bin.ply --gripper robotiq_3f
      megrasp view /dev/shm/latest.npz --frame optical --top-down --follow

    Args:
        cloud: as of synthesize.
        gripper: to begin with: registered name or folder of a gripper.yaml.
        num_grasps: most grasps to rank, to begin with.
        drawn: poses drawn, to begin with.
        frame: world: z up; optical: the camera's frame, gravity must be given.
        gravity: vector that points down in the frame of the cloud.
        top_down: with --frame optical: the camera looks straight down.
        sensor: where the camera was; as of synthesize.
        region: JSON or YAML file to begin with; the page changes it and hands it out.
        scale: metres per unit of the file.
        follow: read the file again whenever it is written; replace it in one go (write, then
            rename), as nobody waits for half a file.
        objects: of the simulated bin.
        model: id or folder; the default for the kind of the gripper without it.
        device: cpu or cuda.
        threads: torch threads.
        fast: to begin with.
        seed: of what is drawn, to begin with, and of the simulated bin.
        host: address to listen at.
        port: the next free one where it is in use.
    """
    from megrasp_core.synthesizer import GraspSynthesizer, SynthesisRequest
    from megrasp_core.viewer import open_server

    # A wrong address, or a viewer that is not installed, is told before the model is loaded.
    server = open_server(host, port)
    try:
        request = SynthesisRequest(
            num_grasps=num_grasps,
            drawn=drawn,
            mode="fast" if fast else "default",
            gravity=gravity_of(frame, gravity, top_down),
            seed=seed,
        )
        synthesizer = GraspSynthesizer.load(model, gripper, device=device, threads=threads)
        if cloud is None:
            viewer, file = _simulated(server, synthesizer, request, objects, seed), None
        else:
            viewer, file = _of_file(
                server, synthesizer, request, cloud, frame, sensor, region, scale
            )
        serve(server, (lambda: _follow(viewer, file)) if follow and file else None)
    finally:
        server.stop()
    return 0


def serve(server: ViserServer, tick: Callable[[], object] | None = None) -> None:
    """Say where the page is, then wait for Ctrl-C; `tick` is called now and then."""
    from megrasp_core.viewer import how_to_reach

    # A browser that breaks off a connection is nothing to tell the user about.
    logging.getLogger("websockets").setLevel(logging.CRITICAL)
    for line in how_to_reach(server):
        say(line)
    stop = threading.Event()
    try:
        while not stop.wait(PERIOD):
            if tick is not None:
                tick()
    except KeyboardInterrupt:
        say("stopped")


def _of_file(
    server: ViserServer,
    synthesizer: GraspSynthesizer,
    request: SynthesisRequest,
    path: Path,
    frame: str,
    sensor: tuple[float, float, float] | None,
    region: Path | None,
    scale: float,
) -> tuple[SceneViewer, CloudFile]:
    from megrasp_core.grippers import list_grippers
    from megrasp_core.pointcloud import read_cloud
    from megrasp_core.viewer import CloudFile, SceneViewer

    down, factor = request.gravity, length_factor(scale)
    box, walls = (None, True) if region is None else read_region(region)

    def read(path: Path) -> Cloud:
        cloud = read_cloud(path, optical=frame == "optical").scaled(factor)
        place = sensor_of(cloud, frame, sensor)
        if place is None:
            x, y, z = (0.0, 0.0, -1.0) if down is None else (float(v) for v in down)
            place = assumed_sensor(cloud.finite(), (x, y, z))
        return dataclasses.replace(cloud, viewpoint=place)

    file = CloudFile(path, read)
    request = dataclasses.replace(request, region=box, walls=walls)
    viewer = SceneViewer(
        server, synthesizer, file.read, request, grippers=list_grippers(), frame=frame
    )
    return viewer, file


def _simulated(
    server: ViserServer,
    synthesizer: GraspSynthesizer,
    request: SynthesisRequest,
    objects: int,
    seed: int,
) -> SceneViewer:
    from megrasp_core.cell.robot_cell import RobotCell
    from megrasp_core.grippers import list_grippers
    from megrasp_core.viewer import Outcome, SceneViewer

    assert synthesizer.gripper is not None
    names = list(dict.fromkeys([synthesizer.gripper.name, *list_grippers()]))
    own = [name for name in names[1:] if not name.endswith("_cad")]
    cell = RobotCell.procedural(objects, [synthesizer.gripper, *own], seed=seed)

    def execute(grasp: RankedGrasp, gripper: str) -> Outcome:
        cell.change_tool(gripper)
        done = cell.execute_grasp(grasp)
        took = ", ".join(done.removed) or "nothing"
        told = f"it holds: took {took}" if done.success else f"it fails: {done.error}"
        return Outcome(f"{told}; {done.objects_left} objects left")

    return SceneViewer(
        server,
        synthesizer,
        cell.capture,
        dataclasses.replace(request, region=cell.region),
        grippers=cell.rack,
        execute=execute,
    )


def _follow(viewer: SceneViewer, file: CloudFile) -> None:
    if file.changed():
        viewer.refresh()
