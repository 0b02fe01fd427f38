"""How sure each answer of the analysis is, and why."""

from __future__ import annotations

import numpy as np

from megrasp_core.grippers import GripperDescription

from .analyse import Analysis, Overrides
from .drives import unlimited_joints
from .findings import GUESS, LIKELY, SURE, Finding
from .prepare import Prepared

CLEAR_MARGIN = 0.2
"""A division into groups is clear when the next best is at least this much worse (share)."""

WELL_FACING = 0.8
NEAR_AXIS = np.radians(5.0)
WELL_FORMED_PAD = 0.01
GIVEN = "given"


def conclude(
    prepared: Prepared,
    analysis: Analysis,
    description: GripperDescription,
    overrides: Overrides,
) -> list[Finding]:
    """Return all findings, in the order in which they build on each other."""
    return [
        _joints(prepared),
        _kind(analysis, overrides),
        _groups(analysis, description),
        _closing(analysis, overrides),
        _approach(prepared, analysis, overrides),
        _tcp(analysis, overrides),
        _open(prepared, analysis, description, overrides),
        _closed(analysis, description, overrides),
    ]


def _joints(prepared: Prepared) -> Finding:
    motion = prepared.motion
    free = unlimited_joints(prepared.model)
    coupled = prepared.model.njnt - len(motion.drives)
    why = f"{prepared.model.njnt} moving joints, {coupled} of them follow others"
    if free:
        why = f"{', '.join(free)} without limits: +-90 degrees or +-5 cm assumed; add limits"
    value = " ".join(drive.name for drive in motion.drives)
    return Finding("drives", value, GUESS if free else SURE, why, "")


def _kind(analysis: Analysis, overrides: Overrides) -> Finding:
    if overrides.kind:
        return Finding("kind", analysis.kind, SURE, GIVEN, "--kind")
    most = max(len(finger.curl) for finger in analysis.fingers)
    why = f"{len(analysis.fingers)} moving fingers, up to {most} drives bend one"
    return Finding("kind", analysis.kind, SURE, why, "--kind")


def _groups(analysis: Analysis, description: GripperDescription) -> Finding:
    found = analysis.opposition
    value = [list(group) for group in description.fingers]
    if len(analysis.fingers) == 1:
        return Finding("fingers", value, LIKELY, "one finger closes against the palm", "")
    if found.facing < WELL_FACING:
        why = f"the sides move towards each other only by cosine {found.facing:.2f}"
        return Finding("fingers", value, GUESS, why, "--open --closed")
    if found.margin < CLEAR_MARGIN:
        why = "another division opposes as well (alike fingers around a centre)"
        return Finding("fingers", value, LIKELY, why, "--closing")
    return Finding("fingers", value, SURE, "their pads move towards each other", "")


def _closing(analysis: Analysis, overrides: Overrides) -> Finding:
    value = _vector(analysis.axes.closing)
    if overrides.closing is not None:
        return Finding("closing", value, SURE, GIVEN, "--closing")
    turned = analysis.axes.snapped[0]
    if analysis.opposition.facing < WELL_FACING:
        return Finding("closing", value, GUESS, "the pads do not look at each other", "--closing")
    if turned < NEAR_AXIS:
        return Finding("closing", value, SURE, "relative motion, along a model axis", "--closing")
    if np.isfinite(turned):
        why = f"relative motion, turned {np.degrees(turned):.0f} deg onto a model axis"
        return Finding("closing", value, LIKELY, why, "--closing")
    why = "from pad to pad in the pre-grasp" if analysis.hand else "relative motion, no model axis"
    return Finding("closing", value, LIKELY, why, "--closing")


def _approach(prepared: Prepared, analysis: Analysis, overrides: Overrides) -> Finding:
    value = _vector(analysis.axes.approach)
    if overrides.approach is not None:
        return Finding("approach", value, SURE, GIVEN, "--approach")
    palm = bool(np.isin(prepared.mechanism.owner, prepared.mechanism.palm).any())
    if not palm:
        why = "the palm has no shape, so where it faces is a guess"
        return Finding("approach", value, GUESS, why, "--approach")
    turned = analysis.axes.snapped[1]
    why = "from the palm to the pads, across the closing axis"
    if np.isfinite(turned):
        sureness = SURE if turned < 2.0 * NEAR_AXIS else LIKELY
        why = f"{why}, {np.degrees(turned):.0f} deg from a model axis"
        return Finding("approach", value, sureness, why, "--approach")
    return Finding("approach", value, LIKELY if analysis.hand else GUESS, why, "--approach")


def _tcp(analysis: Analysis, overrides: Overrides) -> Finding:
    value = _vector(analysis.tcp)
    if overrides.tcp is not None:
        return Finding("tcp", value, SURE, GIVEN, "--tcp")
    if analysis.tcp_rule is not None:
        return Finding("tcp", value, LIKELY, analysis.tcp_rule, "--tcp")
    if analysis.hand:
        why = "where thumb and fingertips meet as they curl"
        return Finding("tcp", value, LIKELY, why, "--tcp")
    pad = analysis.pads[0]
    if pad is None:
        why = "no faces of the fingers are opposite; middle of the tips"
        return Finding("tcp", value, GUESS, why, "--tcp")
    if not pad.opposite:
        why = "in the middle of the tips, which pass beside each other"
        return Finding("tcp", value, LIKELY, why, "--tcp, --tip-depth")
    depth = pad.tip - float(analysis.tcp @ analysis.axes.approach)
    why = f"{1000 * depth:.0f} mm behind the open tips, faces {1000 * pad.length:.0f} mm long"
    sureness = LIKELY if pad.length >= WELL_FORMED_PAD else GUESS
    return Finding("tcp", value, sureness, why, "--tcp, --tip-depth")


def _open(
    prepared: Prepared,
    analysis: Analysis,
    description: GripperDescription,
    overrides: Overrides,
) -> Finding:
    posture = description.open
    value = dict(posture.joints or posture.actuators or {})
    if overrides.open:
        return Finding("open", value, SURE, GIVEN, "--open")
    if unlimited_joints(prepared.model):
        return Finding("open", value, GUESS, "joints without limits", "--open")
    if analysis.hand:
        why = "widest posture whose pads still look at each other"
        return Finding("open", value, LIKELY, why, "--open")
    width = description.max_width or 0.0
    if analysis.limited:
        why = f"widest posture whose pads still look at each other: {1000 * width:.0f} mm"
        return Finding("open", value, LIKELY, why, "--open")
    return Finding("open", value, SURE, f"the widest: {1000 * width:.0f} mm at the TCP", "--open")


def _closed(analysis: Analysis, description: GripperDescription, overrides: Overrides) -> Finding:
    posture = description.closed
    value = dict(posture.joints or posture.actuators or {})
    if overrides.closed:
        return Finding("closed", value, SURE, GIVEN, "--closed")
    if analysis.hand:
        met = "the tips touch" if analysis.opposition.contact else "the tips are nearest"
        return Finding("closed", value, LIKELY, f"fingers curled until {met}", "--closed")
    if analysis.opposition.contact:
        return Finding("closed", value, SURE, "the pads touch", "--closed")
    why = f"the joints' limits; {1000 * description.min_width:.0f} mm stay open"
    return Finding("closed", value, LIKELY, why, "--closed")


def _vector(value: np.ndarray) -> list[float]:
    return [round(float(v), 4) + 0.0 for v in value]
