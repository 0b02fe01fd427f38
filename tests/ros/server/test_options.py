"""The options of a request with the shipped model, through the installed executable."""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from bin_clouds import ABOVE, block, seen, table
from megrasp_msgs.msg import ErrorCode
from sensor_msgs.msg import PointCloud2, PointField
from server_client import Client, running_server, stamped_cloud

pytestmark = pytest.mark.slow

LOW = (block((-0.13, -0.02, 0.0), (-0.07, 0.02, 0.04)), 1)
HIGH = (block((0.07, -0.02, 0.0), (0.13, 0.02, 0.10)), 2)
LAYER = 0.021
"""Grasps whose heights differ by less (m) are equally high."""


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    """Return a client of a server with the default model."""
    start = {"device": "cpu", "threads": 1, "sensor_origin": ABOVE.tolist()}
    folder = tmp_path_factory.mktemp("options")
    with running_server(2, folder, double=False, **start) as (client, _):
        yield client


def labelled(client: Client) -> PointCloud2:
    """Return a cloud of a table with two boxes, each with its label."""
    points = seen([table(0.3), LOW[0], HIGH[0]], noise=0.0005).points
    cloud = stamped_cloud(client.node, points)
    packed = np.zeros(len(points), [("xyz", "<f4", 3), ("label", "<u4")])
    packed["xyz"] = points
    stands_out = points[:, 2] > 0.01
    packed["label"][stands_out] = np.where(points[stands_out, 0] < 0, LOW[1], HIGH[1])
    cloud.fields = [
        *cloud.fields,
        PointField(name="label", offset=12, datatype=PointField.UINT32, count=1),
    ]
    cloud.point_step, cloud.row_step = 16, 16 * len(points)
    cloud.data = array("B", packed.tobytes())
    return cloud


def test_options_decide_what_is_drawn_returned_and_first(client: Client) -> None:
    cloud = labelled(client)

    def ask(**fields: Any) -> Any:
        return client.synthesize(**{"num_grasps": 10, "cloud": cloud, "seed": 5, **fields})

    def drawn(answer: Any) -> int:
        return sum(each.count for each in answer.rejected) + len(answer.grasps.grasps)

    default = ask()
    assert default.success, default.error_msg
    grasps = default.grasps.grasps
    scores = [grasp.score for grasp in grasps]
    # As many once more while no grasp is good.
    assert drawn(default) in (100, 200, 300, 400)
    assert scores == sorted(scores, reverse=True)
    # The boxes stand apart, so that which one is grasped is no matter of millimetres.
    for grasp in grasps:
        assert grasp.object == (LOW if grasp.tcp.position.x < 0 else HIGH)[1]

    # As many are drawn as are asked for.
    assert drawn(ask(mode="fast")) == 10
    assert drawn(ask(mode="default")) == drawn(default)

    limit = float(np.float32(scores[len(scores) // 2]))
    better = ask(min_score=limit)
    assert better.success and all(g.score >= limit for g in better.grasps.grasps)
    nothing = ask(min_score=1.0)
    assert nothing.error_code == ErrorCode.NO_GRASP_FOUND
    assert any("none of them with a score of 1" in note for note in nothing.notes)

    for label in (LOW[1], HIGH[1]):
        of_one = ask(target=label)
        assert of_one.success, of_one.error_msg
        assert {grasp.object for grasp in of_one.grasps.grasps} == {label}
    unknown = ask(target=9)
    assert unknown.error_code == ErrorCode.INVALID_REQUEST
    assert "target 9" in unknown.error_msg and "1, 2" in unknown.error_msg

    high = [grasp.tcp.position.z for grasp in ask(prefer="high").grasps.grasps]
    assert high[0] >= max(high) - LAYER
    # The same by the parameter, which a request without a wish of its own follows.
    assert not client.parameters(prefer="clear")
    clear = [grasp.clearance for grasp in ask().grasps.grasps]
    assert clear == sorted(clear, reverse=True)
    high = [grasp.tcp.position.z for grasp in ask(prefer="high").grasps.grasps]
    assert high[0] >= max(high) - LAYER
    assert not client.parameters(prefer="score", min_score=1.0)
    assert ask().error_code == ErrorCode.NO_GRASP_FOUND
    assert ask(min_score=limit).success
    assert not client.parameters(min_score=0.0)
