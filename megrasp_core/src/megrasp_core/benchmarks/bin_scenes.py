"""Bins and tables to find bins in, made from a seed: MuJoCo heaps seen by noisy depth cameras."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from megrasp_core.errors import SimulationError
from megrasp_core.lie import matrix_from_pose7
from megrasp_core.meshes import Mesh, RayScene, joined
from megrasp_core.objects import (
    ConvexPiece,
    ObjectModel,
    ObjectSeeds,
    ObjectSet,
    box,
    procedural_names,
)
from megrasp_core.pointcloud import Cloud, OrientedBox
from megrasp_core.scenes import SceneConfig, draw_layout, scene_cameras
from megrasp_core.simulation import (
    Bin,
    Camera,
    SettledScene,
    TopDownCamera,
    build_world,
    look_at,
    noise_named,
    observe,
    settle,
)

FloatArray = NDArray[np.float64]
DOWN = np.array([0.0, 0.0, -1.0])
OBJECTS = 60
OBJECT_SEED = ObjectSeeds.BIN_FINDER.start
NOISES = ("default", "default", "default", "structured_light", "stereo")
"""Cameras, each as often as it stands here."""
WALL_SEEN = 0.5
ATTEMPTS = 20
GRID = 0.005
"""Of the rays from above that measure the true fill (m)."""


@dataclass(frozen=True, eq=False)
class BinScene:
    """A cloud and what is true of it.

    Attributes:
        cloud: with the place of the sensor as viewpoint, (N, 3) in m.
        gravity: (3,) unit, in the frame of the cloud.
        boxes: insides of the bins in the scene, upper faces at the rims, first the one that the
            camera looks at; none in a table scene.
        fill: mean height of the contents of the first over its depth, 0..1; NaN on a table.
        empty: whether nothing lies in the first.
        features: what is special, for tables of results.
    """

    cloud: Cloud
    gravity: FloatArray
    boxes: tuple[OrientedBox, ...]
    fill: float
    empty: bool
    features: tuple[str, ...]


def bin_scene(seed: int) -> tuple[BinScene, int]:
    """A bin of any size, tilt and fill, from above or obliquely, perhaps with a wall or the floor
    unseen, with a ledge, drafted walls, a second bin or boxes beside it; and how many draws were
    left out before because fewer than three of its walls were seen.
    """
    for attempt in range(ATTEMPTS):
        scene = _drawn_bin(np.random.default_rng([seed, 1, attempt]))
        shares = np.sort(_walls_seen(scene.cloud.points, scene.boxes[0]))
        if shares[1] >= WALL_SEEN:
            return scene, attempt
    raise SimulationError(
        f"the bin of seed {seed} is not seen in {ATTEMPTS} draws; expected three walls that are. "
        "Use another seed."
    )


def _walls_seen(points: FloatArray, opening: OrientedBox) -> FloatArray:
    """(4,) share of the length of each wall on which its rim or its inside was seen."""
    local = opening.local(points)
    half = opening.size / 2
    z = local[:, 2] - half[2]
    seen = np.zeros(4)
    for side in range(4):
        axis, sign = side // 2, 1 if side % 2 else -1
        out = sign * local[:, axis] - half[axis]
        along = local[:, 1 - axis] + half[1 - axis]
        rim = (np.abs(z) < 0.006) & (out > -0.003) & (out < 0.012)
        inside = (z < -0.012) & (local[:, 2] > 0.012 - half[2]) & (np.abs(out) < 0.003)
        pieces = int(2 * half[1 - axis] / 0.01)
        on = (rim | inside) & (along > 0) & (along < pieces * 0.01)
        count = np.bincount((along[on] / 0.01).astype(np.intp), minlength=pieces)
        seen[side] = float((count >= 2).mean())
    return seen


def _drawn_bin(rng: np.random.Generator) -> BinScene:
    features: list[str] = []
    fill = str(rng.choice(["empty", "few", "half", "full", "overfull"]))
    features.append(fill)
    bin, scene = _settled_bin(fill, rng)
    if any(bin.tilt):
        features.append("tilted")
    placed: list[tuple[ObjectModel, FloatArray]] = list(zip(scene.objects, scene.object_poses))
    opening = bin.region()
    walls: Bin | None = bin
    if rng.random() < 0.25:
        features.append("drafted")
        draft = rng.uniform(np.deg2rad(1.0), np.deg2rad(5.0))
        spread = bin.inner[2] * float(np.tan(draft))
        shape = _drafted_walls(bin, spread)
        placed.append((_scenery(shape), bin.world_from_bin))
        grown = opening.size + np.array([2 * spread, 2 * spread, 0.0])
        opening = OrientedBox(opening.world_from_box, grown)
        walls = None
    elif rng.random() < 0.35:
        features.append("ledge")
        placed.append((_scenery(_ledge(bin, rng)), bin.world_from_bin))
    boxes = [opening]
    beside = rng.random()
    if beside < 0.2 and not any(bin.tilt):
        features.append("second bin")
        mesh, pose, other = _second_bin(bin, opening, rng)
        placed.append((_scenery(mesh), pose))
        boxes.append(other)
    elif beside < 0.45:
        features.append("boxes beside")
        placed += _boxes_beside(opening, rng)
    oblique = bool(rng.random() < 0.4)
    features.append("oblique" if oblique else "from above")
    camera = _oblique(opening, rng) if oblique else _from_above(opening, rng)
    noise = str(rng.choice(NOISES))
    features.append(noise)
    cloud = _seen(placed, walls, camera, noise, rng)
    local = opening.local(cloud.points)
    half = opening.size / 2
    hidden = rng.random()
    if hidden < 0.15 and fill != "overfull":
        features.append("wall unseen")
        cloud = cloud.select(~_in_wall(local, half, int(rng.integers(4))))
    elif hidden < 0.30:
        features.append("floor unseen")
        inside = (np.abs(local[:, :2]) < half[:2] + 0.002).all(axis=1)
        cloud = cloud.select(~(inside & (local[:, 2] < 0.012 - half[2])))
    true_fill = _true_fill(placed[: len(scene.objects)], opening)
    return _in_some_frame(cloud, boxes, true_fill, not scene.objects, tuple(features), camera, rng)


def table_scene(seed: int) -> BinScene:
    """A heap of one to twelve objects and obstacles on a table, seen as in training."""
    rng = np.random.default_rng([seed, 2])
    config = SceneConfig(grippers=(), bin_share=0.0, obstacle_share=0.6)
    objects = ObjectSet(procedural_names(OBJECTS, OBJECT_SEED))
    layout = draw_layout(seed, config, objects)
    models = [objects[name] for name in layout.object_names]
    view = str(rng.choice(["from above", "oblique", "ten views"]))
    if view == "ten views":
        config = replace(config, views=replace(config.views, dense=1.0))
    elif view == "oblique":
        config = replace(config, views=replace(config.views, dense=0.0, sparse=1.0))
    else:
        config = replace(config, views=replace(config.views, dense=0.0))
    cameras = scene_cameras(seed, config, in_bin=False)
    noise = str(rng.choice(NOISES))
    poses = np.asarray(matrix_from_pose7(layout.object_poses.astype(np.float64)))
    world = build_world(models, object_poses=poses)
    cloud = observe(world, cameras if len(cameras) > 1 else cameras[0], noise_named(noise), rng)
    features = [view, noise]
    if rng.random() < 0.3:
        # A cutting board, a tray without a rim, a table that ends.
        features.append("table ends")
        edge = rng.uniform(0.10, 0.20, 2)
        cloud = cloud.select((np.abs(cloud.points[:, :2]) < edge).all(axis=1))
    return _in_some_frame(cloud, [], float("nan"), False, tuple(features), cameras[0], rng)


def _settled_bin(fill: str, rng: np.random.Generator) -> tuple[Bin, SettledScene]:
    inner = np.round(rng.uniform([0.24, 0.18, 0.06], [0.60, 0.40, 0.24]), 3)
    if fill in ("full", "overfull"):
        # Shallow and small ones, or no number of objects fills them.
        inner = np.round(rng.uniform([0.22, 0.17, 0.05], [0.36, 0.26, 0.09]), 3)
    tilt, around = rng.uniform(0, np.deg2rad(10.0)), rng.uniform(-np.pi, np.pi)
    bin = Bin(
        (float(inner[0]), float(inner[1]), float(inner[2])),
        wall=float(np.round(rng.uniform(0.003, 0.015), 4)),
        tilt=(float(tilt * np.cos(around)), float(tilt * np.sin(around)))
        if rng.random() < 0.5
        else (0.0, 0.0),
    )
    low, high = {
        "empty": (0, 0), "few": (1, 5), "half": (8, 25), "full": (18, 26), "overfull": (26, 40)
    }[fill]  # fmt: skip
    count = int(rng.integers(low, high + 1))
    if count == 0:
        return bin, SettledScene((), np.zeros((0, 4, 4)), (), bin, True, 0.0, 0.0, 0.0, 0)
    pool = ObjectSet(procedural_names(OBJECTS, OBJECT_SEED))
    chosen = rng.choice(len(pool), size=count, replace=False)
    # At rest or not is for grasps; what a camera sees of a heap is the same.
    return bin, settle([pool[pool.names[index]] for index in chosen], bin=bin, rng=rng)


def _scenery(mesh: Mesh) -> ObjectModel:
    """A model that is seen and never simulated."""
    corners = box(np.ptp(mesh.vertices, axis=0).tolist())
    piece = ConvexPiece(corners.vertices, corners.faces)
    return ObjectModel(
        "scenery", mesh.vertices, mesh.faces.astype(np.int32), (piece,), 1.0, np.eye(3) * 0.01
    )


def _beam(low: FloatArray, high: FloatArray) -> Mesh:
    solid = box((high - low).tolist())
    return Mesh(solid.vertices + (low + high) / 2, solid.faces)


def _frame(inner: FloatArray, width: float, low: float, high: float) -> list[Mesh]:
    """Four beams around a rectangle with edges `inner` (2,), from one height to another (m)."""
    x, y = inner / 2
    return [
        beam
        for sign in (-1, 1)
        for beam in (
            _beam(
                np.array([min(sign * x, sign * (x + width)), -y - width, low]),
                np.array([max(sign * x, sign * (x + width)), y + width, high]),
            ),
            _beam(
                np.array([-x, min(sign * y, sign * (y + width)), low]),
                np.array([x, max(sign * y, sign * (y + width)), high]),
            ),
        )
    ]


def _ledge(bin: Bin, rng: np.random.Generator) -> Mesh:
    """A collar outside the rim, flush with it or a little lower."""
    top = bin.inner[2] - (0.0 if rng.random() < 0.6 else rng.uniform(0.004, 0.02))
    inner = np.array(bin.inner[:2]) + 2 * bin.wall
    return joined(_frame(inner, rng.uniform(0.008, 0.025), top - 0.006, top))


def _drafted_walls(bin: Bin, spread: float) -> Mesh:
    """Walls leaning outwards by `spread` (m) from floor to rim, and the floor of a tilted bin."""
    x, y, z = bin.inner[0] / 2, bin.inner[1] / 2, bin.inner[2]
    turns = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]], dtype=np.float64)

    def ring(grow: float, height: float) -> FloatArray:
        return np.column_stack([turns * [x + grow, y + grow], np.full(4, height)])

    rings = [
        ring(bin.wall, -bin.wall if any(bin.tilt) else 0.0),
        ring(bin.wall + spread, z), ring(spread, z), ring(0.0, 0.0),
    ]  # fmt: skip
    faces = []
    for lower in range(3):
        for k in range(4):
            a, b = 4 * lower + k, 4 * lower + (k + 1) % 4
            faces += [[a, b, b + 4], [a, b + 4, a + 4]]
    faces += [[12, 13, 14], [12, 14, 15]] if any(bin.tilt) else []
    return Mesh(np.concatenate(rings), np.array(faces))


def _second_bin(
    bin: Bin, opening: OrientedBox, rng: np.random.Generator
) -> tuple[Mesh, FloatArray, OrientedBox]:
    axis, sign = int(rng.integers(2)), int(rng.choice([-1, 1]))
    pose = np.eye(4)
    pose[axis, 3] = sign * (
        (opening.size[axis] + bin.inner[axis]) / 2 + 2 * bin.wall + rng.uniform(0.05, 0.08)
    )
    pose[1 - axis, 3] = rng.uniform(-0.05, 0.05)
    inner = np.array(bin.inner)
    middle = np.eye(4)
    middle[2, 3] = inner[2] / 2
    mesh = joined(_frame(inner[:2], bin.wall, 0.0, inner[2]))
    return mesh, pose, OrientedBox(pose @ middle, inner)


def _boxes_beside(
    opening: OrientedBox, rng: np.random.Generator
) -> list[tuple[ObjectModel, FloatArray]]:
    found = []
    reach = np.linalg.norm(opening.size[:2]) / 2
    for _ in range(int(rng.integers(1, 5))):
        size = rng.uniform([0.06, 0.06, 0.03], [0.20, 0.16, 0.20])
        turn = rng.uniform(-np.pi, np.pi)
        away = reach + 0.05 + np.linalg.norm(size[:2]) / 2 + rng.uniform(0.0, 0.06)
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_euler("z", rng.uniform(0, np.pi)).as_matrix()
        pose[:3, 3] = [away * np.cos(turn), away * np.sin(turn), size[2] / 2]
        found.append((_scenery(_beam(-size / 2, size / 2)), pose))
    return found


def _from_above(opening: OrientedBox, rng: np.random.Generator) -> Camera:
    """So high that the bin and a margin are in the picture, a little moved and tilted."""
    rim = float(opening.corners()[:, 2].max())
    width, across = opening.size[:2] + 0.16
    height = rim + max(width / 0.68, across / 0.51, 0.55)
    nominal = TopDownCamera(height)
    pose = np.array(nominal.world_from_camera, np.float64)
    pose[:3, 3] += rng.uniform(-0.03, 0.03, 3)
    tilt = Rotation.from_rotvec(rng.uniform(-0.07, 0.07, 3))
    pose[:3, :3] = pose[:3, :3] @ tilt.as_matrix()
    return replace(nominal, world_from_camera=pose, far=3.0)


def _oblique(opening: OrientedBox, rng: np.random.Generator) -> Camera:
    lift, turn = rng.uniform(0.75, 1.2), rng.uniform(-np.pi, np.pi)
    distance = (float(np.linalg.norm(opening.size[:2])) / 2 + 0.09) / float(np.tan(0.325))
    away = np.array([np.cos(lift) * np.cos(turn), np.cos(lift) * np.sin(turn), np.sin(lift)])
    target = opening.centre + rng.uniform(-0.02, 0.02, 3)
    pose = look_at(target + max(distance, 0.5) * away, target)
    return Camera(pose, 640, 480, 0.65, far=3.0)


def _seen(
    placed: list[tuple[ObjectModel, FloatArray]],
    walls: Bin | None,
    camera: Camera,
    noise: str,
    rng: np.random.Generator,
) -> Cloud:
    world = build_world(
        [model for model, _ in placed],
        bin=walls,
        object_poses=np.array([pose for _, pose in placed]).reshape(-1, 4, 4),
    )
    return observe(world, camera, noise_named(noise), rng)


def _in_wall(local: FloatArray, half: FloatArray, side: int) -> NDArray[np.bool_]:
    """Points (N,) of a wall, its ledge and its two corners, in the frame of the opening."""
    axis, sign = side // 2, 1 if side % 2 else -1
    beyond = sign * local[:, axis] - half[axis]
    lowest = 0.004 - half[2]
    return (beyond > -0.003) & (beyond < 0.045) & (local[:, 2] > lowest)


def _true_fill(placed: list[tuple[ObjectModel, FloatArray]], opening: OrientedBox) -> float:
    if not placed:
        return 0.0
    meshes = [model.mesh.moved(pose) for model, pose in placed]
    x, y, z = opening.size
    u, v = (np.arange(-edge / 2 + GRID, edge / 2, GRID) for edge in (x, y))
    grid = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1).reshape(-1, 2)
    start = np.column_stack([grid, np.full(len(grid), z / 2 + 0.5)])
    rays = np.concatenate(
        [
            start @ opening.rotation.T + opening.centre,
            np.broadcast_to(-opening.rotation[:, 2], start.shape),
        ],
        axis=1,
    )
    distance = RayScene(meshes).cast(rays).distance
    height = np.where(np.isfinite(distance), z + 0.5 - distance, 0.0)
    return float(np.clip(height / z, 0, 1).mean())


def _in_some_frame(
    cloud: Cloud,
    boxes: list[OrientedBox],
    fill: float,
    empty: bool,
    features: tuple[str, ...],
    camera: Camera,
    rng: np.random.Generator,
) -> BinScene:
    """The scene in the camera's optical frame, or in a world somewhere else."""
    if rng.random() < 0.5:
        motion = np.linalg.inv(camera.world_from_camera)
    else:
        motion = np.eye(4)
        motion[:3, :3] = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi)).as_matrix()
        motion[:3, 3] = rng.uniform(-2.0, 2.0, 3)
    return BinScene(
        cloud.transformed(motion),
        np.asarray(motion[:3, :3] @ DOWN, np.float64),
        tuple(box.transformed(motion) for box in boxes),
        fill,
        empty,
        features,
    )
