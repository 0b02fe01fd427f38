"""The wizard finds axes, TCP, fingers and postures of grippers whose facts it does not see."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from wizard_models import SINGLE, around_a_centre, jaws, mjcf

from megrasp_core.errors import DescriptionError, InvalidRequestError
from megrasp_core.gripper_tools.wizard import ModelRequest, Overrides, new_gripper
from megrasp_core.gripper_tools.wizard.findings import GUESS, SURE
from megrasp_core.gripper_tools.wizard.score import (
    compare_with_facts,
    facts_of,
    score_assets,
    within_limits,
)
from megrasp_core.grippers import Gripper, load_description

OWN = Path(__file__).parents[3] / "gripper_descriptions"
SAME_MODEL = {"shadow_hand_2f", "shadow_hand_3f"}
NAMES = sorted(
    folder.name
    for folder in OWN.iterdir()
    if (folder / "gripper.yaml").is_file() and folder.name not in SAME_MODEL
)


def made(tmp_path: Path, text: str, **overrides: object):
    """Run the wizard on an MJCF text, without a picture."""
    (tmp_path / "gripper.xml").write_text(text)
    request = ModelRequest(
        tmp_path / "gripper.xml",
        tmp_path / "out",
        overrides=Overrides(**overrides),  # type: ignore[arg-type]
    )
    return new_gripper(request, picture=False)


@pytest.mark.parametrize("name", NAMES)
def test_own_models_are_understood(tmp_path, name):
    """The model alone, in a folder that does not tell its name, gives what its author wrote."""
    original = load_description(OWN / name)
    source = tmp_path / "input"
    shutil.copytree(original.model_path.parent, source)
    (source / "gripper.yaml").unlink()
    model = source / original.model_path.name
    result = new_gripper(ModelRequest(model, tmp_path / "something"), picture=False)
    angles = compare_with_facts(result.description, facts_of(original))
    assert within_limits(original.kind == "hand", *angles), angles
    assert not result.errors
    assert (result.description.kind == "hand") == (original.kind == "hand")
    sides = {frozenset(group) for group in result.description.fingers}
    assert len(sides) == 2
    if original.max_width is not None:
        assert result.description.max_width == pytest.approx(original.max_width, rel=0.15)


@pytest.mark.slow
def test_real_grippers_score(assets):
    """At least 11 of the 13 real models, their measured facts hidden."""
    score = score_assets(assets / "grippers")
    assert len(score.rows) == 13
    assert score.right >= 11, [row for row in score.rows if not row.right]


def test_turned_model_turns_the_answer(tmp_path):
    """Nothing depends on how the model lies in its file."""
    plain = made(tmp_path, mjcf(jaws())).description
    turn = Rotation.from_euler("xyz", [0.7, -0.4, 1.1])
    x, y, z, w = turn.as_quat()
    (tmp_path / "turned").mkdir()
    text = mjcf(jaws(f'pos="0.3 0.1 0.2" quat="{w} {x} {y} {z}"'))
    turned = made(tmp_path / "turned", text).description
    fact = facts_of(plain)
    fact = {
        "closing": turn.apply(fact["closing"]),
        "approach": turn.apply(fact["approach"]),
        "tcp": turn.apply(fact["tcp"]) + np.array([0.3, 0.1, 0.2]),
    }
    closing, approach, tcp = compare_with_facts(turned, fact)
    assert closing < 0.1 and approach < 0.1 and tcp < 1e-3
    assert turned.max_width == pytest.approx(plain.max_width, abs=1e-3)


def test_bracket_beside_the_palm_does_not_tilt_the_approach(tmp_path):
    """The approach leads along the fingers, wherever the palm's bulk lies."""
    bracket = '<geom type="box" size="0.02 0.06 0.01" pos="0 0.08 0.03"/>'
    result = made(tmp_path, mjcf(jaws(more=bracket)))
    assert result.analysis.axes.approach == pytest.approx([0, 0, 1], abs=1e-6)


def test_single_jaw_closes_against_the_palm(tmp_path):
    """One moving jaw; the fixed one is a part of the base."""
    result = made(tmp_path, SINGLE)
    axes = result.analysis.axes
    assert abs(axes.closing[0]) == pytest.approx(1.0, abs=0.02)
    assert axes.approach == pytest.approx([0, 0, 1], abs=0.02)
    assert result.description.fingers == (("base",), ("jaw",))
    assert not result.errors


