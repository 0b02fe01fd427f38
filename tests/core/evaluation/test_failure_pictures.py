"""What failed is shown by its cause, and looking at it changes nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from megrasp_core.cli import main
from megrasp_core.errors import InvalidRequestError
from megrasp_core.evaluation.failure_pictures import FailurePictures
from megrasp_core.evaluation.planners import AntipodalPlanner
from megrasp_core.evaluation.protocols import ProtocolSettings, run_scene
from megrasp_core.evaluation.search import GraspSearch, SearchSettings
from megrasp_core.grippers import load_gripper
from megrasp_core.objects import procedural_object


@pytest.mark.slow
@pytest.mark.parametrize("protocol", ["binpick", "declutter"])
def test_every_failure_that_counts_has_a_picture(tmp_path: Path, protocol: str) -> None:
    gripper = load_gripper("robotiq_2f85")
    pool = [procedural_object(seed) for seed in range(20)]
    settings = ProtocolSettings(
        protocol=protocol,  # pyright: ignore[reportArgumentType]
        graspable=4,
        obstacles=2,
        drawn=30,
        possible_only=protocol == "binpick",
        seed=5,
    )
    search = (
        GraspSearch(gripper, SearchSettings(candidates=100)) if protocol == "binpick" else None
    )

    def run(pictures: FailurePictures | None):
        planner = AntipodalPlanner(gripper)
        return run_scene(settings, gripper, planner, pool, range(20), 0, search, pictures)

    pictures = FailurePictures(tmp_path, gripper)
    outcome = run(pictures)
    plain = run(None)
    assert (outcome.first, outcome.targets, outcome.counted) == (
        plain.first,
        plain.targets,
        plain.counted,
    )
    failed = {
        f"{reason}/000_{attempt:02d}.png"
        for attempt, (success, reason) in enumerate(outcome.first[: outcome.counted], start=1)
        if not success and reason != "no_answer"
    }
    assert failed
    assert {str(path.relative_to(tmp_path)) for path in tmp_path.glob("*/*.png")} == failed
    sheets = pictures.sheets()
    assert {path.stem for path in sheets} == {name.partition("/")[0] for name in failed}
    with Image.open(sheets[0]) as sheet:
        assert np.asarray(sheet.convert("RGB")).std() > 10
    with pytest.raises(InvalidRequestError, match="pictures of another run"):
        pictures.require_new()


def test_rounds_in_pybullet_have_none(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    arguments = ["eval", "--gripper", "franka_hand", "--protocol", "packed", "--out", "o.json"]
    assert main([*arguments, "--failures", str(tmp_path)]) == 2
    assert "--failures" in capsys.readouterr().err
