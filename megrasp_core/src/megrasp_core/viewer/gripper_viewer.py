"""A gripper in the browser: frame, TCP, postures and pads, and what the description says of it."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from megrasp_core.errors import MegraspError
from megrasp_core.grippers import (
    FILE_NAME,
    POSTURES,
    Gripper,
    GripperDescription,
    PostureDescription,
    save_description,
)

from .figure import GripperFigure
from .poses import matrix_of, move

if TYPE_CHECKING:
    from viser import GuiEvent, ViserServer

__all__ = ["GripperViewer"]

PADS = ((200, 60, 60), (60, 110, 200), (60, 160, 90), (170, 120, 40), (130, 80, 170))


class GripperViewer:
    """Draws a gripper; takes corrections of its description and writes them.

    Everything in the panel is an attribute, so that a program can do what a user does.
    """

    def __init__(
        self,
        server: ViserServer,
        gripper: Gripper,
        *,
        findings: Sequence[str] = (),
        folder: Path | None = None,
    ) -> None:
        """Draw it at the origin, +Z (approach) up.

        Args:
            server: see `open_server`.
            gripper: to look at.
            findings: lines to show, such as what the wizard found and how sure it is.
            folder: where the corrected gripper.yaml is written; None: the page only hands it out
                for saving.
        """
        self.server, self.gripper, self.folder = server, gripper, folder
        gui, description = server.gui, gripper.description
        self.text = gui.add_markdown("")
        with gui.add_folder("Postures"):
            self.fingers = gui.add_slider("Close the fingers", 0.0, 1.0, 0.02, 0.0)
            self.visual = gui.add_checkbox("What is seen of it", True)
            self.collision = gui.add_checkbox("What collides", False)
            self.pads = gui.add_checkbox("Pads of the finger groups", True)
        with gui.add_folder("Corrections"):
            self.tcp = gui.add_vector3("TCP (m)", description.tcp, step=0.001)
            self.max_width = gui.add_number(
                "Widest (m), 0: none", description.max_width or 0.0, min=0.0, step=0.001
            )
            self.min_width = gui.add_number(
                "Narrowest (m)", description.min_width, min=0.0, step=0.001
            )
            self.symmetry = gui.add_number("Symmetry", description.symmetry, min=1, step=1)
            self.joints = {}
            for name in POSTURES:
                values = self._values(description, name)
                with gui.add_folder(f"The {name} posture", expand_by_default=False):
                    self.joints[name] = {
                        joint: gui.add_number(joint, float(value), step=0.001)
                        for joint, value in values.items()
                    }
            self.apply = gui.add_button("Apply")
            self.save = gui.add_button(f"Save as {FILE_NAME}")
            self.write = gui.add_button(
                f"Write {FILE_NAME}", color="blue", visible=folder is not None
            )
            self.status = gui.add_markdown("")
        if findings:
            with gui.add_folder("What was found"):
                gui.add_markdown("\n".join(f"- {line}" for line in findings))
        self._handle = server.scene.add_transform_controls(
            "/tcp_handle", scale=0.05, disable_rotations=True, depth_test=False
        )
        self._draw()
        self._first_look()
        self.fingers.on_update(lambda _: self._close())
        for switch in (self.visual, self.collision, self.pads):
            switch.on_update(lambda _: self._show())
        self._handle.on_update(lambda _: self._dragged())
        self.tcp.on_update(lambda _: self._typed())
        self.apply.on_click(self._apply_clicked)
        self.save.on_click(self._send)
        self.write.on_click(lambda _: self._write())

    @property
    def description(self) -> GripperDescription:
        """The description with the corrections of the panel, unchecked."""
        before = self.gripper.description
        x, y, z = (round(float(v), 6) for v in self.tcp.value)
        postures = {
            name: self._posture(getattr(before, name), fields)
            for name, fields in self.joints.items()
        }
        return dataclasses.replace(
            before,
            tcp=(x, y, z),
            max_width=float(self.max_width.value) or None,
            min_width=float(self.min_width.value),
            symmetry=int(self.symmetry.value),
            **postures,
        )

    def _apply_clicked(self, _: object) -> None:
        self.correct()

    def correct(self) -> bool:
        """Load the gripper anew with the corrections and draw it; where they are wrong the page
        says why and all stays. Returns whether it worked.
        """
        try:
            gripper = Gripper(self.description)
        except MegraspError as error:
            self.status.content = f"**{error}**"
            return False
        self.gripper = gripper
        self._draw()
        self.status.content = "applied"
        return True

    def file(self) -> bytes:
        """gripper.yaml with the corrections."""
        with tempfile.TemporaryDirectory() as folder:
            return save_description(self.description, Path(folder)).read_bytes()

    # --- the scene ---------------------------------------------------------------------------

    def _draw(self) -> None:
        scene, gripper = self.server.scene, self.gripper
        self._figures = {
            "visual": GripperFigure(scene, "/gripper/visual", gripper),
            "collision": GripperFigure(
                scene, "/gripper/collision", gripper, (230, 150, 60), which="collision",
                opacity=0.5,
            ),
        }  # fmt: skip
        scene.add_frame("/gripper/frame", axes_length=0.05, axes_radius=0.0012)
        self._tcp_frame = scene.add_frame("/gripper/tcp", axes_length=0.03, axes_radius=0.0012)
        move(self._tcp_frame, gripper.gripper_from_tcp)
        move(self._handle, gripper.gripper_from_tcp)
        self.text.content = _facts(gripper)
        self._close()
        self._show()

    def _close(self) -> None:
        for figure in self._figures.values():
            figure.close(float(self.fingers.value))
        self._draw_pads()

    def _show(self) -> None:
        self._figures["visual"].visible = bool(self.visual.value)
        self._figures["collision"].visible = bool(self.collision.value)
        self._draw_pads()

    def _draw_pads(self) -> None:
        """Of the nearer posture: points are known of the open and of the closed one."""
        posture = POSTURES[int(float(self.fingers.value) > 0.5)]
        for group in range(len(self.gripper.description.fingers)):
            name = f"/gripper/pad_{group}"
            node = self.server.scene.get_handle_by_name(name)
            if node is not None:
                node.remove()
            if not self.pads.value or 0.0 < float(self.fingers.value) < 1.0:
                continue
            try:
                points = self.gripper.pad_points(posture, group)
            except MegraspError:
                continue
            self.server.scene.add_point_cloud(
                name,
                points.astype(np.float32),
                PADS[group % len(PADS)],
                point_size=0.0015,
                precision="float32",
            )

    def _first_look(self) -> None:
        vertices = np.concatenate([mesh.vertices for mesh in self.gripper.meshes("open")])
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        size = float(np.linalg.norm(high - low))
        camera = self.server.initial_camera
        self.server.scene.set_up_direction("+z")
        camera.look_at = (low + high) / 2
        camera.position = (low + high) / 2 + size * np.array([0.5, -1.3, 0.5])

    # --- what is pressed ---------------------------------------------------------------------

    def _dragged(self) -> None:
        x, y, z = (round(float(v), 4) for v in matrix_of(self._handle)[:3, 3])
        if not np.allclose(self.tcp.value, (x, y, z), atol=1e-4):
            self.tcp.value = (x, y, z)

    def _typed(self) -> None:
        pose = np.eye(4)
        pose[:3, 3] = self.tcp.value
        move(self._tcp_frame, pose)
        if not np.allclose(matrix_of(self._handle)[:3, 3], pose[:3, 3], atol=1e-4):
            move(self._handle, pose)

    def _send(self, event: GuiEvent) -> None:
        (event.client or self.server).send_file_download(FILE_NAME, self.file())

    def _write(self) -> None:
        if self.folder is not None and self.correct():
            path = save_description(self.description, self.folder)
            self.status.content = f"wrote {path}"

    @staticmethod
    def _values(description: GripperDescription, posture: str) -> dict[str, float]:
        given: PostureDescription = getattr(description, posture)
        return dict(given.actuators or {} if given.joints is None else given.joints)

    @staticmethod
    def _posture(before: PostureDescription, fields: dict) -> PostureDescription:
        values = {name: float(field.value) for name, field in fields.items()}
        if before.joints is None:
            return PostureDescription(actuators=values)
        return PostureDescription(joints=values)


def _facts(gripper: Gripper) -> str:
    d = gripper.description
    width = "none" if d.max_width is None else f"{1000 * d.max_width:.1f} mm"
    rows = [
        ("name", d.name), ("kind", d.kind), ("widest", width), ("symmetry", str(d.symmetry)),
        ("TCP", " ".join(f"{v:.4f}" for v in d.tcp) + " m"),
        ("fingers", " against ".join(", ".join(group) for group in d.fingers)),
        ("model", d.model), ("licence", d.licence),
    ]  # fmt: skip
    table = "\n".join(f"| {name} | {value} |" for name, value in rows)
    axes = "Red: +X, closing. Blue: +Z, approach."
    return f"### {d.display_name}\n\n{axes}\n\n| | |\n|---|---|\n{table}"
