"""The pictures and the page of the gripper frames, and what the page says."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from megrasp_core.cli import main
from megrasp_core.drawing.closing_motion import closing_motion, pad_paths
from megrasp_core.drawing.frame_page import frames_block, own_descriptions
from megrasp_core.drawing.frame_picture import SIZE
from megrasp_core.drawing.frame_raster import raster
from megrasp_core.drawing.splat import Projection, look_along
from megrasp_core.grippers import Pose, gripper_folders, load_gripper, save_description
from megrasp_core.lie import pose7_from_matrix

DOCS = Path(__file__).parents[3] / "docs"
PAGE = DOCS / "frames.md"
COMMAND = "megrasp gripper frames --out docs/images/frames --page docs/frames.md"


@pytest.fixture(autouse=True)
def only_the_checkout(monkeypatch: pytest.MonkeyPatch) -> None:
    """The page holds the grippers of the checkout, not those of the developer."""
    monkeypatch.delenv("MEGRASP_GRIPPER_PATH", raising=False)


def test_the_page_is_what_the_descriptions_say() -> None:
    block = PAGE.read_text().partition("<!-- frames -->\n")[2].partition("<!-- /frames -->")[0]
    assert block == frames_block(own_descriptions(), "images/frames"), f"run {COMMAND}"


def test_every_own_gripper_has_a_picture_of_its_present_state() -> None:
    files = {path.stem: path for path in (DOCS / "images" / "frames").iterdir()}
    assert set(files) == {d.name for d in own_descriptions()}, f"run {COMMAND}"
    for name, file in files.items():
        with Image.open(file) as image:
            assert image.size == SIZE
            assert image.info["gripper"] == load_gripper(name).hash, f"{name}: run {COMMAND}"
        assert file.stat().st_size < 100_000


def test_the_table_holds_what_a_description_holds() -> None:
    d = load_gripper("vx300s_gripper").description
    moved = replace(d, tcp=(0.0015, -0.02, 0.1034), symmetry=3, max_width=None)
    row = frames_block([moved], "pictures").splitlines()[2]
    assert row == (
        "| [vx300s_gripper](pictures/vx300s_gripper.png) | parallel | 1.5, -20, 103.4 | - | 3 | "
        "right_finger_link | left_finger_link |"
    )


@pytest.mark.slow
def test_the_command_draws_and_writes_the_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page, out = tmp_path / "page.md", tmp_path / "pictures"
    arguments = ["gripper", "frames", "schunk_wsg32", "shadow_hand_2f"]
    arguments += ["--out", str(out), "--page", str(page)]
    page.write_text("no marks\n")
    assert main(arguments) == 2 and "<!-- frames -->" in capsys.readouterr().err
    assert not out.exists()
    page.write_text("before\n<!-- frames -->\nold\n<!-- /frames -->\nafter\n")
    assert main(arguments) == 0
    block = frames_block(own_descriptions(), "pictures")
    assert page.read_text() == f"before\n<!-- frames -->\n{block}<!-- /frames -->\nafter\n"
    assert {file.name for file in out.iterdir()} == {"schunk_wsg32.png", "shadow_hand_2f.png"}
    for file in out.iterdir():
        with Image.open(file) as image:
            assert image.size == SIZE
            pixels = np.asarray(image.convert("RGB")).astype(int)
        assert 0.2 < (pixels.min(axis=2) > 250).mean() < 0.9
        for axis in range(3):  # the arrow of each axis has its colour
            others = np.delete(pixels, axis, axis=2).max(axis=2)
            assert (pixels[..., axis] - others > 55).sum() > 100
    again = tmp_path / "again"
    assert main(["gripper", "frames", "schunk_wsg32", "--out", str(again)]) == 0
    first = (out / "schunk_wsg32.png").read_bytes()
    assert (again / "schunk_wsg32.png").read_bytes() == first


def test_the_raster_shows_open_closed_and_swept() -> None:
    """Seen from +Y, Z down: the open finger, the way between, the closed finger, nothing."""
    gripper = load_gripper("franka_hand")
    view = Projection(
        look_along(np.array([0.0, -1, 0]), np.array([0.0, 0, -1])), gripper.tcp, 2000, (240, 160)
    )
    pixels = raster(closing_motion(gripper), gripper.clouds(16), view)

    def colour(x: float, z: float) -> np.ndarray:
        column, row, _ = view.project(np.array([[x, 0.0, gripper.tcp[2] + z]]))[0]
        return pixels[int(row), int(column)]

    for side in (-1, 1):
        red, green, blue = colour(side * 0.045, 0.0)
        assert red < green < blue < 0.95  # open: grey blue
        red, green, blue = colour(side * 0.025, 0.0)
        assert red < blue < green and min(red, blue) > 0.7  # swept: pale green
        red, green, blue = colour(side * 0.005, 0.0)
        assert red > green > blue + 0.2  # closed: orange
    np.testing.assert_array_equal(colour(0.025, 0.03), 1.0)


@pytest.mark.parametrize(
    ("name", "starts"),
    [
        ("robotiq_2f85", [-0.0425, 0.0425]),
        ("robotiq_3f", [-0.085, 0.085, 0.085]),
        ("franka_hand", [-0.04, 0.04]),
    ],
)
def test_paths_lead_from_the_open_to_the_closed_fingertips(name: str, starts: list[float]) -> None:
    gripper = load_gripper(name)
    paths = pad_paths(gripper, closing_motion(gripper))
    np.testing.assert_allclose([path[0, 0] for path in paths], starts, atol=0.002)
    for path in paths:
        assert abs(path[0, 2] - gripper.tcp[2]) < 1e-3
        assert abs(path[-1, 0]) < 0.006
        assert (np.sign(path[0, 0]) * np.diff(path[:, 0]) < 0).all()


def test_the_pages_way_to_the_flange(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The page's code, run on a gripper that is mounted with an offset and a turn."""
    mounting = Pose((0.01, -0.02, 0.03), (0.0, 0.6, 0.0, 0.8))
    source = gripper_folders()["allegro_hand"]
    shutil.copytree(source, tmp_path / "allegro_hand")
    hand = load_gripper("allegro_hand")
    save_description(
        replace(hand.description, flange_from_gripper=mounting), tmp_path / "allegro_hand"
    )
    monkeypatch.setenv("MEGRASP_GRIPPER_PATH", str(tmp_path))
    world_from_flange = Pose((0.4, 0.1, 0.7), (0.5, -0.5, 0.5, 0.5)).matrix()
    grasp = {"world_from_gripper": list(pose7_from_matrix(world_from_flange @ mounting.matrix()))}
    answer = {"gripper": "allegro_hand", "grasps": [grasp]}
    (tmp_path / "grasps.json").write_text(json.dumps(answer))
    monkeypatch.chdir(tmp_path)
    code = next(block for block in python_blocks() if "grasps.json" in block)
    names: dict = {}
    exec(code, names)
    np.testing.assert_allclose(names["world_from_flange"], world_from_flange, atol=1e-9)
    np.testing.assert_allclose(
        names["world_from_flange"] @ names["flange_from_tcp"],
        names["world_from_gripper"] @ hand.gripper_from_tcp,
        atol=1e-9,
    )
    assert "0.4 " in capsys.readouterr().out


def test_no_shipped_description_has_a_flange() -> None:
    """As the page says."""
    assert {d.flange_from_gripper for d in own_descriptions()} == {Pose()}


def python_blocks() -> list[str]:
    """Return the Python code of the page."""
    return [part.partition("```")[0] for part in PAGE.read_text().split("```python\n")[1:]]
