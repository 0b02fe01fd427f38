"""`megrasp gripper frames`: a picture of the frames of every gripper, and their table."""

from __future__ import annotations

import os
from pathlib import Path

import tyro

from megrasp_core.cli.common import Names, block_writer, progress_bar, say

__all__ = ["frames"]


def frames(
    names: tyro.conf.Positional[Names] = (),
    out: Path = Path("frames"),
    page: Path | None = None,
) -> int:
    """Draw the frames of grippers: axes, TCP, open and closed posture, what closing sweeps.

    One picture <name>.png each. The table of the page is that of all own descriptions, whichever
    are drawn.

    Try: megrasp gripper frames --out docs/images/frames --page docs/frames.md
         megrasp gripper frames my_gripper/ --out pictures

    Args:
        names: registered names or folders of a gripper.yaml; without any, all own descriptions
            (the CAD models are left out).
        out: folder that the pictures go into.
        page: markdown page whose lines between <!-- frames --> and <!-- /frames --> become the
            table and the pictures.
    """
    from megrasp_core.drawing.frame_page import frames_block, own_descriptions
    from megrasp_core.drawing.frame_picture import frame_picture
    from megrasp_core.grippers import load_gripper

    write = None if page is None else block_writer(page, "frames")
    own = own_descriptions()
    grippers = [load_gripper(name) for name in names or [d.name for d in own]]
    with progress_bar(len(grippers), "pictures") as bar:
        for gripper in grippers:
            frame_picture(gripper, out / f"{gripper.name}.png")
            bar.update()
    say(f"wrote {len(grippers)} pictures to {out}")
    if page is not None and write is not None:
        write(frames_block(own, Path(os.path.relpath(out, page.parent)).as_posix()))
        say(f"wrote {page}")
    return 0
