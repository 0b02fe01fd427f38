"""`GraspSynthesizer`: load a model, set a gripper, synthesize grasps for clouds."""

from .perception import Perceived, perceive
from .poses import PoseSet, pose_set
from .repairs import backed_off
from .request import MAX_DRAWN, MAX_GRASPS, Mode, SynthesisRequest
from .result import RankedGrasp, Synthesis
from .sampling import draw_starts
from .scene_judge import Assessment, SceneJudge, seen_plane
from .selection import rank_poses
from .settings import PolishSettings, RankingSettings, Stage, SynthesizerSettings
from .synthesizer import GraspSynthesizer

__all__ = [
    "MAX_DRAWN",
    "MAX_GRASPS",
    "Assessment",
    "GraspSynthesizer",
    "Mode",
    "Perceived",
    "PolishSettings",
    "PoseSet",
    "RankedGrasp",
    "RankingSettings",
    "SceneJudge",
    "Synthesis",
    "SynthesisRequest",
    "Stage",
    "SynthesizerSettings",
    "backed_off",
    "draw_starts",
    "perceive",
    "pose_set",
    "rank_poses",
    "seen_plane",
]
