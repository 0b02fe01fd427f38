"""What lies where in a training scene: draws bin or table, objects and obstacles from a seed and
lets them settle.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from megrasp_core.errors import DataError, SimulationError
from megrasp_core.library import CandidateSettings
from megrasp_core.lie import matrix_from_pose7, pose7_from_matrix
from megrasp_core.objects import ObjectSet, balanced_shares, obstacle_name
from megrasp_core.pointcloud import OrientedBox, SceneSettings
from megrasp_core.simulation import Bin, DepthNoise, ViewName, settle

GRAVITY = (0.0, 0.0, -1.0)
LAYOUT, CAMERA, LABELS, ROBUST = 0, 1, 2, 3
"""Streams of randomness of a scene: what changes in one leaves the others alone."""


@dataclass(frozen=True)
class ViewShares:
    """Shares of the views of `ViewName`; what is left of 1 is top-down.

    Raises:
        DataError: a share below 0, or more than 1 in all.
    """

    dense: float = 0.3
    sparse: float = 0.0

    def __post_init__(self) -> None:
        if min(self.dense, self.sparse) < 0 or self.dense + self.sparse > 1:
            raise DataError(
                f"shares of views dense {self.dense} and sparse {self.sparse} were given; "
                "expected numbers of 0 or more with a sum of at most 1."
            )

    def drawn(self, rng: np.random.Generator) -> ViewName:
        """One view."""
        chance = rng.random()
        if chance < self.dense:
            return "dense"
        return "sparse" if chance < self.dense + self.sparse else "top_down"


@dataclass(frozen=True)
class SceneConfig:
    """How training scenes are drawn and labelled; lengths in m, angles in rad.

    Attributes:
        grippers: names or folders that scenes are labelled for.
        objects: smallest and largest number of graspable objects.
        bin_share: share of scenes in a bin; the rest lie on a table.
        bin_inner: mean inner size of the bin; each edge is drawn within +-`bin_spread`.
        bin_wall: thinnest and thickest walls.
        bin_tilt: steepest tilt of a bin; below what `PlaneSettings` still takes for a floor.
        bin_tilted: share of the bins that are tilted.
        table_region: size of the region of interest on a table.
        grippers_per_scene: so many of them, drawn anew for every scene, are labelled; None: all.
        hands_in_bins, hands_on_tables: how often a hand is drawn for every time a jaw is; a hand
            finds no free grasp in most bins.
        procedural_grippers: size of the rack of procedural grippers (seeds 0, 1, ...).
        procedural_per_scene: so many of the rack, drawn anew for every scene, are labelled
            besides, all from fresh candidates.
        obstacle_share: share of scenes with one to three obstacles.
        camera_height, camera_shift, camera_tilt: camera over the origin, and how far its pose
            varies.
        image: width and height in pixels.
        views: how table scenes are looked at; bins are seen from above.
        noise: of the depth cameras; None for none.
        surface: preprocessing, the same as at inference.
        tilt_bin, tilt_table: steepest approach against straight down that is kept.
        approach: length of the approach path that must be free in bins.
        tested_per_object: library grasps of an object tested for collision, each with its
            symmetric copies.
        fresh: new candidates drawn for each object, with approaches within `fresh_tilt` of
            straight down; again for objects that have fewer than `free_wanted` free grasps,
            `fresh_rounds` rounds in all.
        kept_per_object: free grasps kept of an object.
        judged: free grasps tried in the heap, a gripper and scene.
        judged_library: more of them, from the library, which hold more often. Free grasps that
            are not tried are not kept.
        perturbed: perturbed grasps tried in the heap, a gripper and scene.
        colliding: colliding grasps kept as negatives, a gripper and scene.
        sleep: let objects at rest sleep in trials, which halves their time.
        candidates: how fresh candidates are drawn.
    """

    grippers: tuple[str, ...]
    objects: tuple[int, int] = (1, 12)
    bin_share: float = 0.75
    bin_inner: tuple[float, float, float] = (0.40, 0.30, 0.15)
    bin_spread: float = 0.2
    bin_wall: tuple[float, float] = (0.003, 0.015)
    bin_tilt: float = np.deg2rad(6.0)
    bin_tilted: float = 0.5
    table_region: tuple[float, float, float] = (0.50, 0.40, 0.25)
    obstacle_share: float = 0.3
    grippers_per_scene: int | None = None
    hands_in_bins: float = 1.0
    hands_on_tables: float = 1.0
    procedural_grippers: int = 0
    procedural_per_scene: int = 1
    camera_height: float = 0.85
    camera_shift: float = 0.03
    camera_tilt: float = np.deg2rad(4.0)
    image: tuple[int, int] = (640, 480)
    views: ViewShares = field(default_factory=ViewShares)
    noise: DepthNoise | None = field(default_factory=DepthNoise)
    surface: SceneSettings = field(default_factory=SceneSettings)
    tilt_bin: float = np.deg2rad(60.0)
    tilt_table: float = np.deg2rad(95.0)
    approach: float = 0.10
    tested_per_object: int = 80
    fresh: int = 60
    fresh_rounds: int = 6
    free_wanted: int = 6
    fresh_tilt: float = np.deg2rad(50.0)
    kept_per_object: int = 24
    judged: int = 8
    judged_library: int = 4
    perturbed: int = 2
    colliding: int = 32
    sleep: bool = True
    candidates: CandidateSettings = field(default_factory=CandidateSettings)


@dataclass(frozen=True)
class Layout:
    """A settled scene without labels.

    Attributes:
        object_names: n names in the object set, obstacles last.
        obstacle: (n,) bool.
        object_poses: (n, 7) float32 `world_from_object`, exactly what records and recipes keep.
        bin: None for a table.
        region: what the camera's cloud is cropped to.
    """

    object_names: tuple[str, ...]
    obstacle: NDArray[np.bool_]
    object_poses: NDArray[np.float32]
    bin: Bin | None
    region: OrientedBox

    @property
    def matrices(self) -> NDArray[np.float64]:
        """(n, 4, 4) `world_from_object`."""
        return np.asarray(matrix_from_pose7(self.object_poses.astype(np.float64)))


def stream(seed: int, which: int, *more: int) -> np.random.Generator:
    """The generator of one stream of a scene."""
    return np.random.default_rng([which, seed, *more])


def region_of(bin: Bin | None, config: SceneConfig) -> OrientedBox:
    """The inner box of the bin, or the table region."""
    if bin is not None:
        return bin.region()
    centre = np.eye(4)
    centre[2, 3] = 0.5 * config.table_region[2]
    return OrientedBox(centre, np.array(config.table_region))


def _draw_bin(inner: NDArray[np.float64], config: SceneConfig, rng: np.random.Generator) -> Bin:
    tilt, around = config.bin_tilt * rng.random(), rng.uniform(-np.pi, np.pi)
    upright = rng.random() >= config.bin_tilted
    red, green, blue = np.round(rng.random(3), 3)
    return Bin(
        (float(inner[0]), float(inner[1]), float(inner[2])),
        wall=float(np.round(rng.uniform(*config.bin_wall), 4)),
        tilt=(0.0, 0.0)
        if upright
        else (float(tilt * np.cos(around)), float(tilt * np.sin(around))),
        colour=(float(red), float(green), float(blue)),
    )


def draw_layout(
    seed: int, config: SceneConfig, objects: ObjectSet, *, attempts: int = 3
) -> Layout:
    """Draws and settles the scene of a seed.

    Objects that roll out of the bin are left out. A heap that does not come to rest is drawn again
    with two objects less, since a full bin is the usual reason.

    Raises:
        SimulationError: no heap came to rest.
    """
    rng = stream(seed, LAYOUT)
    low, high = config.objects
    count = int(rng.integers(low, high + 1))
    in_bin = bool(rng.random() < config.bin_share)
    spread = rng.uniform(1 - config.bin_spread, 1 + config.bin_spread, size=3)
    inner = np.round(np.array(config.bin_inner) * spread, 4)
    bin = _draw_bin(inner, config, stream(seed, LAYOUT, 1)) if in_bin else None
    obstacles = int(rng.integers(1, 4)) if rng.random() < config.obstacle_share else 0
    shares = balanced_shares(objects)
    for attempt in range(attempts):
        graspable = max(1, min(count - 2 * attempt, len(objects)))
        chosen = rng.choice(len(objects), size=graspable, replace=False, p=shares)
        names = [objects.names[index] for index in chosen]
        names += [obstacle_name(int(rng.integers(1_000_000))) for _ in range(obstacles)]
        scene = settle([objects[name] for name in names], bin=bin, rng=rng)
        kept = np.array(scene.kept, np.int64)
        if scene.ok and (kept < graspable).any():
            return Layout(
                tuple(names[index] for index in kept),
                kept >= graspable,
                np.asarray(pose7_from_matrix(scene.object_poses), np.float32),
                bin,
                region_of(bin, config),
            )
    raise SimulationError(
        f"the scene of seed {seed} did not come to rest in {attempts} attempts; expected a "
        "settled heap. Use another seed or fewer objects."
    )
