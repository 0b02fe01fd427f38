"""PCD files 0.7: ASCII, binary, compressed; points, colours, the sensor's place.

Read here and not by a library; see `ply.py` for why.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from megrasp_core.errors import CloudError

from .cloud import Cloud
from .colours import packed, unpacked
from .text_table import text_columns

LOGGER = logging.getLogger(__name__)
KINDS = {"F": "f", "I": "i", "U": "u"}
SIZES = {"F": (4, 8), "I": (1, 2, 4, 8), "U": (1, 2, 4, 8)}
UNSET = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
LONGEST_HEADER = 100_000


@dataclass(frozen=True)
class Header:
    """What stands before the points."""

    fields: tuple[str, ...]
    types: tuple[np.dtype, ...]
    counts: tuple[int, ...]
    points: int
    viewpoint: tuple[float, ...]
    data: str

    @property
    def row(self) -> np.dtype:
        """Type of one binary row; fields of several numbers are arrays."""
        return np.dtype(
            {
                "names": [f"{place} {name}" for place, name in enumerate(self.fields)],
                "formats": [(kind, (n,)) for kind, n in zip(self.types, self.counts, strict=True)],
            }
        )


def read_pcd(path: Path) -> Cloud:
    """The points of a file, in metres as they stand there; VIEWPOINT is the sensor's place.

    Raises:
        CloudError: it is no PCD file, it is damaged, or it has no x, y, z.
    """
    data = path.read_bytes()
    header, start = _header(path, data)
    kinds = {t for name, t in zip(header.fields, header.types, strict=True) if name in "xyz"}
    if not {"x", "y", "z"} <= set(header.fields) or len(kinds) != 1:
        has = ", ".join(f"{n} ({t})" for n, t in zip(header.fields, header.types, strict=True))
        raise CloudError(f"{path} has the fields {has}; expected x, y, z of one type among them.")
    if header.data == "ascii":
        names = [
            f"{place}.{index} {name}" if index else f"{place} {name}"
            for place, (name, n) in enumerate(zip(header.fields, header.counts, strict=True))
            for index in range(n)
        ]
        columns = text_columns(
            path, data[start:], names, skip=0, count=header.points, what="point"
        )
    else:
        columns = _binary(path, data, start, header)
    by_name = {name: columns[f"{place} {name}"] for place, name in enumerate(header.fields)}
    points = np.stack([by_name[name] for name in "xyz"], axis=1).astype(np.float64)
    return Cloud(points, _colours(header, by_name), _viewpoint(path, header, points))


def write_pcd(path: Path, cloud: Cloud, *, binary: bool = True) -> None:
    """Write points, colours, and the sensor's place where there is one for all."""
    names, row = ["x", "y", "z"], [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
    if cloud.colors is not None:
        names, row = [*names, "rgb"], [*row, ("rgb", "<u4")]
    table = np.zeros(len(cloud), row)
    for axis, name in enumerate("xyz"):
        table[name] = cloud.points[:, axis]
    if cloud.colors is not None:
        table["rgb"] = packed(cloud.colors)
    place = [0.0, 0.0, 0.0]
    if cloud.viewpoint is not None and cloud.viewpoint.ndim == 1:
        place = [float(value) for value in cloud.viewpoint]
    kinds = ["F", "F", "F", "U"][: len(names)]
    head = [
        "# .PCD v0.7 - Point Cloud Data file format", "VERSION 0.7", f"FIELDS {' '.join(names)}",
        f"SIZE {' '.join(['4'] * len(names))}", f"TYPE {' '.join(kinds)}",
        f"COUNT {' '.join(['1'] * len(names))}", f"WIDTH {len(cloud)}", "HEIGHT 1",
        f"VIEWPOINT {' '.join(map(repr, place))} 1 0 0 0", f"POINTS {len(cloud)}",
        f"DATA {'binary' if binary else 'ascii'}", "",
    ]  # fmt: skip
    text = "\n".join(head).encode()
    if binary:
        path.write_bytes(text + table.tobytes())
        return
    rows = "\n".join(" ".join(repr(value.item()) for value in one) for one in table)
    path.write_bytes(text + rows.encode() + b"\n")


def _header(path: Path, data: bytes) -> tuple[Header, int]:
    entries: dict[str, list[str]] = {}
    start = 0
    while "DATA" not in entries:
        stop = data.find(b"\n", start)
        if stop < 0 or stop > LONGEST_HEADER:
            raise CloudError(
                f"{path} is no PCD file or its header is cut; expected lines up to DATA."
            )
        words = data[start:stop].decode("latin-1").split()
        if words and not words[0].startswith("#"):
            entries[words[0]] = words[1:]
        start = stop + 1
    try:
        fields = tuple(entries["FIELDS"])
        counts = tuple(int(word) for word in entries.get("COUNT", ["1"] * len(fields)))
        types = tuple(
            _type(kind, int(size))
            for kind, size in zip(entries["TYPE"], entries["SIZE"], strict=True)
        )
        wide, high = int(entries["WIDTH"][0]), int(entries.get("HEIGHT", ["1"])[0])
        points = int(entries.get("POINTS", [str(wide * high)])[0])
        viewpoint = tuple(float(word) for word in entries.get("VIEWPOINT", UNSET))
        kind = entries["DATA"][0]
        if len(set(fields)) < len(fields) - fields.count("_"):
            raise ValueError(f"FIELDS {' '.join(fields)} has a name twice")
        if not len(fields) == len(types) == len(counts) or min(counts) < 1:
            raise ValueError(f"{len(fields)} FIELDS, {len(types)} TYPEs, {len(counts)} COUNTs")
        if points != wide * high or points < 0:
            raise ValueError(f"POINTS {points}, but WIDTH {wide} times HEIGHT {high}")
        if len(viewpoint) != 7 or not np.isfinite(viewpoint).all():
            raise ValueError(f"VIEWPOINT of {len(viewpoint)} numbers, expected 7 finite ones")
        if kind not in ("ascii", "binary", "binary_compressed"):
            raise ValueError(f"DATA {kind}")
    except (KeyError, IndexError, ValueError) as error:
        told = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise CloudError(
            f"the header of {path} is damaged ({told}); expected FIELDS, SIZE, TYPE, COUNT, "
            "WIDTH, HEIGHT, POINTS and DATA ascii, binary or binary_compressed that fit each "
            "other. Save it again."
        ) from None
    return Header(fields, types, counts, points, viewpoint, kind), start


def _type(kind: str, size: int) -> np.dtype:
    if size not in SIZES.get(kind, ()):
        raise ValueError(f"TYPE {kind} of SIZE {size}")
    return np.dtype(f"<{KINDS[kind]}{size}")


def _binary(path: Path, data: bytes, start: int, header: Header) -> dict[str, NDArray]:
    row = header.row
    body = data[start:]
    if header.data == "binary":
        whole = len(body) // row.itemsize
        if whole < header.points:
            raise _cut(path, whole, header.points)
        table = np.frombuffer(body, row, header.points)
        return {name: table[name][:, 0] for name in row.names or ()}
    if len(body) < 8:
        raise _cut(path, 0, header.points)
    packed_size, size = (int(value) for value in np.frombuffer(body, "<u4", 2))
    if size != header.points * row.itemsize:
        raise CloudError(
            f"{path} is damaged: {size} bytes of points, expected {header.points} times "
            f"{row.itemsize}. Save it again."
        )
    if len(body) < 8 + packed_size:
        raise _cut(path, int(header.points * (len(body) - 8) / max(packed_size, 1)), header.points)
    try:
        flat = unlzf(body[8 : 8 + packed_size], size)
    except (IndexError, ValueError) as error:
        raise CloudError(
            f"the compressed points of {path} are damaged ({error}). Copy or save it again."
        ) from None
    columns, place = {}, 0
    for index, (name, kind, n) in enumerate(
        zip(header.fields, header.types, header.counts, strict=True)
    ):
        values = np.frombuffer(flat, kind, header.points * n, place)
        columns[f"{index} {name}"] = values.reshape(header.points, n)[:, 0]
        place += header.points * n * kind.itemsize
    return columns


def _cut(path: Path, found: int, expected: int) -> CloudError:
    return CloudError(
        f"{path} ends at point {found} of {expected}; expected a whole file. Copy or save it "
        "again."
    )


def unlzf(data: bytes, size: int) -> bytes:
    """Decompress LZF data (Marc Lehmann's format, as PCL writes it) of a known size.

    Raises:
        ValueError: it is damaged.
        IndexError: it is cut.
    """
    out = bytearray()
    place = 0
    while place < len(data):
        control = data[place]
        place += 1
        if control < 32:
            end = place + control + 1
            if end > len(data):
                raise ValueError("a run is cut")
            out += data[place:end]
            place = end
            continue
        length = control >> 5
        if length == 7:
            length += data[place]
            place += 1
        back = len(out) - ((control & 31) << 8) - data[place] - 1
        place += 1
        if back < 0:
            raise ValueError("it refers to what is not there")
        run = length + 2
        while run:  # what is copied may be what this run writes
            part = out[back : back + run]
            out += part
            run -= len(part)
        if len(out) > size:
            break
    if len(out) != size:
        raise ValueError(f"{len(out)} bytes came out, expected {size}")
    return bytes(out)


def _colours(header: Header, columns: dict[str, NDArray]) -> NDArray[np.float64] | None:
    name = next((name for name in ("rgb", "rgba") if name in columns), None)
    if name is None:
        return None
    kind, values = header.types[header.fields.index(name)], columns[name]
    if kind.itemsize != 4:
        return None
    # A float holds the bits of the number 0xRRGGBB; text may spell either.
    if kind.kind == "f":
        return unpacked(values.astype(np.float32).view(np.uint32))
    return unpacked(values.astype(np.int64).astype(np.uint32))


def _viewpoint(path: Path, header: Header, points: NDArray) -> NDArray[np.float64] | None:
    if header.viewpoint == UNSET:
        return None
    place = np.array(header.viewpoint[:3])
    w, x, y, z = header.viewpoint[3:]
    if np.linalg.norm([w, x, y, z]) < 1e-6:
        return place
    turn = Rotation.from_quat([x, y, z, w])
    if turn.magnitude() < 1e-6:
        return place
    forward = turn.apply([0.0, 0.0, 1.0])
    good = points[np.isfinite(points).all(axis=1)]
    own_axes = (
        len(good) and (good[:, 2] > 0).all() and ((good - place) @ forward < 0).mean() > 0.01
    )
    if own_axes:
        down = " ".join(f"{value:.4g}" for value in turn.inv().apply([0.0, 0.0, -1.0]))
        LOGGER.warning(
            "%s: VIEWPOINT turns the sensor, and the points lie in front of it in its own axes, "
            "not where VIEWPOINT puts it; give --frame optical --gravity %s",
            path,
            down,
        )
        return None
    LOGGER.warning(
        "%s: the sensor's place is taken from VIEWPOINT, %s; its rotation is not used, the points "
        "stay in their frame",
        path,
        place.tolist(),
    )
    return place
