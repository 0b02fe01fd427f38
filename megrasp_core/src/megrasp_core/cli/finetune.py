"""`megrasp finetune`."""

from __future__ import annotations

import dataclasses
import logging
import shlex
from pathlib import Path
from typing import Annotated

import tyro

from megrasp_core.errors import InvalidRequestError

from .common import changed, emit, progress_bar, say
from .grasp_file import read_grasps

__all__ = ["finetune"]

LOGGER = logging.getLogger(__name__)


def finetune(
    gripper: str,
    grasps: Path,
    out: Path,
    model: str | None = None,
    model_id: str | None = None,
    steps: int | None = None,
    settings: Annotated[
        tuple[str, ...], tyro.conf.arg(name="set", metavar="NAME=VALUE [NAME=VALUE ...]")
    ] = (),
    report: Path | None = None,
    device: str = "cpu",
    seed: int = 1,
) -> int:
    """Teach a model a gripper from a few grasps; the codes of other grippers are held.

    GRASPS is a JSON list of {"cloud": path, "world_from_gripper": [x, y, z, qx, qy, qz, qw]};
    paths are relative to it, clouds as for `synthesize`. An entry may have `frame` (world,
    optical), `gravity`, `sensor`, `region` and `scale`, which mean what the options of
    `synthesize` do. Each grasp is left out once to see what the others teach; where that is
    nothing, no model is written and the exit code is 1. Takes minutes on one thread and does not
    resume.

    Try:
      megrasp finetune --gripper my_gripper --grasps few/grasps.json --out models/mine
      megrasp synthesize bin.ply --gripper my_gripper --model models/mine

    Args:
        gripper: name, or folder of a gripper.yaml.
        grasps: JSON file of grasps that hold, the best of them in a scene of its own each.
        out: folder of the new model.
        model: id or folder of the model to begin with; the default for the kind of the gripper
            without it.
        model_id: by default the parent's and the gripper's.
        steps: take so many, whatever the grasps left out say; needed with less than three grasps.
        settings: further settings, by the names of `FinetuneConfig`.
        report: JSON file of what was found out, also where no model is written.
        device: cpu or cuda.
        seed: of everything drawn.
    """
    import torch

    from megrasp_core.grippers import load_gripper
    from megrasp_core.network import default_model, load_model, save_model
    from megrasp_core.network.storage import CONFIG
    from megrasp_core.training import FEW, FinetuneConfig, doubt, given_scene
    from megrasp_core.training import finetune as learn
    from megrasp_core.training.finetune_card import finetune_card

    if (out / CONFIG).exists():
        raise InvalidRequestError(f"{out} holds a model already; expected another --out.")
    torch.set_num_threads(1)
    config = changed(FinetuneConfig(seed=seed), settings, "--set")
    loaded = load_gripper(gripper)
    parent = load_model(model or default_model(loaded.description.kind), device=device)
    given = read_grasps(grasps)
    if len(given) < FEW:
        LOGGER.warning(
            "%d grasps are too few to leave any out: nothing will show whether the model gets "
            "better. Expected at least %d, better ten.",
            len(given),
            FEW,
        )
    scenes = [given_scene(grasp, loaded, parent.info.scene) for grasp in given]
    question = doubt(scenes, loaded)
    if question is not None:
        LOGGER.warning("%s", question)
    with progress_bar(None, "finetune") as bar:

        def tell(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        result = learn(parent, loaded, scenes, config, steps=steps, on_progress=tell)
    for band, before in result.before.items():
        say(f"{band:>7} noise: loss of grasps left out {before:.3f} -> {result.after[band]:.3f}")
    if result.curve:
        say(f"gain {result.gain:.4f} +- {result.gain_error:.4f} after {result.steps} steps")
    facts = {
        "gripper": loaded.name,
        "gripper_hash": loaded.hash,
        "grasps": [
            {"cloud": one.name, "sha256": one.digest, "world_from_gripper": one.pose7}
            for one in given
        ],
        **result.facts(),
        "settings": dataclasses.asdict(config),
    }
    if report is not None:
        emit({"model": parent.model_id, "written": result.model is not None, **facts}, report)
    if result.model is None:
        say(
            "the given grasps teach nothing that helps with those left out: no model is written. "
            "Give more grasps, or --steps to learn from them all the same."
        )
        return 1
    info = parent.info
    result.model.info = dataclasses.replace(
        info,
        model_id=model_id or f"{info.model_id}-{loaded.name}",
        started_from=info.as_start(),
        finetuned=facts,
    )
    save_model(result.model, out)
    words = ["megrasp", "finetune", "--gripper", gripper, "--grasps", str(grasps), "--model",
             info.model_id, "--seed", str(seed)]  # fmt: skip
    words += [] if steps is None else ["--steps", str(steps)]
    words += ["--set", *settings] if settings else []
    card = finetune_card(result.model.info, shlex.join(words))
    (out / "MODEL_CARD.md").write_text(card)
    say(f"other grippers: codes moved by at most {result.others:.3f} standard deviations")
    say(f"wrote {out}; use it with --model {out}")
    return 0
