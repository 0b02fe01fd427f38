"""The whole analysis: from moving joints to axes, TCP and postures, with how sure each is."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import DescriptionError

from .axes import Axes, find_axes
from .bare_arm import no_gripper, refuse_backwards, refuse_wrist
from .fingers import Finger, find_fingers
from .hands import oppose_hand
from .jaws import divide_jaws, oppose_jaws
from .mechanism import Mechanism
from .motion import DriveMotion
from .opposition import Opposition
from .pads import Pad
from .prepare import Prepared
from .several import refuse_several
from .single import oppose_single
from .tcp import PadFinder, find_tcp
from .window import closing_window, looking_from

WRIST_JOINTS = 2
"""From so many joints above it on, the only finger may be the last link of an arm."""

HAND_FINGERS = 4
"""From so many fingers on, one of which turns its plane, it is a hand, however each is bent."""

SAME = 1e-6
PROBE = 0.05
"""Share of a drive's range by which it is moved to see which way the fingers close."""


@dataclass(frozen=True)
class Overrides:
    """What the user says instead of what is found; lengths in metres, vectors in the model frame.

    Attributes:
        approach: direction (3,) out of the palm.
        closing: direction (3,) along which the fingers close.
        tcp: point (3,) between the fingertips.
        tip_depth: distance of the TCP behind the fingertips, instead of `tcp`.
        open: joint or actuator name -> value.
        closed: the same.
        kind: parallel, adaptive or hand.
    """

    approach: NDArray[np.float64] | None = None
    closing: NDArray[np.float64] | None = None
    tcp: NDArray[np.float64] | None = None
    tip_depth: float | None = None
    open: Mapping[str, float] = field(default_factory=dict)
    closed: Mapping[str, float] = field(default_factory=dict)
    kind: str | None = None


@dataclass(frozen=True)
class Analysis:
    """What a description needs, in the model frame.

    `pads`: of the open and the closed posture, None for hands. `limited`: whether the gripper
    opens farther than to the open posture, but its pads look past each other there. `tcp_rule`:
    how the TCP was found where the first rule gave one outside the finger groups.
    """

    fingers: tuple[Finger, ...]
    opposition: Opposition
    axes: Axes
    tcp: NDArray[np.float64]
    pads: tuple[Pad | None, Pad | None]
    kind: str
    limited: bool = False
    tcp_rule: str | None = None

    @property
    def hand(self) -> bool:
        """Whether it is a hand."""
        return self.kind == "hand"


def analyse(prepared: Prepared, overrides: Overrides) -> Analysis:
    """Analyse a prepared model. Raises DescriptionError where nothing opposes anything."""
    mechanism = prepared.mechanism
    fingers = find_fingers(mechanism, prepared.motion)
    if not fingers:
        raise DescriptionError(
            f"none of the {mechanism.model.njnt} joints moves a link with a shape over its range; "
            "expected fingers. Check the limits and mimic multipliers of the model, or name the "
            "gripper's link if the model holds more: --root LINK"
        )
    hand = _is_hand(fingers) if overrides.kind is None else overrides.kind == "hand"
    kind = overrides.kind or _kind(fingers, hand)
    if not hand and not (overrides.open and overrides.closed):
        refuse_several(mechanism, prepared.motion, fingers)
    motion = given_window(mechanism, prepared.motion, fingers, overrides)
    if not hand and len(fingers) > 1 and not (overrides.open and overrides.closed):
        motion = closing_window(mechanism, motion, fingers)
    # With both postures given, the user has said that it closes.
    arm = 0 if overrides.open and overrides.closed else prepared.carried
    wrist = _wrist(fingers) if arm >= WRIST_JOINTS else None
    if wrist is not None:
        refuse_wrist(motion, wrist, arm)
    try:
        opposition = _opposition(mechanism, motion, fingers, hand, overrides)
    except DescriptionError as error:
        if wrist is None:
            raise
        raise no_gripper(wrist, arm, "closes on nothing") from error

    def axes_of(opposition: Opposition) -> Axes:
        return find_axes(
            mechanism, motion, opposition, hand, overrides.closing, overrides.approach
        )

    axes = axes_of(opposition)
    opposition = _first_group_on_minus_x(opposition, axes)
    if hand:
        finder = PadFinder(mechanism, motion, opposition, axes)
        tcp = find_tcp(finder, (None, None), overrides.tip_depth)
        return _analysis(fingers, opposition, axes, tcp, (None, None), kind, False, overrides)
    limited = False
    if not overrides.open and len(fingers) == 1:
        # Where a jaw that opens far begins it meets other parts of the palm.
        start = looking_from(motion, fingers, opposition.open, opposition.closed, axes.closing)
        limited = not np.array_equal(start, opposition.open)
        opposition = replace(opposition, open=start)
        axes = axes_of(opposition)
    opposition = _met(mechanism, motion, opposition, axes, overrides)
    if not overrides.open:
        start = looking_from(motion, fingers, opposition.open, opposition.closed, axes.closing)
        if not np.array_equal(start, opposition.open):
            limited = True
            opposition = replace(opposition, open=start)
            if len(fingers) > 1:
                opposition = divide_jaws(mechanism, motion, fingers, start, opposition.closed)
            axes = axes_of(opposition)
            opposition = _first_group_on_minus_x(opposition, axes)
            opposition = _met(mechanism, motion, opposition, axes, overrides)
    if wrist is not None:
        refuse_backwards(mechanism, motion, opposition, axes.approach, wrist, arm)
    finder = PadFinder(mechanism, motion, opposition, axes)
    opened = finder.pad(opposition.open)
    length = None if opened is None else opened.length
    pads = opened, finder.pad(opposition.closed, length)
    tcp = find_tcp(finder, pads, overrides.tip_depth)
    return _analysis(fingers, opposition, axes, tcp, pads, kind, limited, overrides)


