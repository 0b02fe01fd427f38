"""`megrasp explain`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from megrasp_core.errors import CloudError, GravityError

from .common import say
from .synthesis_options import SynthesisOptions, with_bar
from .synthesize import report

__all__ = ["explain"]


def explain(
    synthesis: Annotated[SynthesisOptions, tyro.conf.OmitArgPrefixes], *, out: Path
) -> int:
    """Why these grasps, and why not there: a page with pictures of one synthesis.

    Try:
      megrasp explain bin.ply --gripper robotiq_2f85 --region bin.yaml --out why
      xdg-open why/explanation.html

    Args:
        synthesis: as of `megrasp synthesize`; the same seed gives the same grasps.
        out: folder for explanation.html, explanation.json and pictures.
    """
    request = synthesis.request()
    cloud, request = synthesis.read(request)
    synthesizer = synthesis.load()
    from megrasp_core.explanation import explain as explained
    from megrasp_core.explanation import refused, write_explanation

    assert synthesizer.gripper is not None
    try:
        request = synthesis.placed(cloud, request)
    except (CloudError, GravityError) as error:
        explanation = refused(cloud, request, synthesizer.gripper, error)
    else:
        explanation = with_bar(explained, synthesizer, cloud, request)
    page = write_explanation(explanation, out, synthesis.cloud_frame)
    if explanation.answer is not None:
        report(explanation.answer)
    for cause in explanation.causes:
        say(f"- {cause}")
    say(f"wrote {page}")
    if explanation.refusal:
        return 2
    return 0 if explanation.returned else 1
