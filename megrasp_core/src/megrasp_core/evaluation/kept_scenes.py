"""Scenes that are done, kept beside the result file until it is written: an evaluation takes
hours, and one that was stopped goes on.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from megrasp_core.errors import InvalidRequestError
from megrasp_core.grippers import Gripper
from megrasp_core.jobs import code_hash, versions
from megrasp_core.objects import ObjectModel

from .outcome import SceneOutcome
from .planners import Planner
from .protocols import ProtocolSettings

__all__ = ["KeptScenes"]

PACKAGE = Path(__file__).parents[1]


class KeptScenes:
    """A file with a line for the run and one for every scene, number and outcome.

    Attributes:
        path: of the file.
        outcomes: of the scenes that are done, by number.
        begun: this run has begun before, even if no scene was done.
    """

    def __init__(self, path: str | Path, run: Mapping[str, Any]) -> None:
        """Read what an earlier run left there, or begin.

        Args:
            path: of the file; missing folders are made.
            run: plain values that say what is run. Scenes of other runs, or of other code, are
                not those of this one.

        Raises:
            InvalidRequestError: the file holds those of another run.
        """
        self.path = Path(path)
        self.outcomes: dict[int, SceneOutcome] = {}
        self.begun = False
        made_with = {"versions": versions(), "code": code_hash(PACKAGE)}
        self._run = json.loads(json.dumps({**run, **made_with}))
        if self.path.exists():
            self._read()

    @classmethod
    def beside(
        cls,
        out: Path,
        settings: ProtocolSettings,
        gripper: Gripper,
        planner: Planner,
        pool: Sequence[ObjectModel],
        graspable: Sequence[int],
        planned_for: Gripper | None = None,
    ) -> KeptScenes:
        """Those of an evaluation, in OUT.part; the number of scenes may be another than before.

        Args:
            out: result file.
            settings: of the protocol.
            gripper: in the simulation.
            planner: answers with grasps.
            pool: objects.
            graspable: indices of those that the gripper can hold.
            planned_for: the gripper that is planned for, where it is another.

        Raises:
            InvalidRequestError: the file holds those of another run.
        """
        of_settings = dataclasses.asdict(settings)
        del of_settings["scenes"]
        run = {
            "settings": of_settings,
            "gripper": gripper.hash,
            "planned_for": (planned_for or gripper).hash,
            "planner": planner.facts(),
            "objects": [model.name for model in pool],
            "graspable": [int(index) for index in graspable],
        }
        return cls(out.with_name(f"{out.name}.part"), run)

    def begin(self) -> None:
        """Leave word of the run before its first scene is done."""
        if not self.begun:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self.path.write_text(json.dumps(self._run) + "\n")
            self.begun = True

    def add(self, number: int, outcome: SceneOutcome) -> None:
        """Keep a scene."""
        self.begin()
        self.outcomes[number] = outcome
        with self.path.open("a") as file:
            line = {"scene": number, "outcome": outcome.to_json()}
            file.write(json.dumps(line) + "\n")

    def remove(self) -> None:
        """Delete the file: the result is written."""
        self.path.unlink(missing_ok=True)

    def _read(self) -> None:
        lines = self.path.read_text().splitlines(keepends=True)
        found = _parsed(lines[0]) if lines else None
        if found != self._run:
            known = found if isinstance(found, dict) else {}
            if known.keys() == self._run.keys() and len(lines) == 1:
                return  # No scene of that run is lost.
            other = [key for key in self._run if known.get(key) != self._run[key]]
            raise InvalidRequestError(
                f"{self.path} holds scenes of a run that was stopped and differs in "
                f"{', '.join(other) or 'what it kept'}; expected those of this run. Run what was "
                "stopped to its end, delete the file, or give another --out."
            )
        self.begun = True
        whole = lines[:1]
        for line in lines[1:]:
            content = _parsed(line)
            # A kill may have cut the last line short.
            if not isinstance(content, dict) or not line.endswith("\n"):
                break
            try:
                number, outcome = int(content["scene"]), content["outcome"]
                self.outcomes[number] = SceneOutcome.from_json(outcome)
            except (KeyError, TypeError, ValueError):
                break
            whole.append(line)
        if len(whole) < len(lines):
            self.path.write_text("".join(whole))


def _parsed(line: str) -> Any:
    try:
        return json.loads(line)
    except ValueError:
        return None
