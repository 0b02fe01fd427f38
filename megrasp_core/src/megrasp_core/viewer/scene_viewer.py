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
from megrasp_core.errors import InvalidRequestError, MegraspError
from megrasp_core.explanation import setup_findings
from megrasp_core.pointcloud import Cloud
from megrasp_core.synthesizer import (
    MAX_DRAWN,
    MAX_GRASPS,
    GraspSynthesizer,
    RankedGrasp,
    Synthesis,
    SynthesisRequest,
)

from .grasp_lists import RANKED, GraspLists, everything, report
from .known_space import KnownSpace, known_space
from .region_box import RegionBox
from .scene_drawing import SPACES, SceneDrawing, extent

if TYPE_CHECKING:
    from viser import GuiEvent, ViserServer

__all__ = ["Outcome", "SceneViewer"]

REJECTED = (190, 60, 60)
"""Colour of grasps that were not returned."""


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
        self.cloud = source()
        self._drawing = SceneDrawing(server, request.gravity, synthesizer.gripper)
        self._drawing.cloud(self.cloud)
        self._drawing.look_at(request.region or extent(self.cloud))
        self._build_panel(list(grippers))
        self._show_list()

    @property
    def grasp(self) -> RankedGrasp | None:
        """The one that is looked at."""
        chosen = self._chosen()
        # The slider has two places even where there is one grasp.
        return chosen[min(int(self.number.value), len(chosen)) - 1] if chosen else None

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
                self._drawing.cloud(self.cloud)
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
            self.seed = gui.add_number(
                "Seed", int(request.seed or 0), min=0, max=2**32 - 1, step=1
            )
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
                request.region or extent(self.cloud),
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
        self._drawing.cloud(self.cloud)
        self._forget()
        self.status.content = self._size()

    def _change_gripper(self) -> None:
        self._drawing.mount(self.synthesizer.set_gripper(self.gripper.value))
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
        for switch in self.spaces.values():
            switch.value = False
        self._drawing.space(None, set())
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
        if self._filling:
            return
        chosen, grasp = self._chosen(), self.grasp
        self._drawing.grasp(grasp, frames=self.frames.value, paths=self.paths.value)
        if grasp is None:
            self.details.content = "" if self.lists is None else "nothing in this list"
        else:
            self._close()
            self.details.content = report(grasp, int(self.number.value), len(chosen))
        self._show_others()

    def _close(self) -> None:
        grasp = self.grasp
        start = 0.0 if grasp is None else grasp.share
        self._drawing.close(start + (1.0 - start) * float(self.fingers.value))

    def _show_others(self) -> None:
        """Draw all of the list but the one that is looked at."""
        chosen = self._chosen()
        ranked = str(self.list.value).startswith(f"{RANKED} ")
        others = [index for index in range(len(chosen)) if index != int(self.number.value) - 1]
        colours = [
            255 * np.asarray(rank_colour(index, len(chosen))) if ranked else REJECTED
            for index in others
        ]
        self._drawing.others(
            [chosen[index] for index in others],
            np.array(colours).reshape(-1, 3),
            forks=self.forks.value,
            grippers=self.meshes.value,
        )

    def _show_space(self) -> None:
        wanted = {key for key, switch in self.spaces.items() if switch.value}
        if wanted and self.space is None:
            self.space = known_space(self.cloud, self.asked, self.synthesizer)
        self._drawing.space(self.space, wanted)


def _png(image: Any) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, format="PNG")
    return buffer.getvalue()
