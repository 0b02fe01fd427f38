"""Whatever stands in a gripper.yaml, it loads or is refused with a DescriptionError."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from tiny_gripper import GOOD, put, write

from megrasp_core.errors import DescriptionError
from megrasp_core.grippers import Gripper, load_description, save_description

QUICK = settings(max_examples=200, deadline=None)
ACTUATED = {"actuators": {"drive": 0.02, "slide_r": 0.02}}
LEAVES = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=20)
    | st.dates()
    | st.binary(max_size=5)
    | st.sampled_from(["slide_l", "drive", "left", "asset:a.xml", "1e-3", 10**400, 1e300, -0.01])
)
VALUES = st.recursive(
    LEAVES,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(LEAVES, inner, max_size=3),
    max_leaves=6,
)


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the path of every field and item below the top."""
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, inner in items:
        yield (*path, key)
        if isinstance(inner, (dict, list)):
            yield from places(inner, (*path, key))


def source() -> dict[str, Any]:
    """Return the good description, one posture given as controls."""
    data = copy.deepcopy(GOOD)
    put("postures.closed", copy.deepcopy(ACTUATED))(data)
    return data


PLACES = sorted(places(source()), key=str)


def load(folder: Path) -> None:
    """Load the gripper; one that loads also survives being written."""
    try:
        description = load_description(folder)
        Gripper(description)
    except DescriptionError as error:
        assert str(folder) in str(error)
        return
    save_description(description, folder)
    assert load_description(folder) == description


def test_the_unchanged_description_loads(tmp_path: Path) -> None:
    """So that the others begin with something right."""
    write(tmp_path, lambda data: data.update(source()))
    Gripper.from_path(tmp_path)
    load(tmp_path)


@pytest.mark.slow
@QUICK
@given(place=st.sampled_from(PLACES), value=VALUES, drop=st.booleans())
def test_any_value_anywhere(place: tuple[Any, ...], value: Any, drop: bool) -> None:
    """A field is left out, or holds anything that YAML can hold."""
    data = source()
    holder = data
    for key in place[:-1]:
        holder = holder[key]
    if drop:
        del holder[place[-1]]
    else:
        holder[place[-1]] = value
    with TemporaryDirectory() as folder:
        write(Path(folder))
        text = yaml.safe_dump(data, allow_unicode=False)
        (Path(folder) / "gripper.yaml").write_text(text, encoding="utf-8")
        load(Path(folder))


@QUICK
@given(junk=st.binary(max_size=12) | st.text(max_size=12).map(str.encode), data=st.data())
def test_any_bytes_anywhere(junk: bytes, data: st.DataObject) -> None:
    """Any bytes stand between or instead of others."""
    text = yaml.safe_dump(source()).encode()
    first, second = sorted(data.draw(st.integers(0, len(text))) for _ in range(2))
    end = data.draw(st.sampled_from([first, min(first + 8, len(text)), second]))
    with TemporaryDirectory() as folder:
        write(Path(folder))
        (Path(folder) / "gripper.yaml").write_bytes(text[:first] + junk + text[end:])
        load(Path(folder))
