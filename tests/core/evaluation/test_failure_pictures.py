"""What failed is shown by its cause, and looking at it changes nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from megrasp_core.cli import main
from megrasp_core.errors import InvalidRequestError
from megrasp_core.evaluation.failure_pictures import FailurePictures
from megrasp_core.evaluation.planners import Planner
from megrasp_core.evaluation.protocols import ProtocolName, ProtocolSettings, run_scene
from megrasp_core.grippers import load_gripper
from megrasp_core.objects import procedural_object
from megrasp_core.synthesizer import RankedGrasp, Synthesis


class InTheAir(Planner):
    """Answers with one grasp, over everything that lies there, which fails on any machine."""

    name = "in the air"

    def plan(self, cloud, **options):
        pose = np.diag([1.0, -1.0, -1.0, 1.0])
        pose[2, 3] = 0.6
        back = pose.copy()
        back[2, 3] += 0.1
        grasp = RankedGrasp(pose, pose, back, back, 0.5, 0.04, 0.01, 0.0, True)
        return Synthesis([grasp], {}, {"total": 0.0}, 0, 100, 20, "robotiq_2f85", self.name)


@pytest.mark.slow
@pytest.mark.parametrize("protocol", ["binpick", "declutter"])
def test_every_failure_has_a_picture(tmp_path: Path, protocol: ProtocolName) -> None:
    gripper = load_gripper("robotiq_2f85")
    pool = [procedural_object(seed, kind="box") for seed in range(8)]
    settings = ProtocolSettings(protocol=protocol, graspable=3, obstacles=1)

    def run(pictures: FailurePictures | None):
        return run_scene(settings, gripper, InTheAir(), pool, range(8), 4, pictures=pictures)

    pictures = FailurePictures(tmp_path, gripper)
    outcome, plain = run(pictures), run(None)
    assert (outcome.first, outcome.targets) == (plain.first, plain.targets)
    taken = {str(path.relative_to(tmp_path)) for path in tmp_path.glob("*/*.png")}
    assert taken == {f"no_contact/004_{n:02d}.png" for n in range(1, len(outcome.first) + 1)}
    sheets = pictures.sheets()
    assert [path.name for path in sheets] == ["no_contact.png"]
    with Image.open(sheets[0]) as sheet:
        assert np.asarray(sheet.convert("RGB")).std() > 10
    with pytest.raises(InvalidRequestError, match="pictures of another run"):
        pictures.require_new()


def test_rounds_in_pybullet_have_none(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    arguments = ["eval", "--gripper", "franka_hand", "--protocol", "packed", "--out", "o.json"]
    assert main([*arguments, "--failures", str(tmp_path)]) == 2
    assert "--failures" in capsys.readouterr().err
