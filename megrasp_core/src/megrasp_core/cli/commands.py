"""The tree of commands. A new command is a function in a file of its own and one line here."""

from __future__ import annotations

from tyro.extras import SubcommandApp

from .calibrate import calibrate
from .compare import compare
from .data.generate import grasps, scenes, stats
from .data.look import look
from .data.pack import pack
from .data.plan import plan
from .data.render import render as render_recipes
from .data.robust import robust
from .data.rollouts import rollouts
from .data.verify import verify
from .demo import demo
from .evaluation import bench, evaluation, samples
from .gripper.fidelity import fidelity
from .gripper.frames import frames
from .gripper.inspect import check, listed, render, show
from .gripper.new import new, score_wizard
from .gripper.postures import postures
from .gripper.sample import sample
from .objects import generate
from .synthesize import synthesize
from .train import train

__all__ = ["app"]


def app() -> SubcommandApp:
    """All commands."""
    root = SubcommandApp()
    root.command(demo)
    root.command(synthesize)
    grippers = _group(
        list=listed,
        show=show,
        check=check,
        render=render,
        new=new,
        sample=sample,
        fidelity=fidelity,
        frames=frames,
        postures=postures,
        score_wizard=score_wizard,
    )
    root.command(grippers, name="gripper", help="List, show, check, draw and add grippers.")
    root.command(_group(generate=generate), name="objects", help="Make objects to grasp.")
    data = _group(
        grasps=grasps,
        scenes=scenes,
        pack=pack,
        stats=stats,
        verify=verify,
        look=look,
        render=render_recipes,
        plan=plan,
        samples=samples,
        rollouts=rollouts,
        robust=robust,
    )
    root.command(data, name="data", help="Make, pack and check training data.")
    root.command(train)
    root.command(evaluation, name="eval")  # type: ignore[call-overload]
    root.command(calibrate)
    root.command(compare)
    root.command(bench)
    return root


def _group(**functions: object) -> SubcommandApp:
    group = SubcommandApp()
    for name, function in functions.items():
        group.command(function, name=name.replace("_", "-"))  # type: ignore[call-overload]
    return group
