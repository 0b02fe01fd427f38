"""A cloud in the browser, and what a synthesis makes of it."""

from __future__ import annotations

import dataclasses
import io
import json
import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from megrasp_core.drawing.grasp_picture import draw_grasps, rank_colour
from megrasp_core.drawing.splat import height_colours
from megrasp_core.errors import InvalidRequestError, MegraspError
from megrasp_core.explanation import setup_findings
from megrasp_core.meshes import joined
from megrasp_core.pointcloud import Cloud, OrientedBox
from megrasp_core.synthesizer import (
    MAX_DRAWN,
    MAX_GRASPS,
    GraspSynthesizer,
    RankedGrasp,
    Synthesis,
    SynthesisRequest,
)

from .figure import GripperFigure, fork
from .grasp_lists import RANKED, GraspLists, everything, report
from .known_space import KnownSpace, known_space
from .poses import move, position_and_wxyz
from .region_box import RegionBox

if TYPE_CHECKING:
    from viser import GuiEvent, ViserServer

__all__ = ["Outcome", "SceneViewer"]

MOST_POINTS = 300_000
"""Of a cloud, that are sent to the browser."""
NEARNESS = 1.0
"""Distance of the first look in extents of the cloud."""
REJECTED = (190, 60, 60)
PATHS = {"approach": (70, 110, 200), "retreat": (150, 90, 190)}
SPACES = {
    "seen": ("Seen surface", (60, 60, 60)),
    "unknown": ("Unknown space", (150, 90, 190)),
    "inside": ("Taken for the inside of objects", (220, 140, 40)),
    "solid": ("Walls and below the floor", (90, 130, 90)),
}


class Outcome(NamedTuple):
    """What became of an executed grasp: a sentence for the user."""

    text: str


