"""Training data: candidates, free-space labels, scenes, storage and where the work runs (DESIGN
section 5).
"""

from megrasp_core.datasets.candidates import (
    Candidates,
    CandidateSettings,
    ObjectSurface,
    antipodal,
)
from megrasp_core.datasets.device_pack import DevicePack, verify_pack
from megrasp_core.datasets.device_packing import PackSettings, PackSource, write_pack
from megrasp_core.datasets.executors import ExecutorConfig, Progress, RunSummary, run_units
from megrasp_core.datasets.inspection import record_problems, scene_stats
from megrasp_core.datasets.integrity import Finding, verify_dataset
from megrasp_core.datasets.labelling import (
    LabelSettings,
    LibraryConfig,
    generate_library,
    label_object,
)
from megrasp_core.datasets.layout import Layout, SceneConfig, ViewShares, draw_layout
from megrasp_core.datasets.library import (
    GraspLibrary,
    load_library,
    pack_library,
    write_grasp_set,
)
from megrasp_core.datasets.library_card import library_card
from megrasp_core.datasets.library_check import verify_library
from megrasp_core.datasets.library_facts import ObjectFacts, library_stats, object_facts
from megrasp_core.datasets.object_set import (
    ObjectSet,
    asset_names,
    procedural_names,
    training_objects,
    validation_objects,
)
from megrasp_core.datasets.packed_scene import PackedScene
from megrasp_core.datasets.pictures import scene_picture
from megrasp_core.datasets.recipes import read_recipes, with_cloud, write_recipes
from megrasp_core.datasets.records import (
    NOT_TRIED,
    ROBUST_TRIALS,
    GraspSet,
    GripperLabels,
    Kind,
    SceneRecord,
)
from megrasp_core.datasets.robust_labels import RobustSettings, RobustTrials, robust_labels
from megrasp_core.datasets.robust_run import generate_robust
from megrasp_core.datasets.scene_writer import SceneWriter
from megrasp_core.datasets.scenes import SceneJob, build_scene, generate_scenes
from megrasp_core.datasets.storage import SceneDataset
from megrasp_core.datasets.training_scenes import TrainingScene, open_scenes

__all__ = [
    "NOT_TRIED",
    "ROBUST_TRIALS",
    "CandidateSettings",
    "Candidates",
    "DevicePack",
    "ExecutorConfig",
    "Finding",
    "GraspLibrary",
    "GraspSet",
    "GripperLabels",
    "Kind",
    "LabelSettings",
    "Layout",
    "LibraryConfig",
    "ObjectFacts",
    "ObjectSet",
    "ObjectSurface",
    "PackSettings",
    "PackSource",
    "PackedScene",
    "Progress",
    "RobustSettings",
    "RobustTrials",
    "RunSummary",
    "SceneConfig",
    "SceneDataset",
    "SceneJob",
    "SceneRecord",
    "ViewShares",
    "SceneWriter",
    "TrainingScene",
    "antipodal",
    "asset_names",
    "build_scene",
    "draw_layout",
    "generate_library",
    "generate_robust",
    "generate_scenes",
    "label_object",
    "library_card",
    "library_stats",
    "load_library",
    "object_facts",
    "open_scenes",
    "pack_library",
    "procedural_names",
    "read_recipes",
    "record_problems",
    "robust_labels",
    "run_units",
    "scene_picture",
    "scene_stats",
    "training_objects",
    "validation_objects",
    "verify_dataset",
    "verify_library",
    "verify_pack",
    "with_cloud",
    "write_grasp_set",
    "write_pack",
    "write_recipes",
]
