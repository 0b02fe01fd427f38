"""`megrasp_call view`: the browser viewer on the clouds of a topic."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro
from builtin_interfaces.msg import Time
from rclpy.exceptions import InvalidTopicNameException
from rclpy.executors import ExternalShutdownException
from rclpy.expand_topic_name import expand_topic_name
from rclpy.validate_full_topic_name import validate_full_topic_name
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from megrasp_core.cli.common import Flag, read_region, say
from megrasp_core.cli.synthesis_options import floor_of
from megrasp_core.cli.viewing import Vector
from megrasp_core.errors import CloudError, GravityError, InvalidRequestError, MegraspError
from megrasp_ros.client import GraspClient, GraspServerError
from megrasp_ros.errors import NoCloudError, TransformError
from megrasp_ros.recording import server_settings
from megrasp_ros.server.frames import FrameSource
from megrasp_ros.server.parameter_table import TABLE
from megrasp_ros.server.parameters import Settings, settings_of
from megrasp_ros.server.requests import automatic_request
from megrasp_ros.server.sensing import Sensed, Sensing
from megrasp_ros.server.sensor_source import others_with
from megrasp_ros.server.synthesis import options_of
from megrasp_ros.server.worker import Job

from .checks.input import type_name
from .checks.server import cloud_topic

if TYPE_CHECKING:
    from viser import ViserServer

    from megrasp_core.grippers import Gripper
    from megrasp_core.pointcloud import Cloud
    from megrasp_core.synthesizer import GraspSynthesizer, RankedGrasp
    from megrasp_core.viewer import Outcome, SceneViewer

__all__ = ["LiveCloud", "as_the_server", "live_viewer", "view"]

DISCOVERY = 3.0
"""A server that runs is found within this time (s)."""
ATTEMPT = 300.0
"""Longest wait (s) for a cell to mount a gripper, and to execute a grasp."""


def view(
    topic: str = "",
    frame: str = "",
    gripper: str = "",
    gravity: Vector = None,
    sensor: Vector = None,
    region: Path | None = None,
    floor: Annotated[tuple[float, ...] | None, tyro.conf.arg(metavar="H | NX NY NZ D")] = None,
    follow: Flag = False,
    num_grasps: Annotated[int | None, tyro.conf.arg(aliases=["-n"])] = None,
    drawn: int | None = None,
    model: str | None = None,
    device: str = "cpu",
    threads: int | None = None,
    fast: Flag = False,
    seed: int = 1,
    server: str = "grasp_server",
    namespace: str = "",
    timeout: float = 10.0,
    host: str = "127.0.0.1",
    port: int = 8080,
) -> int:
    """Look at what the camera sees, its grasps and why others were rejected, in a browser; Ctrl-C
    ends it.

    The page's synthesizer is its own; frame, gravity, region, floor, gripper and the rest are as a
    running grasp_server has them, or as they are by default. Where a cell offers `execute_grasp`,
    grasps can be executed. There is no login: only this machine reaches the page, unless --host
    says otherwise; over SSH use the command it prints.

    Try:
      megrasp_call view
      megrasp_call view --topic /camera/camera/depth/color/points --gravity 0 0 1 --follow
      megrasp_call view --namespace /cell_2 --frame base_link --region bin.yaml

    Args:
        topic: with clouds; by default the one that the server listens to, else `points`.
        frame: to show the cloud in, by tf2; by default the server's planning_frame, or that of the
            cloud. In another one the server's gravity, region and floor do not count.
        gripper: to begin with: registered name or folder of a gripper.yaml.
        gravity: vector that points down in that frame; a camera's frame needs it.
        sensor: where the camera was, in the frame of the cloud (m); its origin without it.
        region: JSON or YAML with pose and size in that frame, to begin with.
        floor: height (m) of the surface under the objects, or the plane nx x + ny y + nz z = d.
        follow: show new clouds by themselves, twice a second at most, as long as no grasps are
            shown; "Read the cloud again" goes on after that.
        num_grasps: most grasps to rank, to begin with.
        drawn: poses drawn, to begin with.
        model: id or folder; the default for the kind of the gripper without it.
        device: cpu or cuda.
        threads: torch threads.
        fast: to begin with.
        seed: of what is drawn, to begin with.
        server: name of the node grasp_server.
        namespace: of server, cell and topic.
        timeout: longest wait (s) for a cloud, and for the transform of one.
        host: address to listen at.
        port: the next free one where it is in use.
    """
    from megrasp_core.cli.view import serve
    from megrasp_core.synthesizer import GraspSynthesizer
    from megrasp_core.viewer import open_server

    changes: dict[str, Any] = {"cloud_timeout": timeout, "tf_timeout": timeout}
    # For looking, a cloud counts by when it comes.
    changes["cloud_max_age"] = 0.0
    if gravity is not None:
        changes["gravity"] = np.array(gravity)
    if sensor is not None:
        changes["sensor_origin"] = np.array(sensor)
    if region is not None:
        changes["region"], changes["region_walls"] = read_region(region)
    if floor is not None:
        changes["floor"] = floor_of(floor)
    if num_grasps is not None:
        changes["num_grasps"] = num_grasps
    if drawn is not None:
        changes["drawn"] = drawn
    try:
        with GraspClient.open("megrasp_view", namespace=namespace, timeout=ATTEMPT) as client:
            # A wrong address, or a viewer that is not installed, is told first.
            page = open_server(host, port)
            try:
                settings, on = as_the_server(client, server, frame)
                settings = replace(settings, **changes)
                load = partial(GraspSynthesizer.load, model, device=device, threads=threads)
                mode = "fast" if fast else "default"
                with closing(LiveCloud(client, settings, topic, server)) as live:
                    viewer = live_viewer(page, live, gripper or on, load, mode=mode, seed=seed)
                    say(f"{live.name} in {viewer.frame!r}")
                    if follow:
                        live.follow()
                    serve(page, (lambda: live.changed and viewer.follow()) if follow else None)
            finally:
                page.stop()
    except KeyboardInterrupt:
        say("stopped")
    return 0


class LiveCloud:
    """The scene as the server would take it from its sensor, and the cell that works on it.

    Attributes:
        settings: of the server, as far as options do not say otherwise.
        header: frame and stamp of the last cloud that was read.
        gravity: (3,) in its frame.
    """

    def __init__(
        self,
        client: GraspClient,
        settings: Settings,
        topic: str = "",
        server: str = "grasp_server",
    ) -> None:
        """Nothing is subscribed but tf2's topics.

        Raises:
            InvalidRequestError: the topic is no name.
        """
        self._client, self._node, self._server = client, client.node, server
        self._following = False
        self.settings = replace(settings, input="points") if topic else settings
        topic = topic or cloud_topic(self._node, server) or "points"
        try:
            full = expand_topic_name(topic, self._node.get_name(), self._node.get_namespace())
            validate_full_topic_name(full)
        except (ValueError, InvalidTopicNameException) as error:
            raise InvalidRequestError(
                f"topic {topic!r} was given; expected the name of one with clouds, such as "
                "/camera/camera/depth/color/points."
            ) from error
        self._topic = self._node.resolve_topic_name(topic)
        self.header, self.gravity = Header(), np.zeros(3)
        frames = FrameSource(self._node)
        frames.listen(self.settings)
        self._sensing = Sensing(self._node, frames, topic)
        self._source = self._sensing.source(self.settings.input)
        self._not_before, self._count = Time(), 0
        self._job, self._reading = Job("view", lambda _: None), threading.Lock()

    def close(self) -> None:
        """End a wait for a cloud in another thread."""
        self._job.cancel("the command was ended.")
        with self._reading:
            pass

    def read(self) -> Cloud:
        """The newest cloud, with the place of its sensor, in the frame to show it in.

        Raises:
            MegraspError: none comes, or it cannot be used, with what to do.
        """
        with self._reading:
            sensed = self._sensed()
        before, frame = self.header.frame_id, sensed.header.frame_id
        if before and frame != before:
            raise CloudError(
                f"the cloud is in {frame!r} now; expected {before!r}, as before. Start this "
                "command again, or give --frame."
            )
        self.header, self.gravity = sensed.header, sensed.gravity
        return sensed.cloud

    def follow(self) -> None:
        """Listen all the time from now on; only the newest cloud is kept."""
        self._following = True
        self._sensing.follow(self.settings, continuous=True, on_arrival=None)

    @property
    def name(self) -> str:
        """Where its clouds come from."""
        return self._topic if self.settings.input == "points" else "depth images"

    @property
    def changed(self) -> bool:
        """Whether another cloud has come since the last one was read."""
        return self._source.count != self._count

    @property
    def executes(self) -> bool:
        """Whether a cell offers `execute_grasp`."""
        return self._offered("execute_grasp/_action/send_goal")

    def execute(self, grasp: RankedGrasp, synthesizer: GraspSynthesizer, seed: int) -> Outcome:
        """Let the cell mount the gripper, where it changes tools, and try the grasp; clouds of
        before do not count any more.

        Raises:
            MegraspError: it was not tried.
        """
        from megrasp_core.viewer import Outcome
        from megrasp_ros.server.grasp_messages import grasp_array

        gripper = synthesizer.gripper
        assert gripper is not None
        model = synthesizer.model.model_id
        grasps = grasp_array(gripper, [grasp], header=self.header, model_id=model, seed=seed)
        try:
            if self._offered("change_tool"):
                changed = self._client.change_tool(gripper.name)
                if not changed.success:
                    raise GraspServerError(0, f"{gripper.name} is not on: {changed.message}")
            done = self._client.execute(grasps, grasps.grasps[0])
            if done.error_code:
                raise GraspServerError(done.error_code, done.error_msg)
        except (GraspServerError, ExternalShutdownException) as error:
            why = str(error) or "the command was ended"
            raise MegraspError(f"the grasp was not executed: {why}") from error
        self._not_before = self._node.get_clock().now().to_msg()
        took = ", ".join(done.removed) or "nothing"
        told = f"it holds: took {took}" if done.success else f"it fails: {done.error_msg}"
        return Outcome(f"{told}; {done.objects_left} objects left")

    def _sensed(self) -> Sensed:
        settings, self._count = self.settings, self._source.count
        if self._source.silence > settings.cloud_timeout:
            # The camera has stopped: what is kept is not what it sees.
            self._sensing.rest()
        try:
            sensed = self._sensing.sense(
                self._job,
                settings,
                given=None,
                not_before=self._not_before,
                region=settings.region,
            )
        except NoCloudError as error:
            others = others_with(self._node, type_name(PointCloud2), self._topic, self._server)
            there = ", ".join(others[:5]) or "none"
            raise NoCloudError(
                f"{error} Other topics of that type: {there}; --topic names one, --timeout waits "
                "longer."
            ) from error
        except TransformError as error:
            raise TransformError(
                f"{error} Here --frame names the frame; without it, and without a server's "
                "planning_frame, the cloud stays in its own."
            ) from error
        except GravityError as error:
            raise GravityError(f"{error} Here: --gravity X Y Z, or --frame.") from error
        if self._following:
            self.follow()
        return sensed

    def _offered(self, name: str) -> bool:
        full = self._node.resolve_service_name(name)
        return any(full == each for each, _ in self._node.get_service_names_and_types())


def as_the_server(client: GraspClient, server: str, frame: str) -> tuple[Settings, str]:
    """The settings of the server, or those by default where none runs, in `frame` ("": their own),
    and the gripper that is on.
    """
    node = client.node
    whole = f"{node.get_namespace().rstrip('/')}/{server}"
    place = (server, node.get_namespace())
    if _until(lambda: place in node.get_node_names_and_namespaces(), DISCOVERY):
        settings = server_settings(client)
        say(f"as {whole} is set")
        _until(lambda: client.active_gripper is not None, DISCOVERY)
    else:
        settings = settings_of({name: spec.default for name, spec in TABLE.items()})
        say(f"there is no {whole}: as it is by default")
    active = client.active_gripper
    if frame and frame != settings.planning_frame:
        # These are said in the server's frame.
        settings = replace(
            settings,
            planning_frame=frame,
            extrinsics=None,
            gravity=None,
            region=None,
            floor=None,
        )
    return settings, settings.gripper if active is None else active.name


def live_viewer(
    server: ViserServer,
    live: LiveCloud,
    gripper: str,
    load: Callable[[Gripper], GraspSynthesizer],
    **options: Any,
) -> SceneViewer:
    """The viewer of a live cloud, with a button to execute grasps where a cell does that.

    Args:
        server: see `open_server`.
        live: where its clouds come from.
        gripper: to begin with: registered name or folder of a gripper.yaml.
        load: makes a synthesizer for it.
        options: attributes of SynthesisRequest that are not as the settings have them.

    Raises:
        MegraspError: there is no usable cloud, no such gripper, or options are out of range.
    """
    from megrasp_core.grippers import list_grippers, load_gripper
    from megrasp_core.synthesizer import SynthesisRequest
    from megrasp_core.viewer import SceneViewer

    # What is wrong is told before the model is loaded.
    loaded = load_gripper(gripper, live.settings.gripper_paths)
    live.read()
    asked = options_of(automatic_request(live.settings), live.settings, live.gravity)
    request = SynthesisRequest.of(**{**asked, **options})
    synthesizer = load(loaded)

    def execute(grasp: RankedGrasp, _: str) -> Outcome:
        assert viewer.lists is not None
        return live.execute(grasp, synthesizer, viewer.lists.answer.seed)

    viewer = SceneViewer(
        server,
        synthesizer,
        live.read,
        request,
        grippers=list_grippers(),
        frame=live.header.frame_id,
        execute=execute if live.executes else None,
    )
    return viewer


def _until(look: Callable[[], bool], seconds: float) -> bool:
    end = time.monotonic() + seconds
    while not (found := look()) and time.monotonic() < end:
        time.sleep(0.05)
    return found