class SceneViewer:
    """Draws a cloud; synthesizes when asked; shows what was ranked, what was rejected and why.

    Everything in the panel is an attribute, so that a program can do what a user does. What is
    pressed is answered in viser's threads, one at a time.
    """

    def __init__(
        self,
        server: ViserServer,
        synthesizer: GraspSynthesizer,
        source: Callable[[], Cloud],
        request: SynthesisRequest,
        *,
        grippers: Sequence[str],
        frame: str = "world",
        execute: Callable[[RankedGrasp, str], Outcome] | None = None,
    ) -> None:
        """Read the cloud and draw it.

        Args:
            server: see `open_server`.
            synthesizer: with its gripper set; the viewer uses it alone.
            source: where clouds come from, asked again on request.
            request: what the panel begins with; what it does not show stays as it is here.
            grippers: names to choose from.
            frame: name of the cloud's frame, for grasps.json.
            execute: carries out a grasp with the gripper of this name, after which the source has
                another cloud; None: no button for it.

        Raises:
            CloudError: the source has no usable cloud.
            InvalidRequestError: the synthesizer has no gripper.
        """
        if synthesizer.gripper is None:
            raise InvalidRequestError("no gripper is set; expected one. Call set_gripper first.")
        self.server, self.synthesizer = server, synthesizer
        self.request, self.frame = request, frame
        self.lists: GraspLists | None = None
        """Of the last synthesis of this cloud."""
        self.space: KnownSpace | None = None
        """Of this cloud and region, once it was asked for."""
        self._source, self._execute = source, execute
        # What an answer changes in the panel calls back in the same thread.
        self._lock = threading.RLock()
        self._filling = False
        self._figure: GripperFigure | None = None
        self.cloud = source()
        self._draw_cloud()
        self._first_look()
        self._build_panel(list(grippers))
        self._mount()
        self._show_list()

    @property
    def grasp(self) -> RankedGrasp | None:
        """The one that is looked at."""
        chosen = self._chosen()
        return chosen[int(self.number.value) - 1] if chosen else None

    @property
    def asked(self) -> SynthesisRequest:
        """The request that the panel stands for.

        Raises:
            InvalidRequestError: numbers out of range.
        """
        return dataclasses.replace(
            self.request,
            num_grasps=int(self.num_grasps.value),
            drawn=int(self.drawn.value),
            mode="fast" if self.fast.value else "default",
            seed=int(self.seed.value),
            region=self.region.box,
            walls=bool(self.region.walls.value),
        )

    def _start_clicked(self, _: object) -> None:
        self.synthesize()

    def _space_switched(self, _: object) -> None:
        if not self._filling:
            self._guarded(self._show_space)

    def synthesize(self) -> Synthesis | None:
        """Do what the button does; returns the answer, None where it failed, which the page
        tells.
        """
        return self._guarded(self._synthesize)

    def refresh(self) -> None:
        """Ask the source for another cloud and draw it; grasps of the old one go."""
        self._guarded(self._refresh)

    def follow(self) -> None:
        """Draw another cloud, unless there is more to look at than the cloud: grasps, known space
        or a message stay until `refresh`.
        """
        with self._lock:
            shown = any(switch.value for switch in self.spaces.values())
            if self.lists is not None or shown or self.status.content != self._size():
                return
            try:
                self.cloud, self.space = self._source(), None
                self._draw_cloud()
                self.status.content = self._size()
            except MegraspError as error:
                self.status.content = f"**{error}**"

    # --- panel -------------------------------------------------------------------------------

    def _build_panel(self, grippers: list[str]) -> None:
        gui, request = self.server.gui, self.request
        assert self.synthesizer.gripper is not None
        name = self.synthesizer.gripper.name
        names = [*grippers, *([] if name in grippers else [name])]
        with gui.add_folder("Synthesis"):
            self.gripper = gui.add_dropdown("Gripper", names, initial_value=name)
            self.seed = gui.add_number("Seed", int(request.seed or 0), min=0, max=2**32 - 1, step=1)
            self.num_grasps = gui.add_number(
                "Grasps", request.num_grasps, min=1, max=MAX_GRASPS, step=1
            )
            self.drawn = gui.add_number("Drawn", request.drawn, min=1, max=MAX_DRAWN, step=1)
            self.fast = gui.add_checkbox("Fast", request.mode == "fast")
            self.start = gui.add_button("Synthesize", color="blue")
            self.again = gui.add_button("Read the cloud again")
            self.progress = gui.add_progress_bar(0.0, visible=False)
            self.status = gui.add_markdown(self._size())
        with gui.add_folder("Grasps"):
            self.list = gui.add_dropdown("List", [f"{RANKED} (0)"])
            self.number = gui.add_slider("Number", 1, 2, 1, 1, disabled=True)
            self.fingers = gui.add_slider("Close the fingers", 0.0, 1.0, 0.02, 0.0)
            self.details = gui.add_markdown("")
            self.do = gui.add_button("Execute it", visible=self._execute is not None)
            self.paths = gui.add_checkbox("Approach, retreat", True)
            self.forks = gui.add_checkbox("Others as forks", True)
            self.meshes = gui.add_checkbox("Others as grippers", False)
            self.frames = gui.add_checkbox("Frames, TCP", True)
        with gui.add_folder("Space", expand_by_default=False):
            self.spaces = {
                key: gui.add_checkbox(label, False) for key, (label, _) in SPACES.items()
            }
        with gui.add_folder("Region", expand_by_default=False):
            self.region = RegionBox(
                self.server,
                request.region or self._extent(),
                used=request.region is not None,
                walls=request.walls,
                changed=self._forget_space,
            )
            self.save_region = gui.add_button("Save as region.json")
        with gui.add_folder("Files", expand_by_default=False):
            self.save_grasps = gui.add_button("grasps.json")
            self.save_view = gui.add_button("Picture of this view")
            self.save_picture = gui.add_button("Picture from above and the side")
        self.start.on_click(self._start_clicked)
        self.again.on_click(lambda _: self.refresh())
        self.gripper.on_update(lambda _: self._guarded(self._change_gripper))
        self.list.on_update(lambda _: self._show_list())
        self.number.on_update(lambda _: self._show_grasp())
        self.fingers.on_update(lambda _: self._close())
        self.do.on_click(lambda _: self._guarded(self._carry_out))
        for switch in (self.paths, self.frames):
            switch.on_update(lambda _: self._show_grasp())
        for switch in (self.forks, self.meshes):
            switch.on_update(lambda _: self._show_others())
        for switch in self.spaces.values():
            switch.on_update(self._space_switched)
        self.save_region.on_click(lambda event: self._send(event, "region.json", self.region_file))
        self.save_grasps.on_click(lambda event: self._send(event, "grasps.json", self.grasps_file))
        self.save_picture.on_click(lambda event: self._send(event, "grasps.png", self.picture))
        self.save_view.on_click(lambda event: self._send(event, "view.png", self._view_of(event)))

    def _guarded(self, work: Callable[[], Any]) -> Any:
        """Do one thing at a time, and tell the page what is wrong instead of dying of it."""
        with self._lock:
            self.start.disabled = self.do.disabled = True
            try:
                return work()
            except MegraspError as error:
                self.status.content = f"**{error}**"
                return None
            finally:
                self.progress.visible = False
                self.start.disabled = self.do.disabled = False

    # --- what buttons do ---------------------------------------------------------------------

    def _synthesize(self) -> Synthesis:
        asked = self.asked
        self.status.content = "working"
        self.progress.visible = True

        def tell(phase: str, step: int, steps: int) -> None:
            self.progress.value = 100.0 * step / max(steps, 1)
            self.status.content = phase

        answer = self.synthesizer.synthesize(self.cloud, everything(asked), on_step=tell)
        self.lists = GraspLists(answer, asked.num_grasps)
        self._fill_lists()
        answer = self.lists.answer
        counts = ", ".join(f"{name} {n}" for name, n in answer.rejected.items() if n)
        lines = [
            f"{len(answer.grasps)} grasps for {answer.gripper} with {answer.model}: "
            f"{answer.drawn} drawn, {answer.timing['total']:.2f} s, seed {answer.seed}",
            f"not returned: {counts or 'none'}",
            *answer.notes,
        ]
        if answer.bin_empty:
            lines = ["nothing to grasp: only the support surface is left", *answer.notes]
        if not answer.grasps:
            lines += [*setup_findings(self.cloud, asked).told, *answer.hints]
        self.status.content = "\n\n".join(lines)
        return answer

    def _refresh(self) -> None:
        self.cloud = self._source()
        self._draw_cloud()
        self._forget()
        self.status.content = self._size()

    def _change_gripper(self) -> None:
        self.synthesizer.set_gripper(self.gripper.value)
        self._mount()
        self._forget()
        self.status.content = self._size()

    def _carry_out(self) -> None:
        grasp = self.grasp
        if grasp is None or self._execute is None:
            raise InvalidRequestError("no grasp is chosen; expected one. Synthesize first.")
        self.status.content = "executing"
        outcome = self._execute(grasp, self.gripper.value)
        self._refresh()
        self.status.content = f"**{outcome.text}**"

    def _forget(self) -> None:
        self.lists = None
        self._fill_lists()
        self._forget_space()

    def _forget_space(self) -> None:
        self.space = None
        filling, self._filling = self._filling, True
        for key, switch in self.spaces.items():
            switch.value = False
            self._remove(f"/space/{key}")
        self._filling = filling

    # --- files -------------------------------------------------------------------------------

    def grasps_file(self) -> bytes:
        """grasps.json of the last synthesis.

        Raises:
            InvalidRequestError: there was none of this cloud.
        """
        if self.lists is None:
            raise InvalidRequestError("there are no grasps yet; expected some. Synthesize first.")
        content = self.lists.answer.to_json(self.frame)
        return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()

    def region_file(self) -> bytes:
        """A region file of the box as it is now."""
        return self.region.to_json().encode()

    def picture(self) -> bytes:
        """PNG of the cloud and the ranked grasps, from above and from the side."""
        assert self.synthesizer.gripper is not None
        grasps = [] if self.lists is None else self.lists[RANKED]
        image = draw_grasps(
            self.cloud,
            grasps,
            self.synthesizer.gripper,
            region=self.region.box,
            gravity=self.request.gravity,
        )
        return _png(image)

    def _view_of(self, event: GuiEvent) -> Callable[[], bytes]:
        def render() -> bytes:
            from PIL import Image

            if event.client is None:
                raise InvalidRequestError("no page is open; expected one to take a picture of.")
            pixels = event.client.get_render(height=900, width=1400, transport_format="png")
            return _png(Image.fromarray(pixels))

        return render

    def _send(self, event: GuiEvent, name: str, make: Callable[[], bytes]) -> None:
        try:
            content = make()
        except (MegraspError, RuntimeError, TimeoutError) as error:
            self.status.content = f"**{error}**"
            return
        # To the browser and not to a path: whoever sees the page must not write files here.
        (event.client or self.server).send_file_download(name, content)

    # --- scene -------------------------------------------------------------------------------

    def _size(self) -> str:
        return f"{len(self.cloud.finite()):,} points"

    def _down(self) -> np.ndarray:
        if self.request.gravity is not None:
            return np.asarray(self.request.gravity, dtype=np.float64)
        return np.array([0.0, 0.0, 1.0])

    def _extent(self) -> OrientedBox:
        points = self.cloud.finite().points
        low, high = np.percentile(points, [2, 98], axis=0)
        return OrientedBox.around((low + high) / 2, np.maximum(high - low, 0.05) + 0.02)

    def _first_look(self) -> None:
        box, down = self._extent(), self._down()
        if self.request.region is not None:
            box = self.request.region
        self.server.scene.set_up_direction((-down[0], -down[1], -down[2]))
        # Obliquely from above, from a side that does not depend on the frame's axes.
        aside = np.eye(3)[np.argmin(np.abs(down))]
        aside = np.cross(down, np.cross(aside, down))
        direction = -down + 0.9 * aside / np.linalg.norm(aside)
        direction /= np.linalg.norm(direction)
        place = box.centre + NEARNESS * np.linalg.norm(box.size) * direction
        camera = self.server.initial_camera
        camera.up = -down
        camera.position, camera.look_at = place, box.centre

    def _draw_cloud(self) -> None:
        cloud = self.cloud.finite()
        if len(cloud) > MOST_POINTS:
            chosen = np.random.default_rng(0).choice(len(cloud), MOST_POINTS, replace=False)
            cloud = cloud.select(np.sort(chosen))
        height = -cloud.points @ self._down()
        low, high = np.percentile(height, [1, 99]) if len(cloud) else (0.0, 1.0)
        colours = cloud.colors
        if colours is None:
            colours = height_colours((height - low) / max(high - low, 1e-6))
        self.server.scene.add_point_cloud(
            "/cloud",
            cloud.points.astype(np.float32),
            (255 * np.clip(colours, 0, 1)).astype(np.uint8),
            point_size=_spacing(cloud.points),
            point_shape="rounded",
            point_shading="flat",
            precision="float32",
        )

    def _mount(self) -> None:
        """Draw the gripper in use, out of sight until there is a grasp."""
        gripper = self.synthesizer.gripper
        assert gripper is not None
        if self._figure is not None:
            self._figure.remove()
        self._figure = GripperFigure(self.server.scene, "/gripper", gripper, visible=False)
        self._axes = [
            self.server.scene.add_frame(f"/gripper/{name}", axes_length=size, axes_radius=0.0012)
            for name, size in (("frame", 0.05), ("tcp", 0.03))
        ]
        move(self._axes[1], gripper.gripper_from_tcp)

    def _fill_lists(self) -> None:
        self._filling = True
        lists = self.lists
        names = [RANKED] if lists is None else lists.names
        options = [f"{name} ({len(lists[name]) if lists else 0})" for name in names]
        self.list.options = options
        self.list.value = options[0]
        self._filling = False
        self._show_list()

    def _chosen(self) -> list[RankedGrasp]:
        return self.lists[str(self.list.value).rsplit(" ", 1)[0]] if self.lists else []

    def _show_list(self) -> None:
        if self._filling:
            return
        count = len(self._chosen())
        self._filling = True
        self.number.value = 1
        self.number.max = max(count, 2)
        self.number.disabled = count < 2
        self._filling = False
        self._show_grasp()

    def _show_grasp(self) -> None:
        if self._filling or self._figure is None:
            return
        chosen = self._chosen()
        # The slider has two places even where there is one grasp.
        number = min(int(self.number.value), max(len(chosen), 1))
        self._figure.visible = bool(chosen)
        for name in PATHS:
            self._remove(f"/path/{name}")
        if not chosen:
            self.details.content = "" if self.lists is None else "nothing in this list"
            self._show_others()
            return
        grasp = chosen[number - 1]
        self._figure.place(grasp.world_from_gripper)
        self._close()
        for axes in self._axes:
            axes.visible = bool(self.frames.value)
        if self.paths.value:
            self._draw_paths(grasp)
        self.details.content = report(grasp, number, len(chosen))
        self._show_others()

    def _draw_paths(self, grasp: RankedGrasp) -> None:
        gripper = self.synthesizer.gripper
        assert gripper is not None
        ends = {
            "approach": grasp.world_from_gripper_approach,
            # Where the planner says it; otherwise one leaves as one came.
            "retreat": getattr(grasp, "world_from_gripper_retreat", None),
        }
        here = grasp.world_from_tcp[:3, 3]
        for name, pose in ends.items():
            if pose is None:
                continue
            there = (pose @ gripper.gripper_from_tcp)[:3, 3]
            lines = np.concatenate(
                [np.array([[here, there]], np.float32), fork(gripper, [pose])]
            ).astype(np.float32)
            self.server.scene.add_line_segments(
                f"/path/{name}", lines, PATHS[name], thickness=0.0015
            )

    def _close(self) -> None:
        if self._figure is None:
            return
        start = float(getattr(self.grasp, "share", 0.0))
        self._figure.close(start + (1.0 - start) * float(self.fingers.value))

    def _show_others(self) -> None:
        """Draw all of the list but the one that is looked at, as forks or as grippers."""
        chosen, gripper = self._chosen(), self.synthesizer.gripper
        assert gripper is not None
        ranked = str(self.list.value).startswith(f"{RANKED} ")
        number = int(self.number.value) - 1
        others = [index for index in range(len(chosen)) if index != number]
        poses = [chosen[index].world_from_gripper for index in others]
        colours = np.array(
            [
                255 * np.asarray(rank_colour(index, len(chosen))) if ranked else REJECTED
                for index in others
            ]
        ).reshape(-1, 3)
        self._remove("/others/forks")
        self._remove("/others/grippers")
        if poses and self.forks.value:
            self.server.scene.add_line_segments(
                "/others/forks",
                fork(gripper, poses),
                np.repeat(colours, 8, axis=0).reshape(-1, 2, 3).astype(np.uint8),
                thickness=0.002,
            )
        if poses and self.meshes.value:
            vertices, faces = joined(gripper.meshes("open"))
            nodes = [position_and_wxyz(pose) for pose in poses]
            self.server.scene.add_batched_meshes_simple(
                "/others/grippers",
                np.asarray(vertices, np.float32),
                np.asarray(faces, np.uint32),
                batched_wxyzs=np.array([node[1] for node in nodes], np.float32),
                batched_positions=np.array([node[0] for node in nodes], np.float32),
                batched_colors=colours.astype(np.uint8),
                opacity=0.5,
                flat_shading=True,
                side="double",
            )

    def _show_space(self) -> None:
        wanted = {key for key, switch in self.spaces.items() if switch.value}
        if wanted and self.space is None:
            self.space = known_space(self.cloud, self.asked, self.synthesizer)
        for key, (_, colour) in SPACES.items():
            self._remove(f"/space/{key}")
            if key not in wanted or self.space is None:
                continue
            points = getattr(self.space, key)
            size = 0.002 if key == "seen" else 0.35 * self.space.pitch
            self.server.scene.add_point_cloud(
                f"/space/{key}",
                points.astype(np.float32),
                colour,
                point_size=size,
                point_shape="circle",
                precision="float32",
            )

    def _remove(self, name: str) -> None:
        node = self.server.scene.get_handle_by_name(name)
        if node is not None:
            node.remove()


def _png(image: Any) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, format="PNG")
    return buffer.getvalue()


def _spacing(points: np.ndarray) -> float:
    """About how far neighbours are apart (m), 1 to 6 mm."""
    if len(points) < 100:
        return 0.004
    extent = np.percentile(points, 95, axis=0) - np.percentile(points, 5, axis=0)
    area = float(np.prod(np.sort(extent)[1:]))
    return float(np.clip(1.1 * np.sqrt(area / len(points)), 0.001, 0.006))
