"""Builds the package with what it needs at run time and the checkout keeps elsewhere.

A wheel holds the models and the grippers below `megrasp_core/share`, laid out as in a colcon
prefix, so that `megrasp synthesize` works where there is no checkout. Everything else about the
package is in pyproject.toml.
"""

from __future__ import annotations

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

HERE = Path(__file__).resolve().parent
SHARE = Path("megrasp_core") / "share"
MODEL_FILES = ("config.json", "model.safetensors", "MODEL_CARD.md")
"""Of a model; logs, evaluations and checkpoints stay in the repository."""


def copy_share(target: Path) -> None:
    """Fill the folder `target` from the checkout, or from the source distribution built of it."""
    shutil.rmtree(target, ignore_errors=True)
    checkout, packed = HERE.parent, HERE / "src" / SHARE
    if not (checkout / "models").is_dir() or not (checkout / "gripper_descriptions").is_dir():
        if not packed.is_dir():
            raise SystemExit(
                f"neither models and gripper_descriptions beside {HERE} nor {packed} are there; "
                "expected the folder megrasp_core of a whole checkout, or a source distribution."
            )
        shutil.copytree(packed, target)
        return
    for config in sorted(checkout.glob("models/*/config.json")):
        folder = target / "megrasp_models" / config.parent.name
        folder.mkdir(parents=True)
        for name in MODEL_FILES:
            if (config.parent / name).is_file():
                shutil.copy(config.parent / name, folder / name)
    shutil.copytree(
        checkout / "gripper_descriptions",
        target / "gripper_descriptions",
        ignore=shutil.ignore_patterns("CMakeLists.txt", "package.xml"),
    )
    shutil.copy(checkout / "LICENSE", target / "LICENSE")


class BuildWithShare(build_py):
    """Adds the folder `share`; an editable install finds models and grippers in the checkout."""

    def run(self) -> None:
        super().run()
        if not self.editable_mode:
            copy_share(Path(self.build_lib) / SHARE)


class SdistWithShare(sdist):
    """Adds the folder `share`, so that a wheel can be built of the source distribution alone."""

    def make_release_tree(self, base_dir: str, files: list[str]) -> None:
        super().make_release_tree(base_dir, files)
        copy_share(Path(base_dir) / "src" / SHARE)


setup(cmdclass={"build_py": BuildWithShare, "sdist": SdistWithShare})