def _analysis(
    fingers: tuple[Finger, ...],
    opposition: Opposition,
    axes: Axes,
    tcp: NDArray[np.float64],
    pads: tuple[Pad | None, Pad | None],
    kind: str,
    limited: bool,
    overrides: Overrides,
) -> Analysis:
    point = tcp if overrides.tcp is None else overrides.tcp
    return Analysis(fingers, opposition, axes, point, pads, kind, limited)


def _first_group_on_minus_x(opposition: Opposition, axes: Axes) -> Opposition:
    if float(axes.closing @ opposition.axis) >= 0.0:
        return opposition
    return replace(
        opposition,
        groups=(opposition.groups[1], opposition.groups[0]),
        fixed=(opposition.fixed[1], opposition.fixed[0]),
        axis=-opposition.axis,
    )


def _met(
    mechanism: Mechanism,
    motion: DriveMotion,
    opposition: Opposition,
    axes: Axes,
    overrides: Overrides,
) -> Opposition:
    """Return the opposition closed until the pads meet, unless the closed posture is given."""
    if overrides.closed:
        return opposition
    finder = PadFinder(mechanism, motion, opposition, axes)
    closed, contact = finder.closed(finder.pad(opposition.open))
    return replace(opposition, closed=closed, contact=contact)


def _wrist(fingers: Sequence[Finger]) -> Finger | None:
    """Return the only finger where it turns."""
    return fingers[0] if len(fingers) == 1 and not fingers[0].sliding else None


def _is_hand(fingers: tuple[Finger, ...]) -> bool:
    if len(fingers) < 2:
        return False
    thumb = len(fingers) >= HAND_FINGERS and any(finger.spread for finger in fingers)
    return thumb or any(len(finger.curl) >= 2 for finger in fingers)


def _kind(fingers: tuple[Finger, ...], hand: bool) -> str:
    if hand:
        return "hand"
    sliding = all(finger.sliding and len(finger.moving) == 1 for finger in fingers)
    return "parallel" if sliding else "adaptive"


def _opposition(
    mechanism: Mechanism,
    motion: DriveMotion,
    fingers: tuple[Finger, ...],
    hand: bool,
    overrides: Overrides,
) -> Opposition:
    ends = None
    if overrides.open and overrides.closed:
        start = given_lengths(motion, motion.rest(), overrides.open, "--open")
        ends = start, given_lengths(motion, start, overrides.closed, "--closed")
    if len(fingers) == 1:
        found = oppose_single(mechanism, motion, fingers[0], ends)
    elif ends is not None:
        found = divide_jaws(mechanism, motion, fingers, *ends)
    elif hand:
        found = oppose_hand(mechanism, motion, fingers, mechanism.branches[0].reach)
    else:
        found = oppose_jaws(mechanism, motion, fingers)
    if overrides.open:
        found = replace(found, open=given_lengths(motion, found.open, overrides.open, "--open"))
    if overrides.closed:
        closed = given_lengths(motion, found.closed, overrides.closed, "--closed")
        found = replace(found, closed=closed)
    return found


