"""`GraspSynthesizer`: load a model, set a gripper, synthesize grasps for clouds (DESIGN sections 1
and 6).
"""

from .evaluate import Assessment, SceneJudge, seen_plane
from .poses import PoseSet, pose_set
from .request import MAX_DRAWN, MAX_GRASPS, SynthesisRequest
from .result import RankedGrasp, Synthesis
from .settings import PolishSettings, RankingSettings, SynthesizerSettings
from .synthesizer import GraspSynthesizer

__all__ = [
    "MAX_DRAWN",
    "MAX_GRASPS",
    "Assessment",
    "GraspSynthesizer",
    "PoseSet",
    "PolishSettings",
    "RankedGrasp",
    "RankingSettings",
    "SceneJudge",
    "Synthesis",
    "SynthesisRequest",
    "SynthesizerSettings",
    "pose_set",
    "seen_plane",
]
