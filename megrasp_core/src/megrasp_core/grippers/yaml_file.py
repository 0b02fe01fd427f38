"""YAML files read strictly: what PyYAML accepts, overwrites or answers with any exception is a
DescriptionError.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from megrasp_core.errors import DescriptionError


def read_yaml(file: Path) -> Any:
    """Return the contents of a YAML file. Raises DescriptionError, with the line where known."""
    try:
        text = file.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        line = file.read_bytes()[: error.start].count(b"\n") + 1
        raise DescriptionError(
            f"{file}: line {line} is not UTF-8; expected text saved as UTF-8"
        ) from error
    try:
        return yaml.load(text, _StrictLoader)
    except RecursionError:
        raise DescriptionError(f"{file}: is nested too deeply; expected a gripper.yaml") from None
    except _GivenTwiceError as error:
        raise DescriptionError(f"{file}: {error}") from None
    # Beside YAMLError, whatever the making of dates and numbers meets.
    except Exception as error:
        tab = re.search(r"^ *\t", text, re.MULTILINE)
        if tab:
            line = text.count("\n", 0, tab.start()) + 1
            raise DescriptionError(
                f"{file}: line {line} is indented with a tab; YAML expects spaces"
            ) from error
        reason = " ".join(str(error).split())
        raise DescriptionError(f"{file}: is not valid YAML; the parser says: {reason}") from error


class _GivenTwiceError(Exception):
    pass


class _StrictLoader(yaml.SafeLoader):
    """A loader that refuses a key given twice; PyYAML keeps the last without a word."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        lines: dict[str, int] = {}
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode) or key.tag == "tag:yaml.org,2002:merge":
                continue
            line = key.start_mark.line + 1
            if key.value in lines:
                raise _GivenTwiceError(
                    f"the field '{key.value}' is given twice, in lines {lines[key.value]} and "
                    f"{line}; expected once"
                )
            lines[key.value] = line
        return super().construct_mapping(node, deep)
