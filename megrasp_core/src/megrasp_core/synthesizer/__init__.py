"""`GraspSynthesizer`: load a model, set a gripper, synthesize grasps for clouds (DESIGN sections 1
and 6).
"""

from .evaluate import Assessment, SceneJudge, seen_plane
from .poses import PoseSet, pose_set, poses_of_tcp
from .request import MAX_DRAWN, MAX_GRASPS, Mode, SynthesisRequest
from .result import RankedGrasp, Synthesis
from .selection import collect
from .settings import PolishSettings, RankingSettings, SynthesizerSettings
from .starts import draw_starts
from .synthesizer import GraspSynthesizer

__all__ = [
    "Assessment",
    "GraspSynthesizer",
    "MAX_DRAWN",
    "MAX_GRASPS",
    "Mode",
    "PolishSettings",
    "PoseSet",
    "RankedGrasp",
    "RankingSettings",
    "SceneJudge",
    "Synthesis",
    "SynthesisRequest",
    "SynthesizerSettings",
    "collect",
    "draw_starts",
    "pose_set",
    "poses_of_tcp",
    "seen_plane",
]
