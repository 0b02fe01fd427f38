"""The tree of commands. A new command is a function in a file of its own and one line here."""

from __future__ import annotations

from collections.abc import Callable

from tyro.extras import SubcommandApp

from .bench import bench
from .bin import find
from .calibrate import calibrate
from .compare import compare
from .data.few import few
from .data.generate import grasps, scenes, stats
from .data.look import look
from .data.pack import pack
from .data.plan import plan
from .data.render import render as render_recipes
from .data.robust import robust
from .data.rollouts import rollouts
from .data.samples import samples
from .data.verify import verify
from .demo import demo
from .evaluation import evaluation
from .explain import explain
from .finetune import finetune
from .gripper.fidelity import fidelity
from .gripper.frames import frames
from .gripper.inspect import check, listed, render, show
from .gripper.new import new, score_wizard
from .gripper.postures import postures
from .gripper.sample import sample
from .gripper.view import view as view_gripper
from .objects.compare import compare as compare_objects
from .objects.generate import generate
from .objects.prepare import prepare
from .serve import serve
from .synthesize import synthesize
from .train import train
from .view import view

__all__ = ["COMMANDS", "app"]


Command = Callable[..., int]

COMMANDS: dict[str, Command | tuple[str, dict[str, Command]]] = {
    "demo": demo,
    "synthesize": synthesize,
    "explain": explain,
    "serve": serve,
    "view": view,
    "gripper": (
        "List, show, check, draw and add grippers.",
        {
            "list": listed,
            "show": show,
            "check": check,
            "render": render,
            "view": view_gripper,
            "new": new,
            "sample": sample,
            "fidelity": fidelity,
            "frames": frames,
            "postures": postures,
            "score-wizard": score_wizard,
        },
    ),
    "bin": ("Find bins in clouds.", {"find": find}),
    "objects": (
        "Make objects to grasp.",
        {"generate": generate, "prepare": prepare, "compare": compare_objects},
    ),
    "data": (
        "Make, pack and check training data.",
        {
            "grasps": grasps,
            "scenes": scenes,
            "pack": pack,
            "stats": stats,
            "verify": verify,
            "look": look,
            "render": render_recipes,
            "plan": plan,
            "samples": samples,
            "rollouts": rollouts,
            "robust": robust,
            "few": few,
        },
    ),
    "train": train,
    "finetune": finetune,
    "eval": evaluation,
    "calibrate": calibrate,
    "compare": compare,
    "bench": bench,
}
"""Every command by name; a group with what it is for."""


def app() -> SubcommandApp:
    """All commands."""
    root = SubcommandApp()
    for name, entry in COMMANDS.items():
        if not isinstance(entry, tuple):
            root.command(entry, name=name)  # type: ignore[call-overload]
            continue
        help, members = entry
        group = SubcommandApp()
        for member, function in members.items():
            group.command(function, name=member)  # type: ignore[call-overload]
        root.command(group, name=name, help=help)
    return root