def given_window(
    mechanism: Mechanism,
    motion: DriveMotion,
    fingers: tuple[Finger, ...],
    overrides: Overrides,
) -> DriveMotion:
    """Return the motion limited by the postures that are given: nothing is looked for beyond them.

    Where one of the two is given, the range is kept on the side to which the fingertips come
    nearer to each other (from the open posture) or move apart (from the closed one).

    Raises:
        DescriptionError: a name or value is wrong, or both postures are the same.
    """
    opened, closed = overrides.open, overrides.closed
    base = motion.rest()
    start = given_lengths(motion, base, opened, "--open")
    end = given_lengths(motion, start if opened else base, closed, "--closed")
    low, high = motion.low, motion.high
    if opened and closed:
        if np.abs(end - start).max(initial=0.0) < SAME:
            raise DescriptionError(
                "--open and --closed are the same posture; expected two between which the "
                "fingers close"
            )
        named = _named(motion, {**opened, **closed})
        low[named] = np.minimum(start, end)[named]
        high[named] = np.maximum(start, end)[named]
    elif opened or closed:
        known = start if opened else end
        for drive in _named(motion, opened or closed):
            step = PROBE * (motion.high[drive] - motion.low[drive])
            up, down = known.copy(), known.copy()
            up[drive] = min(known[drive] + step, motion.high[drive])
            down[drive] = max(known[drive] - step, motion.low[drive])
            nearer = tips_apart(mechanism, motion, fingers, up) < tips_apart(
                mechanism, motion, fingers, down
            )
            if nearer == bool(opened):
                low[drive] = known[drive]
            else:
                high[drive] = known[drive]
    else:
        return motion
    return motion.within(low, high)


def tips_apart(
    mechanism: Mechanism,
    motion: DriveMotion,
    fingers: tuple[Finger, ...],
    lengths: NDArray[np.float64],
) -> float:
    """Return the mean distance (m) between fingertips, of a single finger that to the palm."""
    poses = motion.poses(lengths)
    if len(fingers) == 1:
        palm = mechanism.surface(poses, mechanism.palm)
        tip = fingers[0].tip_at(poses)
        return float(np.linalg.norm(palm - tip, axis=1).min(initial=np.inf))
    tips = [finger.tip_at(poses) for finger in fingers]
    return float(np.mean([np.linalg.norm(b - a) for a, b in itertools.combinations(tips, 2)]))


def _named(motion: DriveMotion, given: Mapping[str, float]) -> list[int]:
    by_name = _drives_by_name(motion)
    return sorted({by_name[name] for name in given})


def given_lengths(
    motion: DriveMotion, base: NDArray[np.float64], given: Mapping[str, float], option: str
) -> NDArray[np.float64]:
    """Return drive lengths (n,): `base` with those of the named joints or actuators replaced.

    Raises:
        DescriptionError: a name is no joint or drive, or a coupling rules it, or it is out of
            range.
    """
    out = base.copy()
    model = motion.model
    by_name = _drives_by_name(motion)
    for name, value in given.items():
        if name not in by_name:
            raise DescriptionError(
                f"{option} names '{name}', which is no joint or actuator that can be set freely; "
                f"valid: {', '.join(by_name)}"
            )
        drive = motion.drives[by_name[name]]
        joint = drive.joints[0]
        is_joint = len(drive.joints) == 1 and model.joint(joint).name == name
        length = value * float(drive.coefs[joint]) if is_joint else value
        if not drive.low - 1e-4 <= length <= drive.high + 1e-4:
            raise DescriptionError(
                f"{option} sets {name}={value:g}, outside its range {drive.low:g} to "
                f"{drive.high:g}"
            )
        out[by_name[name]] = np.clip(length, drive.low, drive.high)
    return out


def _drives_by_name(motion: DriveMotion) -> dict[str, int]:
    """Return the drives by their names and, where they move one joint, by that of the joint."""
    out: dict[str, int] = {}
    for index, drive in enumerate(motion.drives):
        out[drive.name] = index
        if len(drive.joints) == 1:
            out.setdefault(motion.model.joint(drive.joints[0]).name, index)
    return out