@pytest.mark.parametrize("count", [3, 4])
def test_fingers_around_a_centre(tmp_path, count):
    """All divisions oppose alike; the TCP lies in the middle and the symmetry is found."""
    result = made(tmp_path, around_a_centre(count))
    assert result.analysis.axes.approach == pytest.approx([0, 0, 1], abs=0.01)
    assert result.description.tcp[:2] == pytest.approx([0, 0], abs=0.003)
    assert result.description.symmetry == count
    fingers = next(f for f in result.findings if f.what == "fingers")
    assert fingers.sureness != SURE


def test_motors_and_free_joint_are_replaced(tmp_path):
    """A motor holds no position: its joint is driven by the description."""
    motors = '<actuator><motor joint="slide_a"/><motor joint="slide_b"/></actuator>'
    result = made(tmp_path, mjcf(jaws(more="<freejoint/>"), motors))
    assert set(result.description.actuation) == {"slide_a", "slide_b"}
    assert "free joint" in " ".join(result.notes)
    gripper = Gripper(result.description)
    assert gripper.closed_joints["slide_a"] == pytest.approx(0.033, abs=1e-4)
    assert gripper.description.min_width == pytest.approx(0.004, abs=1e-3)


def test_joints_without_limits_are_a_guess(tmp_path):
    """Without limits the wizard says what it assumed."""
    text = mjcf(jaws()).replace('range="0 0.033"', "").replace('range="-0.033 0"', "")
    result = made(tmp_path, text)
    unsure = {finding.what for finding in result.findings if finding.sureness == GUESS}
    assert {"drives", "open"} <= unsure


def test_given_answers_win(tmp_path):
    """What the user says is taken as it is, and called given."""
    result = made(
        tmp_path,
        mjcf(jaws()),
        closing=np.array([-2.0, 0.0, 0.0]),
        tcp=np.array([0.0, 0.0, 0.07]),
        closed={"slide_a": 0.02},
    )
    mount = result.description.mount_from_model.matrix()
    assert mount[0, :3] == pytest.approx([-1, 0, 0], abs=1e-6)
    assert result.description.tcp == pytest.approx((0, 0, 0.07))
    assert result.description.closed.joints is not None
    assert result.description.closed.joints["slide_a"] == pytest.approx(0.02)
    given = {finding.what for finding in result.findings if finding.why == "given"}
    assert given == {"closing", "tcp", "closed"}
    # The first group is that on -X, which is now the side of +x.
    assert result.description.fingers == (("finger_b",), ("finger_a",))


def test_tip_depth(tmp_path):
    """The TCP lies as far behind the fingertips as the user says."""
    result = made(tmp_path, mjcf(jaws()), tip_depth=0.01)
    assert result.description.tcp[2] == pytest.approx(0.08, abs=5e-4)


def test_both_postures_given_decide_the_groups(tmp_path):
    """Given postures replace the search; opening against the drives' ends is possible."""
    result = made(
        tmp_path,
        mjcf(jaws()),
        open={"slide_a": 0.01, "slide_b": -0.01},
        closed={"slide_a": 0.03, "slide_b": -0.03},
    )
    assert result.description.open.joints == {"slide_a": 0.01, "slide_b": -0.01}
    assert result.description.max_width == pytest.approx(0.05, abs=1e-3)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"elbow": 1.0}, r"--open names 'elbow'.*valid: slide_a, slide_b"),
        ({"slide_a": 0.2}, r"--open sets slide_a=0.2, outside its range 0 to 0.033"),
    ],
)
def test_wrong_postures_are_refused(tmp_path, given, message):
    """Unknown joints and values out of range are named with the valid ones."""
    with pytest.raises(DescriptionError, match=message):
        made(tmp_path, mjcf(jaws()), open=given)


def test_existing_description_is_kept(tmp_path):
    """A second run does not overwrite what the user may have edited."""
    made(tmp_path, mjcf(jaws()))
    with pytest.raises(InvalidRequestError, match=r"holds a gripper.yaml already"):
        made(tmp_path, mjcf(jaws()))
