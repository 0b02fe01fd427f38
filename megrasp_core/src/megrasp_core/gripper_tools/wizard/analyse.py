"""The whole analysis: from moving joints to axes, TCP and postures, with how sure each is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import DescriptionError

from .axes import Axes, find_axes
from .fingers import Finger, find_fingers
from .hands import oppose_hand
from .jaws import divide_jaws, oppose_jaws
from .motion import DriveMotion
from .opposition import Opposition
from .pads import Pad
from .prepare import Prepared
from .single import oppose_single
from .tcp import PadFinder, find_tcp

HAND_FINGERS = 4
"""From so many fingers on, one of which turns its plane, it is a hand, however each is bent."""


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

    `pads`: of the open and the closed posture, None for hands.
    """

    fingers: tuple[Finger, ...]
    opposition: Opposition
    axes: Axes
    tcp: NDArray[np.float64]
    pads: tuple[Pad | None, Pad | None]
    kind: str

    @property
    def hand(self) -> bool:
        """Whether it is a hand."""
        return self.kind == "hand"


def analyse(prepared: Prepared, overrides: Overrides) -> Analysis:
    """Analyse a prepared model. Raises DescriptionError where nothing opposes anything."""
    mechanism, motion = prepared.mechanism, prepared.motion
    fingers = find_fingers(mechanism, motion)
    if not fingers:
        raise DescriptionError(
            "no joint moves a link with a shape; expected fingers. Name the gripper's link if the "
            "model holds more: --root LINK"
        )
    hand = _is_hand(fingers) if overrides.kind is None else overrides.kind == "hand"
    kind = overrides.kind or _kind(fingers, hand)
    opposition = _opposition(prepared, fingers, hand, overrides)
    axes = find_axes(mechanism, motion, opposition, hand, overrides.closing, overrides.approach)
    if float(axes.closing @ opposition.axis) < 0.0:
        # The first group is that on -X.
        opposition = replace(
            opposition,
            groups=(opposition.groups[1], opposition.groups[0]),
            fixed=(opposition.fixed[1], opposition.fixed[0]),
            axis=-opposition.axis,
        )
    pads: tuple[Pad | None, Pad | None] = (None, None)
    if not hand:
        finder = PadFinder(mechanism, motion, opposition, axes)
        opened = finder.pad(opposition.open)
        if not overrides.closed:
            closed, contact = finder.closed(opened)
            opposition = replace(opposition, closed=closed, contact=contact)
        length = None if opened is None else opened.length
        pads = opened, finder.pad(opposition.closed, length)
    tcp = find_tcp(motion, opposition, axes, pads, overrides.tip_depth)
    if overrides.tcp is not None:
        tcp = overrides.tcp
    return Analysis(fingers, opposition, axes, tcp, pads, kind)


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
    prepared: Prepared, fingers: tuple[Finger, ...], hand: bool, overrides: Overrides
) -> Opposition:
    mechanism, motion = prepared.mechanism, prepared.motion
    if len(fingers) == 1:
        found = oppose_single(mechanism, motion, fingers[0])
    elif overrides.open and overrides.closed:
        start = given_lengths(motion, motion.rest(), overrides.open, "--open")
        end = given_lengths(motion, start, overrides.closed, "--closed")
        found = divide_jaws(mechanism, motion, fingers, start, end)
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
    by_name: dict[str, int] = {}
    for index, drive in enumerate(motion.drives):
        by_name[drive.name] = index
        if len(drive.joints) == 1:
            by_name.setdefault(model.joint(drive.joints[0]).name, index)
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
