"""`GraspSynthesizer`: load a model, set a gripper, synthesize grasps for clouds."""

from .hints import sensor_doubt
from .perception import Perceived, perceive
from .polish import promises
from .poses import PoseSet, pose_set
from .repairs import backed_off
from .request import MAX_DRAWN, MAX_GRASPS, Mode, SynthesisRequest
from .result import RankedGrasp, Synthesis
from .sampling import denoiser, draw_starts
from .scene_judge import Assessment, SceneJudge, seen_plane
from .selection import rank_poses
from .settings import REPAIRS, PolishSettings, RankingSettings, Stage, SynthesizerSettings
from .synthesizer import GraspSynthesizer
from .trace import Trace

__all__ = [
    "MAX_DRAWN",
    "MAX_GRASPS",
    "REPAIRS",
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
    "Trace",
    "backed_off",
    "denoiser",
    "draw_starts",
    "perceive",
    "pose_set",
    "promises",
    "rank_poses",
    "sensor_doubt",
    "seen_plane",
]
