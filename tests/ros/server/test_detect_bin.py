"""detect_bin through a real grasp_server process."""

from __future__ import annotations

import math

import numpy as np
import pytest
from bin_clouds import ABOVE, bin_meshes, contents, pose, seen, table
from cell_processes import in_executor, result
from geometry_msgs.msg import Vector3
from megrasp_msgs.msg import ErrorCode
from megrasp_msgs.srv import DetectBin
from server_client import POINTS, Client, camera, cloud_of, still_serves

from megrasp_ros.conversions import matrix_from_pose

MESHES, INSIDE = bin_meshes(pose(0.02, -0.01, yaw=20.0))
EMPTY = seen([*MESHES, table()]).points
HALF = seen([*MESHES, table(), *contents(INSIDE, 0.07)]).points


def detect(client: Client, **fields) -> DetectBin.Response:
    service = client.node.create_client(DetectBin, "detect_bin")
    assert service.wait_for_service(60.0)
    request = DetectBin.Request(**fields)
    answer = result(in_executor(client.node, lambda: service.call_async(request)))
    in_executor(client.node, lambda: client.node.destroy_client(service))
    return answer


@pytest.fixture
def above(server: Client):
    """Return a client of a server whose sensor is over the bin."""
    assert not server.parameters(sensor_origin=ABOVE.tolist())
    yield server
    assert not server.parameters(sensor_origin=[0.0] * 3, planning_frame="", extrinsics=[0.0] * 7)
    assert still_serves(server)


def test_a_bin_is_found_with_its_fill(above: Client) -> None:
    empty, half = (detect(above, cloud=cloud_of(above, points)) for points in (EMPTY, HALF))
    for answer in (empty, half):
        assert (answer.success, answer.error_code, answer.error_msg) == (True, 0, "")
        box = matrix_from_pose(answer.bin.pose, "bin")
        np.testing.assert_allclose(box[:3, 3], INSIDE.centre, atol=0.01)
        size = [answer.bin.size.x, answer.bin.size.y, answer.bin.size.z]
        np.testing.assert_allclose(size, INSIDE.size, atol=0.012)
        assert answer.rows * answer.columns == len(answer.cells) > 20
        assert answer.columns > answer.rows
        told = [cell for cell in answer.cells if not math.isnan(cell)]
        assert told and all(0.0 <= cell <= 1.0 for cell in told)
    assert empty.fill_level < 0.05
    assert empty.fill_level + 0.1 < half.fill_level < 0.7


def test_the_bin_of_the_topic_is_told_in_the_planning_frame(above: Client) -> None:
    lifted = [0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0]
    assert not above.parameters(planning_frame="base", extrinsics=lifted)
    with camera(above, EMPTY, rate=5.0):
        answer = detect(above, size=Vector3(x=0.4, y=0.3, z=0.15))
    assert answer.success, answer.error_msg
    box = matrix_from_pose(answer.bin.pose, "bin")
    np.testing.assert_allclose(box[:3, 3], INSIDE.centre + lifted[:3], atol=0.01)
    # What was found is what a request takes as its region.
    region = answer.bin
    cloud = cloud_of(above, HALF)
    synthesized = above.synthesize(num_grasps=2, cloud=cloud, region=region)
    assert synthesized.success, synthesized.error_msg


@pytest.mark.parametrize(
    ("points", "size", "code", "words"),
    [
        (POINTS, (0.0, 0.0, 0.0), ErrorCode.EMPTY_REGION, "bin"),
        (EMPTY, (1.2, 0.9, 0.5), ErrorCode.EMPTY_REGION, "bin"),
        (EMPTY, (-0.4, 0.3, 0.15), ErrorCode.INVALID_REQUEST, "size"),
        (EMPTY, (math.nan, 0.3, 0.15), ErrorCode.INVALID_REQUEST, "size"),
        (1000 * EMPTY, (0.0, 0.0, 0.0), ErrorCode.BAD_CLOUD, "millimetres"),
        (np.full((5, 3), np.nan), (0.0, 0.0, 0.0), ErrorCode.BAD_CLOUD, "NaN"),
    ],
)
def test_what_is_no_bin_is_answered(
    above: Client, points: np.ndarray, size: tuple[float, ...], code: int, words: str
) -> None:
    request = Vector3(x=size[0], y=size[1], z=size[2])
    answer = detect(above, cloud=cloud_of(above, points), size=request)
    assert not answer.success
    assert answer.error_code == code, answer.error_msg
    assert words in answer.error_msg


def test_without_a_cloud_it_is_error_100_and_busy_while_something_runs(server: Client) -> None:
    answer = detect(server)
    assert answer.error_code == ErrorCode.NO_CLOUD
    assert "/points" in answer.error_msg
    assert not server.parameters(model="slow")
    handle = server.goal(num_grasps=1, cloud=cloud_of(server))
    busy = detect(server, cloud=cloud_of(server, EMPTY))
    assert busy.error_code == ErrorCode.BUSY
    finished = server.outcome(handle)
    server.cancel(handle)
    assert result(finished).result.error_code == ErrorCode.CANCELLED
    assert not server.parameters(model="quick")
