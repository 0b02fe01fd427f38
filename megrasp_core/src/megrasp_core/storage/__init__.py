"""How scenes lie on disk: records, data set folders, device packs; written so that no accident
costs a finished scene, read so that no damage goes unnoticed.
"""

from .attempts import Attempt, AttemptFolder, read_attempt
from .codec import (
    TextCodes,
    pack_positions,
    pack_quaternions,
    split,
    texts_of,
    unpack_poses,
)
from .device_pack import DevicePack, verify_pack
from .device_packing import PackSettings, PackSource, write_pack
from .files import (
    DamagedError,
    open_npz,
    packed_npz,
    read_json,
    remove_leftovers,
    set_aside,
    text_array,
    text_of,
    write_bytes,
    write_npz,
)
from .inspection import record_problems, scene_stats
from .integrity import move_aside, unfinished, verify_dataset
from .packed_scene import PackedScene
from .records import (
    NOT_TRIED,
    ROBUST_TRIALS,
    GraspSet,
    GripperLabels,
    Kind,
    SceneRecord,
    bin_fields,
    bin_from_fields,
    pack_normals,
)
from .scene_dataset import SceneDataset, scene_name
from .scene_writer import SceneWriter
from .training_scenes import TrainingScene, open_scenes

__all__ = [
    "Attempt",
    "AttemptFolder",
    "TextCodes",
    "pack_positions",
    "pack_quaternions",
    "split",
    "texts_of",
    "unpack_poses",
    "DamagedError",
    "DevicePack",
    "GraspSet",
    "GripperLabels",
    "Kind",
    "NOT_TRIED",
    "PackSettings",
    "PackSource",
    "PackedScene",
    "ROBUST_TRIALS",
    "SceneDataset",
    "SceneRecord",
    "SceneWriter",
    "TrainingScene",
    "bin_fields",
    "bin_from_fields",
    "move_aside",
    "open_npz",
    "open_scenes",
    "pack_normals",
    "packed_npz",
    "read_attempt",
    "read_json",
    "record_problems",
    "remove_leftovers",
    "scene_name",
    "scene_stats",
    "set_aside",
    "text_array",
    "text_of",
    "unfinished",
    "verify_dataset",
    "verify_pack",
    "write_bytes",
    "write_npz",
    "write_pack",
]
