"""PCD files 0.7: ASCII, binary, compressed; points, colours, the sensor's place.

Read here and not by a library; see `ply.py` for why.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
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
LOSS = 1e-4
"""What a written coordinate may lose (m)."""
IN_VIEW = 0.5
"""Cosine of the angle to its axis within which a camera sees."""


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


def read_pcd(path: Path, *, optical: bool = False) -> Cloud:
    """The points of a file in metres; VIEWPOINT is the sensor's place.

    Points that lie in front of a turned sensor in its own axes only, not where VIEWPOINT puts it,
    are moved from there into the frame of VIEWPOINT.

    Args:
        path: of the file.
        optical: the sensor's axes are asked for: such points stay in them.

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
    with np.errstate(invalid="ignore"):  # signalling NaN
        points = np.stack([by_name[name] for name in "xyz"], axis=1).astype(np.float64)
    cloud = Cloud(points, _colours(header, by_name))
    return _seen_from(path, cloud, header.viewpoint, optical=optical)


def write_pcd(path: Path, cloud: Cloud, *, binary: bool = True) -> None:
    """Write points, colours, and the sensor's place where there is one for all.

    Points are float32, which every reader takes, or float64 where that would lose more than
    `LOSS`: far from the origin, as places on a map are.
    """
    finite = cloud.finite().points
    # Numbers beyond float32 become infinite, which is a loss as well.
    with np.errstate(over="ignore"):
        loss = np.abs(finite - finite.astype(np.float32)).max(initial=0.0)
    size = 4 if loss <= LOSS else 8
    names, row = ["x", "y", "z"], [(name, f"<f{size}") for name in "xyz"]
    sizes = [size] * 3
    if cloud.colors is not None:
        names, row, sizes = [*names, "rgb"], [*row, ("rgb", "<u4")], [*sizes, 4]
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
        f"SIZE {' '.join(map(str, sizes))}", f"TYPE {' '.join(kinds)}",
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
        with np.errstate(invalid="ignore", over="ignore"):
            return unpacked(values.astype(np.float32).view(np.uint32))
    with np.errstate(invalid="ignore"):  # text may be any number
        return unpacked(values.astype(np.int64).astype(np.uint32))


def _seen_from(path: Path, cloud: Cloud, viewpoint: tuple[float, ...], *, optical: bool) -> Cloud:
    """The cloud with where its sensor was."""
    if viewpoint == UNSET:
        return cloud
    place = np.array(viewpoint[:3])
    w, x, y, z = viewpoint[3:]
    if np.linalg.norm([w, x, y, z]) < 1e-6:
        return replace(cloud, viewpoint=place)
    turn = Rotation.from_quat([x, y, z, w])
    if turn.magnitude() < 1e-6:
        return replace(cloud, viewpoint=place)
    ahead = np.array([0.0, 0.0, 1.0])
    seen = cloud.points[np.isfinite(cloud.points).all(axis=1)]
    seen = seen[(seen != 0.0).any(axis=1)]
    own_axes = _in_view(seen, ahead) > 0.99 and _in_view(seen - place, turn.apply(ahead)) < 0.9
    if not own_axes:
        LOGGER.warning(
            "%s: the sensor's place is taken from VIEWPOINT, %s; its rotation is not used, the "
            "points stay in their frame",
            path,
            place.tolist(),
        )
        return replace(cloud, viewpoint=place)
    if optical:
        return replace(cloud, viewpoint=np.zeros(3))
    down = " ".join(f"{value:.4g}" for value in turn.inv().apply(-ahead))
    LOGGER.warning(
        "%s: the points lie in front of the sensor in its own axes, not where VIEWPOINT puts it; "
        "they are moved into the frame of VIEWPOINT, place %s and rotation (w x y z) %s. For "
        "grasps in the sensor's axes give --frame optical --gravity %s",
        path,
        place.tolist(),
        np.round([w, x, y, z], 4).tolist(),
        down,
    )
    empty = (cloud.points == 0.0).all(axis=1)
    moved = np.where(empty[:, None], 0.0, turn.apply(cloud.points) + place)
    return replace(cloud, points=moved, viewpoint=place)


def _in_view(from_sensor: NDArray[np.float64], axis: NDArray[np.float64]) -> float:
    """Share of points (N, 3) that a sensor at the origin sees along its axis (3,)."""
    length = np.linalg.norm(from_sensor, axis=1)
    return float((from_sensor @ axis > IN_VIEW * length).mean()) if len(length) else 0.0
