"""What lies between the fingers, on boxes of known width."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from megrasp_core.grippers import list_grippers, load_gripper
from megrasp_core.ranking import DistanceField, contact_surface, gripper_probe, measure_contacts


@pytest.fixture(scope="module")
def probe():
    return gripper_probe(load_gripper("robotiq_2f85"))


def down_at(probe, tcp, yaw: float = 0.0) -> np.ndarray:
    c, s = np.cos(yaw), np.sin(yaw)
    pose = np.eye(4)
    pose[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]) @ np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = np.asarray(tcp) - pose[:3, :3] @ probe.tcp
    return pose[None]


def surface_of(points: np.ndarray):
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    return contact_surface(points, points[::5], normals[::5], points[:, 2], points[::5, 2])


@pytest.mark.parametrize("width", [0.008, 0.02, 0.04, 0.07])
@pytest.mark.parametrize("shift", [0.0, 0.004])
def test_width_of_a_box_within_3_mm(seen, probe, width, shift):
    box = ((-width / 2 + shift, -0.03, 0.0), (width / 2 + shift, 0.03, 0.05))
    found = measure_contacts(surface_of(seen([box])), probe.volume, down_at(probe, (0, 0, 0.035)))
    assert found.width[0] == pytest.approx(width, abs=0.003)
    assert found.offset[0] == pytest.approx(shift, abs=0.002)
    assert found.count[0] > 0


def test_noise_does_not_widen_the_box(seen, probe):
    points = seen([((-0.02, -0.03, 0.0), (0.02, 0.03, 0.05))])
    noisy = points + np.random.default_rng(0).normal(0, 0.0012, points.shape)
    found = measure_contacts(surface_of(noisy), probe.volume, down_at(probe, (0, 0, 0.035)))
    assert found.width[0] == pytest.approx(0.04, abs=0.003)


def test_nothing_between_the_fingers_is_empty(seen, probe):
    surface = surface_of(seen([((0.1, 0.1, 0.0), (0.14, 0.14, 0.05))]))
    found = measure_contacts(surface, probe.volume, down_at(probe, (0, 0, 0.03)))
    assert found.count[0] == 0 and np.isnan(found.width[0]) and found.quality[0] == 0


def test_the_floor_is_no_material(seen, probe):
    found = measure_contacts(surface_of(seen([])), probe.volume, down_at(probe, (0, 0, 0.002)))
    assert found.count[0] == 0


def test_engagement_is_how_far_the_fingers_reach_past_the_top(seen, probe):
    surface = surface_of(seen([((-0.02, -0.03, 0.0), (0.02, 0.03, 0.05))]))
    heights = (0.05, 0.04, 0.02)
    poses = np.concatenate([down_at(probe, (0, 0, z)) for z in heights])
    found = measure_contacts(surface, probe.volume, poses)
    below = probe.volume.tip - probe.tcp[2]
    expected = [0.05 - z + below for z in heights]
    np.testing.assert_allclose(found.engagement, expected, atol=0.0015)
    assert found.quality[0] < found.quality[2]


def test_sides_that_face_the_fingers_are_better_than_slanted_ones(probe):
    def roof(angle: float) -> tuple[np.ndarray, np.ndarray]:
        """Two ridges at x = +-2 cm whose normals are turned by `angle` away from X."""
        y, z = np.meshgrid(np.linspace(-0.01, 0.01, 21), np.linspace(0.02, 0.05, 16))
        parts, normals = [], []
        for side in (-1.0, 1.0):
            parts.append(np.stack([np.full(y.size, 0.02 * side), y.ravel(), z.ravel()], axis=1))
            normal = side * np.array([np.cos(angle), np.sin(angle), 0.0])
            normals.append(np.tile(normal, (y.size, 1)))
        return np.concatenate(parts), np.concatenate(normals)

    quality = []
    for angle in (0.0, 0.5, 1.0):
        points, normals = roof(angle)
        surface = contact_surface(points, points, normals)
        found = measure_contacts(surface, probe.volume, down_at(probe, (0, 0, 0.035)))
        assert found.alignment[0] == pytest.approx(max(np.cos(angle), 0.4), abs=0.02)
        quality.append(found.quality[0])
    assert quality[0] > quality[1] > quality[2]


# The Google gripper's fingers stand apart like a V: wider at their tips than at the TCP.
WIDER = {"google_gripper": 0.032, "google_gripper_cad": 0.032}


@pytest.mark.slow
@pytest.mark.parametrize("name", list_grippers())
def test_the_closing_volume_of_every_gripper_opens_to_its_width(name):
    gripper = load_gripper(name)
    probe = gripper_probe(gripper)
    assert len(probe.points) > 200 and len(probe.approach_points) < len(probe.points)
    if gripper.description.max_width is None:
        return
    assert probe.volume is not None
    opening = probe.volume.high[0] - probe.volume.low[0]
    width = gripper.description.max_width
    assert width - 0.006 < opening < width + WIDER.get(name, 0.007)
    assert abs(probe.volume.centre) < 0.004
    assert probe.volume.low[2] < gripper.tcp[2] < probe.volume.high[2]


def test_the_distance_field_agrees_with_exact_distances():
    rng = np.random.default_rng(0)
    sphere = rng.normal(size=(40000, 3))
    sphere *= 0.03 / np.linalg.norm(sphere, axis=1, keepdims=True)
    field = DistanceField.around(sphere, 0.02)
    direction = rng.normal(size=(200, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    radius = rng.uniform(0.032, 0.048, 200)
    for unit, r in zip(direction, radius):
        pose = np.eye(4)
        pose[:3, :3] = Rotation.random(random_state=rng).as_matrix()
        pose[:3, 3] = rng.normal(size=3)
        point = (pose[:3, :3] @ (unit * r) + pose[:3, 3]).astype(np.float32)[:, None]
        assert field.least(point, pose[None])[0] == pytest.approx(r - 0.03, abs=0.0012)
    far = np.array([[0.3], [0.0], [0.0]], dtype=np.float32)
    nothing = np.zeros((3, 0), dtype=np.float32)
    here = np.eye(4)[None]
    assert field.least(far, here) == field.least(nothing, here) == field.limit
    assert len(field.least(far, here[:0])) == 0
