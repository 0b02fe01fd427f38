"""The model file of a description: where it lies, and what kind of XML it is."""

from __future__ import annotations

import os
from pathlib import Path
from xml.etree import ElementTree

from megrasp_core.errors import DescriptionError

MODEL_SUFFIXES = (".urdf", ".xml", ".mjcf")
ASSET_PREFIX = "asset:"
ASSET_VARIABLE = "MEGRASP_ASSETS"


def find_model(model: str, file: Path) -> Path:
    """Return the model that the field `model` of a gripper.yaml names.

    Args:
        model: a path from the file's folder, or `asset:` and a path below grippers/ of the assets.
        file: the gripper.yaml.

    Raises:
        DescriptionError: it is not there.
    """
    if model.startswith(ASSET_PREFIX):
        root = os.environ.get(ASSET_VARIABLE)
        if not root:
            raise DescriptionError(
                f"{file}: 'model' is '{model}', but {ASSET_VARIABLE} is not set; set it to the "
                "folder that holds grippers/"
            )
        path = Path(root) / "grippers" / model.removeprefix(ASSET_PREFIX)
    else:
        path = file.parent / model
    if not (os.path.isfile(path) and os.access(path, os.R_OK)):
        raise DescriptionError(
            f"{file}: 'model' is '{model}', but there is no readable file {path}; models in that "
            f"folder: {', '.join(_models_in(path.parent)) or '(none)'}"
        )
    return path


def read_xml(path: Path) -> ElementTree.Element:
    """Return the outermost element of a URDF (<robot>) or MJCF (<mujoco>) file.

    Raises:
        DescriptionError: it is neither.
    """
    try:
        root = ElementTree.fromstring(path.read_bytes())
    # An encoding that Python does not know comes as LookupError or ValueError.
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise DescriptionError(
            f"{path} is no XML ({error}); expected a URDF or MJCF file"
        ) from error
    if path.suffix == ".xacro" or any("xacro" in str(element.tag) for element in root.iter()):
        stem = path.name.partition(".")[0]
        made = f"{stem}.urdf" if path.suffix == ".xacro" else f"{stem}_expanded.urdf"
        raise DescriptionError(
            f"{path} is a xacro file; expected it expanded: xacro {path.name} > {made}"
        )
    if root.tag not in ("robot", "mujoco", "mujocoinclude"):
        raise DescriptionError(
            f"{path} is neither URDF nor MJCF: its outermost element is <{root.tag}>; expected "
            "<robot> or <mujoco>"
        )
    return root


def _models_in(folder: Path) -> list[str]:
    """Return the names of the model files in a folder, none where it cannot be read."""
    try:
        return sorted(f.name for f in folder.iterdir() if f.suffix.lower() in MODEL_SUFFIXES)
    except OSError:
        return []
