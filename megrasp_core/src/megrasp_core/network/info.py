"""What `config.json` says of a model, read strictly: an unknown name or a wrong type is an error
that lists what would be right.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from megrasp_core.diffusion import SamplerSettings
from megrasp_core.errors import MegraspError, ModelError
from megrasp_core.grippers import KINDS
from megrasp_core.pointcloud import SceneSettings
from megrasp_core.ranking import Calibration

from .config import ModelConfig

HEADS = ("confidence", "graspability")
T = TypeVar("T")


@dataclasses.dataclass(frozen=True)
class ModelInfo:
    """A model's facts.

    Attributes:
        network: sizes.
        model_id: name.
        parameters: number of weights.
        sha256: of the file of the weights; "": not checked.
        heads: which of `HEADS` were trained.
        sampler: what the model is meant to be sampled with.
        scene: preprocessing that it was trained with.
        calibration: of its confidence, or None.
        calibration_by_kind: kind of gripper -> the same, for grippers that it was trained with;
            kinds that are missing, and other grippers, take `calibration`.
        low_precision: whether its token part may run in bfloat16.
        trained_grippers: name -> hash of the description, of every gripper of the training.
        procedural_grippers: number of those among the training's scenes.
        data_scenes: number of scenes.
        counters: steps, poses, CPU-seconds and the like, of `megrasp train`.
        training: settings of `megrasp train`, as they were then.
        started_from: the same facts of the model whose weights the training began with.
        finetuned: gripper, grasps and settings of `megrasp finetune`, and what it gained.
    """

    network: ModelConfig
    model_id: str = "untrained"
    parameters: int = 0
    sha256: str = ""
    heads: tuple[str, ...] = ()
    sampler: SamplerSettings = dataclasses.field(default_factory=SamplerSettings)
    scene: SceneSettings = dataclasses.field(default_factory=SceneSettings)
    calibration: Calibration | None = None
    calibration_by_kind: Mapping[str, Calibration] = dataclasses.field(default_factory=dict)
    low_precision: bool = False
    trained_grippers: Mapping[str, str] = dataclasses.field(default_factory=dict)
    procedural_grippers: int = 0
    data_scenes: int = 0
    counters: Mapping[str, float] = dataclasses.field(default_factory=dict)
    training: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    started_from: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    finetuned: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> ModelInfo:
        """Read the content of a `config.json`.

        Raises:
            ModelError: a name is unknown or missing, or a value has another type.
        """
        if "network" not in values:
            raise ModelError(
                f"the model's config has the entries {sorted(values)}; expected 'network' as well."
            )
        given = dict(values)
        given["network"] = ModelConfig.from_dict(given["network"])
        for name, kind in (("sampler", SamplerSettings), ("scene", SceneSettings)):
            if name in given:
                given[name] = _settings(kind, given[name], name)
        if given.get("calibration") is not None:
            given["calibration"] = _settings(Calibration, given["calibration"], "calibration")
        given["calibration_by_kind"] = _calibrations(given.get("calibration_by_kind", {}))
        if isinstance(given.get("heads"), list):
            given["heads"] = tuple(given["heads"])
        info = _settings(cls, given, "")
        wrong = sorted(set(info.heads) - set(HEADS))
        if wrong:
            raise ModelError(f"heads are {wrong} among others; expected some of {list(HEADS)}.")
        return info

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON; what is empty is left out."""
        plain = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        plain["network"] = self.network.to_dict()
        plain["heads"] = list(self.heads)
        plain["sampler"] = dataclasses.asdict(self.sampler)
        plain["scene"] = dataclasses.asdict(self.scene)
        plain["calibration"] = None if self.calibration is None else self.calibration.to_dict()
        plain["calibration_by_kind"] = {
            kind: fitted.to_dict() for kind, fitted in self.calibration_by_kind.items()
        }
        return {name: value for name, value in plain.items() if value not in (None, {}, "")}

    def as_start(self) -> dict[str, Any]:
        """What another model says of this one, whose weights it began with: `started_from`."""
        kept = ("model_id", "counters", "training", "data_scenes", "sha256", "heads", "finetuned")
        facts = self.to_dict()
        return {name: facts[name] for name in kept if name in facts}

    def calibration_for(self, gripper: str, kind: str) -> Calibration | None:
        """The calibration for a gripper by name and kind."""
        if gripper not in self.trained_grippers:
            return self.calibration
        return self.calibration_by_kind.get(kind, self.calibration)


def _calibrations(values: Any) -> dict[str, Calibration]:
    if not isinstance(values, Mapping) or set(values) - set(KINDS):
        raise ModelError(
            f"the model's 'calibration_by_kind' is {values!r}; expected a mapping from some of "
            f"{list(KINDS)}."
        )
    return {
        kind: _settings(Calibration, fitted, f"calibration_by_kind of {kind}")
        for kind, fitted in values.items()
    }


def _settings(kind: type[T], values: Any, where: str) -> T:
    """A dataclass from a mapping whose names and types must be those of its fields."""
    place = f"the model's {where!r}" if where else "the model's config"
    fields = {field.name for field in dataclasses.fields(kind)}  # type: ignore[arg-type]
    if not isinstance(values, Mapping):
        raise ModelError(f"{place} is {values!r}; expected a mapping of {sorted(fields)}.")
    unknown = sorted(set(values) - fields)
    if unknown:
        raise ModelError(
            f"{place} has unknown entries {unknown}; expected some of {sorted(fields)}. The model "
            "was made by another version: install that version or retrain."
        )
    hints = get_type_hints(kind)
    for name, value in values.items():
        if not _fits(value, hints[name]):
            raise ModelError(f"{place} has {name} = {value!r}; expected {_words(hints[name])}.")
    try:
        return kind(**values)
    except MegraspError as error:
        raise ModelError(f"{place} is of no use: {error}") from error


def _fits(value: Any, hint: Any) -> bool:
    origin = get_origin(hint) or hint
    if origin is Literal:
        return value in get_args(hint)
    if origin in (Union, UnionType):
        return any(_fits(value, one) for one in get_args(hint))
    if origin is float:
        return isinstance(value, int | float) and not isinstance(value, bool)
    if origin is int:
        return isinstance(value, int) and not isinstance(value, bool)
    return isinstance(value, origin)


def _words(hint: Any) -> str:
    names = {str: "text", bool: "true or false", int: "a whole number", float: "a number"}
    if hint in names:
        return names[hint]
    if get_origin(hint) is Literal:
        return f"one of {', '.join(map(str, get_args(hint)))}"
    return "a list or mapping as `megrasp train` writes it"
