"""One wall of a bin: where its inside is at the rim, and how much of it is seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

STEP = 0.005
"""A wall is looked at in pieces of this length (m)."""
FINE = 0.002
"""Across a wall, the height is looked at in strips of this width (m)."""
INSIDE, OUTSIDE = 0.030, 0.070
"""Strips are looked at so far inside and outside of a wall (m)."""
BELOW = 0.012
"""Points of a wall's inside lie at least this far below the rim, others may be of the rim (m)."""
STEEPEST_DRAFT = float(np.tan(np.deg2rad(10.0)))
THICKEST = 0.045
"""Widest rim, ledge included (m)."""
THINNEST = 0.003
RIM = 5
"""The rim is looked for in so many strips from the inside on."""


@dataclass(frozen=True, eq=False)
class Wall:
    """What is known of one wall. Its inside at the rim is q = at + turn * t; q grows outwards from
    where it was expected, t runs along it (m).

    weight: what it says of the direction of all walls. seen: share of the length on which rim or
    inside is seen; inner: on which the step down inside or the inside is; outside: on which what
    lies outside is lower or not seen. thickness: of the rim (m), NaN if not known. draft: m per m.
    open: share of the length on which something lower is seen where the rim should be.
    """

    at: float
    turn: float
    weight: float
    seen: float
    inner: float
    outside: float
    thickness: float
    draft: float
    open: float


def wall_near(
    q: FloatArray,
    t: FloatArray,
    z: FloatArray,
    half: float,
    band: float,
    slack: float,
    thickness: float,
    from_inside: BoolArray,
) -> Wall:
    """The wall among points near it.

    Args:
        q: (N,) outwards from where the inside is expected (m).
        t: (N,) along the wall (m).
        z: (N,) over the rim (m).
        half: half length of the wall (m).
        band: half thickness of the rim's level, from the noise (m).
        slack: how far the wall may be from where it is expected (m).
        thickness: of the rim, where it is known already, else NaN (m).
        from_inside: (N,) whether each point was seen from the inner side of the wall, and not
            from behind it.
    """
    pieces = max(4, int(2 * (half - STEP) / STEP))
    strips = round((INSIDE + OUTSIDE) / FINE)
    piece = np.clip(((t + half - STEP) / STEP).astype(np.intp), 0, pieces - 1)
    strip = np.clip(((q + INSIDE) / FINE).astype(np.intp), 0, strips - 1)
    top = np.full(pieces * strips, -np.inf)
    np.maximum.at(top, piece * strips + strip, z)
    top = top.reshape(pieces, strips)
    along = -half + STEP + (np.arange(pieces, dtype=np.float64) + 0.5) * STEP
    borders = -INSIDE + np.arange(strips, dtype=np.float64) * FINE
    level, low, deep = np.abs(top) < band, top < -band, top < -2 * BELOW
    # A step: level here, low in the next strips, however narrow the gap to the contents is.
    inwards = np.zeros_like(level)
    inwards[:, 3:] = level[:, 3:] & low[:, 2:-1] & low[:, 1:-2] & deep[:, :-3]
    outwards = np.zeros_like(level)
    # A ledge may lie not far below the rim.
    outwards[:, :-3] = level[:, :-3] & low[:, 1:-2] & low[:, 2:-1] & (top[:, 3:] < -1.5 * band)
    # On average half of the first strip is rim.
    edge = _nearest(inwards, borders + FINE / 2, 0.0, slack)
    if np.isfinite(thickness):
        outer = _nearest(outwards, borders + FINE / 2, thickness, slack)
    else:
        outer = _last_after(outwards, borders + FINE / 2, edge)
    steps = _line(along, edge)
    inside, face, draft = _face(q, t, z, piece, pieces, slack, from_inside)
    line, weight = steps, float(np.isfinite(edge).sum())
    agree = steps is None or inside is None or abs(steps[0] - inside[0]) < 0.006
    if inside is not None and (
        steps is None or (face.mean() > 0.3 and (agree or weight < 0.4 * pieces))
    ):
        # The inside is measured on an area, the step on a line that noise frays.
        line, weight = inside, 2.0 * float(face.sum())
    if np.isfinite(thickness) and max(weight, 2.0 * face.sum()) < 0.2 * pieces:
        # So full that the inside is hardly seen: the outer side, less the thickness.
        outside = _line(along, outer)
        if outside is not None:
            line = outside[0] - thickness, outside[1]
            weight = 0.5 * float(np.isfinite(outer).sum())
    if line is None:
        line, weight = (0.0, 0.0), 0.0
    here = np.abs(edge - line[0] - line[1] * along) < 0.004
    first = np.clip(np.searchsorted(borders, line[0] + line[1] * along), 1, strips - RIM)
    number = np.arange(strips)
    rim = level & (number >= first[:, None] - 1) & (number < first[:, None] + RIM)
    beyond = number >= first[:, None] - 1
    ridge = rim.any(axis=1) & (outwards & beyond).any(axis=1)
    fall = ((top < -BELOW) & beyond).sum(axis=1) > 0.3 * np.maximum(beyond.sum(axis=1), 1)
    width = thickness if np.isfinite(thickness) else THINNEST
    return Wall(
        float(line[0]),
        float(line[1]),
        weight * (2 * half) ** 2,
        float((here | ridge | face).mean()),
        float((here | face).mean()),
        float(fall.mean()),
        float(np.maximum(THINNEST, _median(outer - edge))),
        draft,
        _open(top, first, width, band),
    )


