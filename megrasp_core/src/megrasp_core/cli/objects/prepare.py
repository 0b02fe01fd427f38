"""`megrasp objects prepare`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro

from megrasp_core.cli.common import Flag, say
from megrasp_core.cli.runs import executor_of, run_bar

__all__ = ["prepare"]

SHEET = "objects.png"


def prepare(
    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SRC")],
    destination: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DST")],
    scale: float | None = None,
    density: float = 500.0,
    mass: float | None = None,
    faces: int = 2000,
    decomposition: Literal["auto", "coacd", "hull"] = "auto",
    picture: Path | None = None,
    no_picture: Flag = False,
    workers: int = 1,
) -> int:
    """Make sim-ready objects from meshes; a folder that exists is continued.

    Each mesh is checked for its unit, repaired (equal vertices, winding, loose parts, holes), made
    light, cut into convex pieces, and given mass, inertia and its centre of mass as origin.
    Objects that are whole and were made of the same mesh with the same options are kept, damaged
    and half-written ones are made again. A mesh that fails does not stop the others; exit code 1
    where any did.

    Try: megrasp objects prepare scans my_objects
         megrasp objects prepare cad my_objects --scale 0.001 --density 1100 --workers 2
         megrasp objects prepare mug.glb my_objects --mass 0.3
         megrasp eval --gripper robotiq_2f85 --objects my_objects --out rates.json

    Args:
        source: folder of .obj, .ply, .stl, .glb and .off files, or of sub-folders with one each;
            or one such file.
        destination: folder that the object folders go into.
        scale: metres for each unit of the meshes: 0.001 for millimetres, 0.0254 for inches; they
            are in metres without it.
        density: kg/m3 of the volume that a mesh encloses; 500 suits household things with the air
            in them.
        mass: kg of every object, in place of the density.
        faces: most triangles of the visual mesh.
        decomposition: convex pieces by the package coacd, or one hull; auto: coacd where it is
            installed, otherwise one hull and a warning.
        picture: contact sheet (PNG) of every object beside its convex pieces; DST/objects.png
            without it.
        no_picture: draw none.
        workers: processes.
    """
    from megrasp_core.objects import PrepareSettings, load_object, prepare_objects

    settings = PrepareSettings(scale, density, mass, faces, decomposition)

    with run_bar("objects") as tell:
        summary = prepare_objects(
            source, destination, settings, executor_of("local", None, workers), tell
        )
    for line in summary.made:
        say(line)
    run = summary.run
    kept = f", kept {summary.kept}" if summary.kept else ""
    say(f"wrote {run.done} objects to {destination} in {run.seconds:.0f} s{kept}")
    if summary.folders and not no_picture:
        from megrasp_core.drawing.object_picture import object_sheet

        sheet = picture or destination / SHEET
        say(f"wrote {object_sheet([load_object(folder) for folder in summary.folders], sheet)}")
    for file, message in run.failed:
        say(f"failed: {file}: {message.partition(': ')[2] or message}")
    if run.cancelled:
        say(f"stopped: {run.reason}")
        say("what is written is whole; run the same command again to go on")
    return 1 if run.failed or run.cancelled else 0
