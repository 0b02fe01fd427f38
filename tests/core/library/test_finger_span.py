"""Where opposing fingers meet: jaws, whose answer is known, and hands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from megrasp_core.grippers import Gripper, load_gripper
from megrasp_core.library import CandidateSettings, antipodal
from megrasp_core.library.finger_span import FingerSpan
from megrasp_core.objects import procedural_object

HANDS = ("allegro_hand", "shadow_dexee", "shadow_hand", "shadow_hand_2f", "shadow_hand_3f")


def span_of(name: str) -> tuple[Gripper, FingerSpan]:
    gripper = load_gripper(name)
    span = FingerSpan.of(gripper)
    assert span is not None
    return gripper, span


@pytest.mark.parametrize("name", ["franka_hand", "robotiq_2f85", "schunk_wsg32"])
def test_jaws_meet_at_the_tcp_along_x(name: str) -> None:
    gripper, span = span_of(name)
    assert span.widest == pytest.approx(gripper.description.max_width, abs=0.002)
    assert (np.diff(span.width) > 0).all()
    middle, axis = span.at(np.linspace(0.01, span.widest - 0.005, 9))
    assert np.abs(middle[:, :2] - gripper.tcp[:2]).max() < 0.003
    assert np.abs(middle[:, 2] - gripper.tcp[2]).max() < 0.015
    assert axis[:, 0].min() > 0.99


@pytest.mark.parametrize("name", HANDS)
def test_fingers_of_hands_meet_near_the_tcp(name: str) -> None:
    gripper, span = span_of(name)
    assert span.width[0] < 0.02 < 0.06 < span.widest
    middle, axis = span.at(np.linspace(0.01, 0.06, 6))
    assert np.linalg.norm(middle - gripper.tcp, axis=1).max() <= 0.03
    # The first group is on -X, though hands do not close along X alone.
    assert axis[:, 0].min() > 0.7
    np.testing.assert_allclose(np.linalg.norm(axis, axis=1), 1.0)


def test_fingers_that_do_not_close_have_no_span() -> None:
    gripper = load_gripper("allegro_hand")
    still = Gripper(replace(gripper.description, closed=gripper.description.open))
    assert FingerSpan.of(still) is None


def test_hands_bring_what_lies_between_their_fingers_to_the_pair() -> None:
    """With no play the middle of the fingers lies on the middle of the pair, their axis along."""
    gripper, span = span_of("shadow_hand")
    settings = CandidateSettings(shift=0.0, hand_depth=(0.0, 0.0))
    found = [
        antipodal(procedural_object(3), gripper, 40, np.random.default_rng(0), settings=chosen)
        for chosen in (settings, replace(settings, finger_span=False, depth=(0.0, 0.0)))
    ]
    np.testing.assert_array_equal(found[0].width, found[1].width)
    middle, axis = span.at(found[0].width)
    pose, by_tcp = (each.object_from_gripper for each in found)
    np.testing.assert_allclose(
        np.einsum("nij,nj->ni", pose[:, :3, :3], middle) + pose[:, :3, 3],
        by_tcp[:, :3, :3] @ gripper.tcp + by_tcp[:, :3, 3],
        atol=1e-9,
    )
    np.testing.assert_allclose(
        np.einsum("nij,nj->ni", pose[:, :3, :3], axis), by_tcp[:, :3, 0], atol=1e-9
    )
