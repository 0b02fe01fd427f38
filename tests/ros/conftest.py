"""One grasp_server process for all tests that only call it: its start is what costs time."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from cell_processes import in_executor
from server_client import MOUNTED, MOUNTING, Client, running_server


@pytest.fixture(scope="session")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple]:
    """Return a client and the processes of a server with the test double."""
    folder = tmp_path_factory.mktemp("grasp_server")
    parameters = {"cloud_timeout": 0.7, "model": "quick", "device": "cpu", MOUNTED: MOUNTING}
    with running_server(1, folder, **parameters) as (client, processes):
        yield client, processes


@pytest.fixture
def server(running: tuple) -> Iterator[Client]:
    """Return a client of that server, which is brought into its first state."""
    client, processes = running
    assert not client.parameters(
        model="quick",
        planning_frame="",
        extrinsics=[0.0] * 7,
        gravity=[0.0] * 3,
        region__size=[0.0] * 3,
        pose_reference="gripper",
        auto_synthesize="off",
        points_subscription="on_demand",
        input="points",
        sync_tolerance=0.0,
        swap_cost=0.0,
        tool_changer="",
    )
    before = set(client.node.subscriptions)
    assert client.set_gripper("robotiq_2f85").success
    yield client
    for subscription in set(client.node.subscriptions) - before:
        in_executor(client.node, lambda s=subscription: client.node.destroy_subscription(s))
    assert processes.running["grasp_server"].poll() is None, "the node died"
