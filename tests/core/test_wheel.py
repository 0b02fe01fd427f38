"""The built wheel: what is in it, and that it works without a checkout."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

import megrasp_core
from megrasp_core.network import default_model

ROOT = Path(__file__).parents[2]
SOURCES = ("megrasp_core", "models", "gripper_descriptions")
SHARE = "megrasp_core/share"

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a wheel is built of, copied: building writes into its folder."""
    folder = tmp_path_factory.mktemp("tree")
    for name in SOURCES:
        skip = shutil.ignore_patterns("build", "*.egg-info", "__pycache__", "scene_recipes")
        shutil.copytree(ROOT / name, folder / name, ignore=skip)
    shutil.copy(ROOT / "LICENSE", folder)
    return folder


@pytest.fixture(scope="module")
def wheel(tree: Path) -> Path:
    return built("build_wheel", tree / "megrasp_core", tree / "wheels")


def built(what: str, folder: Path, out: Path) -> Path:
    """Call setuptools as pip does, without network."""
    out.mkdir()
    code = f"from setuptools import build_meta as b; b.{what}({str(out)!r})"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return next(out.iterdir())


def names(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as file:
        return set(file.namelist())


def test_it_holds_code_models_and_grippers(wheel: Path) -> None:
    held = names(wheel)
    code = {
        f"megrasp_core/{path.relative_to(ROOT / 'megrasp_core/src/megrasp_core')}"
        for path in (ROOT / "megrasp_core/src/megrasp_core").rglob("*.py")
    }
    models = {
        f"{SHARE}/megrasp_models/{default_model(kind)}/{name}"
        for kind in ("parallel", "hand")
        for name in ("config.json", "model.safetensors", "MODEL_CARD.md")
    }
    grippers = {
        f"{SHARE}/gripper_descriptions/{path.relative_to(ROOT / 'gripper_descriptions')}"
        for path in (ROOT / "gripper_descriptions").rglob("*")
        if path.is_file() and path.name not in ("CMakeLists.txt", "package.xml")
    }
    assert len(code) > 200 and len(grippers) > 30
    expected = code | models | grippers | {"megrasp_core/py.typed", f"{SHARE}/LICENSE"}
    assert not expected - held
    rest = {name for name in held - expected if ".dist-info/" not in name}
    assert all(name.startswith(f"{SHARE}/megrasp_models/") for name in rest), rest
    assert wheel.stat().st_size < 20e6


def test_a_source_distribution_alone_makes_the_same_wheel(wheel: Path, tree: Path) -> None:
    archive = built("build_sdist", tree / "megrasp_core", tree / "sdist")
    alone = tree / "elsewhere"
    shutil.unpack_archive(archive, alone)
    again = built("build_wheel", next(alone.iterdir()), tree / "again")
    assert names(again) == names(wheel)


def test_it_finds_grasps_without_a_checkout(wheel: Path, tmp_path: Path) -> None:
    site = tmp_path / "site"
    with zipfile.ZipFile(wheel) as file:
        file.extractall(site)
    x, y = np.meshgrid(np.arange(-0.1, 0.1, 0.003), np.arange(-0.1, 0.1, 0.003))
    z = np.where((abs(x) < 0.02) & (abs(y) < 0.03), 0.05, 0.0)
    points = np.stack([x, y, z], -1).reshape(-1, 3)
    np.savez(tmp_path / "cloud.npz", points=points, viewpoint=[0.0, 0.0, 0.8])
    environment = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith("MEGRASP_") and name not in ("AMENT_PREFIX_PATH", "PYTHONPATH")
    }
    environment |= {"PYTHONPATH": str(site), "MEGRASP_CACHE": "off"}
    code = (
        "import sys, megrasp_core\nprint(megrasp_core.__file__)\n"
        "from megrasp_core.grippers import gripper_folders\n"
        "from megrasp_core.network import find_model\n"
        "print(find_model(None), gripper_folders()['shadow_hand_2f'])\n"
        "from megrasp_core.cli import main\n"
        "sys.exit(main(['synthesize', 'cloud.npz', '--gripper', 'robotiq_2f85', '--drawn', '8',"
        " '--seed', '1', '--all', '--out', 'grasps.json']))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path, env=environment, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode in (0, 1), done.stderr
    assert str(Path(megrasp_core.__file__).parent) not in done.stdout
    assert done.stdout.count(str(site)) == 3
    assert (tmp_path / "grasps.json").is_file(), done.stderr
