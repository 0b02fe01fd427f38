"""PLY files, ASCII and binary of either byte order: vertices with colours.

Read here and not by a library, so that a file which ends early or holds what is no number is an
error that says where, never points that were not in it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import CloudError

from .cloud import Cloud
from .colours import as_shares
from .text_table import text_columns

TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2",
    "ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
COLOURS = (
    ("red", "green", "blue"),
    ("r", "g", "b"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
)
LONGEST_HEADER = 1_000_000


@dataclass
class Element:
    """One kind of rows: its properties as (name, numpy type), a list as (name, its two types)."""

    name: str
    count: int
    properties: list[tuple[str, str] | tuple[str, tuple[str, str]]] = field(default_factory=list)

    @property
    def plain(self) -> bool:
        """Without lists: all rows are of one length."""
        return all(isinstance(kind, str) for _, kind in self.properties)

    def row(self, order: str) -> np.dtype:
        """Type of one binary row."""
        return np.dtype([(name, order + str(kind)) for name, kind in self.properties])


def read_ply(path: Path) -> Cloud:
    """The vertices of a file, in metres as they stand there.

    Raises:
        CloudError: it is no PLY file, it is damaged, or its vertices have no x, y, z.
    """
    data = path.read_bytes()
    order, elements, start = _header(path, data)
    before: list[Element] = []
    for element in elements:
        if element.name == "vertex":
            break
        before.append(element)
    else:
        names = ", ".join(element.name for element in elements) or "(none)"
        raise CloudError(f"{path} has the elements {names}; expected one named vertex.")
    types = dict(element.properties)
    kinds = {types.get(name) for name in "xyz"}
    if (
        not element.plain
        or len(kinds) != 1
        or None in kinds
        or len(types) < len(element.properties)
    ):
        has = ", ".join(f"{name} ({kind})" for name, kind in element.properties) or "(none)"
        raise CloudError(
            f"the vertices of {path} have {has}; expected x, y, z of one type, each property "
            "once, and no lists."
        )
    if order == "":
        columns = text_columns(
            path,
            data[start:],
            [name for name, _ in element.properties],
            skip=sum(one.count for one in before),
            count=element.count,
            what="vertex",
        )
    else:
        for other in before:
            start = _after(path, data, start, other, order)
        columns = _binary(path, data, start, element, order)
    with np.errstate(invalid="ignore"):  # signalling NaN
        points = np.stack([columns[name] for name in "xyz"], axis=1).astype(np.float64)
    colors = None
    for names in COLOURS:
        if set(names) <= set(columns):
            dtype = np.dtype(str(types[names[0]]))
            colors = as_shares(np.stack([columns[name] for name in names], axis=1), dtype)
            break
    return Cloud(points, colors)


def write_ply(path: Path, cloud: Cloud, *, binary: bool = True) -> None:
    """Write points (and colours, in 255 steps)."""
    row = [("x", "<f8"), ("y", "<f8"), ("z", "<f8")]
    lines = ["property double x", "property double y", "property double z"]
    if cloud.colors is not None:
        row += [(name, "u1") for name in COLOURS[0]]
        lines += [f"property uchar {name}" for name in COLOURS[0]]
    table = np.zeros(len(cloud), row)
    for axis, name in enumerate("xyz"):
        table[name] = cloud.points[:, axis]
    if cloud.colors is not None:
        for axis, name in enumerate(COLOURS[0]):
            table[name] = np.rint(255.0 * np.clip(cloud.colors[:, axis], 0.0, 1.0))
    kind = "binary_little_endian" if binary else "ascii"
    head = ["ply", f"format {kind} 1.0", f"element vertex {len(cloud)}", *lines, "end_header", ""]
    text = "\n".join(head).encode()
    if binary:
        path.write_bytes(text + table.tobytes())
        return
    rows = "\n".join(" ".join(repr(value.item()) for value in one) for one in table)
    path.write_bytes(text + rows.encode() + b"\n")


def _header(path: Path, data: bytes) -> tuple[str, list[Element], int]:
    """Byte order ("" for text), elements, and where their data begins."""
    end = data.find(b"end_header", 0, LONGEST_HEADER)
    if not data.startswith(b"ply") or end < 0:
        raise CloudError(
            f"{path} is no PLY file or its header is cut; expected 'ply' to 'end_header'."
        )
    stop = data.find(b"\n", end)
    if stop < 0:
        raise CloudError(f"{path} ends at its header; expected vertices. Copy or save it again.")
    order: str | None = None
    elements: list[Element] = []
    for line in data[:end].decode("latin-1").splitlines()[1:]:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        try:
            if words[0] == "format":
                order = FORMATS[words[1]]
            elif words[0] == "element":
                elements.append(Element(words[1], int(words[2])))
                if elements[-1].count < 0:
                    raise ValueError
            elif words[0] == "property" and words[1] == "list":
                elements[-1].properties.append((words[4], (TYPES[words[2]], TYPES[words[3]])))
            elif words[0] == "property":
                elements[-1].properties.append((words[2], TYPES[words[1]]))
            else:
                raise ValueError
        except (KeyError, IndexError, ValueError):
            raise CloudError(
                f"{path} has the header line {line.strip()[:80]!r}; expected format, element or "
                "property as PLY 1.0 has them. Save it again."
            ) from None
    if order is None:
        raise CloudError(f"{path} has no line 'format'; expected one of {', '.join(FORMATS)}.")
    return order, elements, stop + 1


def _binary(
    path: Path, data: bytes, start: int, element: Element, order: str
) -> dict[str, NDArray]:
    row = element.row(order)
    whole = max(0, len(data) - start) // row.itemsize
    if whole < element.count:
        raise CloudError(
            f"{path} ends at {element.name} {whole} of {element.count}; expected a whole file. "
            "Copy or save it again."
        )
    table = np.frombuffer(data, row, element.count, start)
    return {name: table[name] for name in row.names or ()}


def _after(path: Path, data: bytes, start: int, element: Element, order: str) -> int:
    """Where the data of the next element begins."""
    if element.plain:
        return start + element.count * element.row(order).itemsize
    for _ in range(element.count):
        for _, kind in element.properties:
            if isinstance(kind, str):
                start += np.dtype(kind).itemsize
                continue
            size = np.dtype(order + kind[0])
            if start + size.itemsize > len(data):
                raise CloudError(f"{path} ends before its vertices; expected a whole file.")
            many = int(np.frombuffer(data, size, 1, start)[0])
            start += size.itemsize + max(0, many) * np.dtype(kind[1]).itemsize
    return start