def _open(top: FloatArray, first: NDArray[np.intp], width: float, band: float) -> float:
    """Share of the pieces of `top` (pieces, strips) in which the wall whose inside is in strip
    `first` (pieces,) is not there: its rim and what lies beside it is seen, and all is lower.
    """
    number = np.arange(top.shape[1]) - first[:, None]
    last = max(2, round(width / FINE))
    rim = np.where((number >= 0) & (number < last), top, -np.inf).max(axis=1)
    near = np.where((number >= -2) & (number < last + 2), top, -np.inf).max(axis=1)
    return float((np.isfinite(rim) & (near < -1.5 * band)).mean())


def _median(values: FloatArray) -> float:
    good = values[np.isfinite(values)]
    return float(np.median(good)) if len(good) > 2 else float("nan")


def _nearest(steps: BoolArray, at: FloatArray, where: float, slack: float) -> FloatArray:
    """Place (T,) of the step nearest to `where` in each piece; NaN without one."""
    distance = np.where(steps, np.abs(at - where), np.inf)
    best = distance.argmin(axis=1)
    return np.where(distance[np.arange(len(best)), best] < slack, at[best], np.nan)


def _last_after(steps: BoolArray, at: FloatArray, edge: FloatArray) -> FloatArray:
    """Place (T,) of the outermost step of a rim that begins at `edge`; NaN without one."""
    after = steps & (at >= edge[:, None]) & (at < edge[:, None] + THICKEST)
    last = after.shape[1] - 1 - after[:, ::-1].argmax(axis=1)
    return np.where(after.any(axis=1), at[last], np.nan)


def _line(t: FloatArray, q: FloatArray) -> tuple[float, float] | None:
    """Q = at + turn * t through most of the places (T,), outliers left out."""
    good = np.isfinite(q)
    if good.sum() < 6:
        return None
    t, q = t[good], q[good]
    at, turn = float(np.median(q)), 0.0
    for slack in (0.008, 0.005, 0.003, 0.003):
        near = np.abs(q - at - turn * t) < slack
        if near.sum() < 5:
            return at, turn
        turn, at = _straight(t[near], q[near])
    return at, turn


def _straight(t: FloatArray, q: FloatArray) -> tuple[float, float]:
    """Slope and offset of the least squares line; level where the places lie close together."""
    centre, mean = t.mean(), q.mean()
    if np.ptp(t) < 0.04:
        return 0.0, float(mean)
    slope = float(((t - centre) * (q - mean)).sum() / ((t - centre) ** 2).sum())
    return slope, float(mean - slope * centre)


def _face(
    q: FloatArray,
    t: FloatArray,
    z: FloatArray,
    piece: NDArray[np.intp],
    pieces: int,
    slack: float,
    from_inside: BoolArray,
) -> tuple[tuple[float, float] | None, BoolArray, float]:
    """Line of the inside at the rim, the pieces (T,) in which the inside is seen, its draft."""
    none = np.zeros(pieces, bool)
    on = np.flatnonzero((z < -BELOW) & (np.abs(q) < 0.02 + slack) & from_inside)
    if len(on) < 30:
        return None, none, 0.0
    # The floor meets the wall here and would make it lean.
    bottom = float(np.percentile(z[on], 10))
    on = on[z[on] > bottom + BELOW]
    if len(on) < 30:
        return None, none, 0.0
    q, t, z, piece = q[on], t[on], z[on], piece[on]
    # On a low strip of wall place and draft cannot be told apart.
    leans = -bottom - BELOW > 0.04
    rows = np.column_stack([np.ones(len(q)), t, z] if leans else [np.ones(len(q)), t])
    count, start = np.histogram(q, bins=np.arange(-slack - 0.004, slack + 0.0045, 0.001))
    smooth = np.convolve(count, np.ones(4), mode="same")
    guess = np.zeros(rows.shape[1])
    guess[0] = start[int(np.argmax(smooth))]
    near = none
    for tolerance in (0.010, 0.006, 0.004, 0.004):
        near = np.abs(q - rows @ guess) < tolerance
        if near.sum() < 30:
            return None, none, 0.0
        chosen = rows[near]
        guess = np.linalg.solve(
            chosen.T @ chosen + 1e-9 * np.eye(rows.shape[1]), chosen.T @ q[near]
        )
    draft = float(guess[2]) if leans else 0.0
    if abs(guess[0]) > slack + 0.004 or abs(guess[1]) > 0.06 or not -0.04 < draft < STEEPEST_DRAFT:
        return None, none, 0.0
    # A wall goes up to the rim; the side of something that stands in its line does not.
    face = np.bincount(piece[near], minlength=pieces) >= 3
    face &= np.bincount(piece[near & (z > -3 * BELOW)], minlength=pieces) > 0
    return (float(guess[0]), float(guess[1])), face, draft
