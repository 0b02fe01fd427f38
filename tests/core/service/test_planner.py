"""The resident planner over HTTP: answers, refusals, one request at a time."""

from __future__ import annotations

import http.client
import io
import json
import os
import signal
import subprocess
import sys
import threading
import urllib.parse
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from megrasp_core.errors import InvalidRequestError
from megrasp_core.network import PRESETS, GraspModel, save_model
from megrasp_core.service import PlannerClient, PlannerError, PlannerServer
from megrasp_core.synthesizer import GraspSynthesizer

SENSOR = [0.0, 0.0, 0.85]


@pytest.fixture(scope="module")
def synthesizer() -> GraspSynthesizer:
    torch.manual_seed(0)
    model = GraspModel(PRESETS["tiny"], model_id="random").eval()
    return GraspSynthesizer(model, "franka_hand", threads=1)


@pytest.fixture(scope="module")
def server(synthesizer: GraspSynthesizer) -> Iterator[PlannerServer]:
    made = PlannerServer(synthesizer, port=0)
    thread = threading.Thread(target=made.serve)
    thread.start()
    yield made
    made.stop()
    thread.join()


@pytest.fixture
def client(server: PlannerServer) -> PlannerClient:
    return PlannerClient(server.address, timeout=60.0)


def points() -> np.ndarray:
    rng = np.random.default_rng(0)
    floor = rng.uniform((-0.2, -0.15, 0.0), (0.2, 0.15, 0.0005), (6000, 3))
    box = rng.uniform((-0.02, -0.03, 0.0495), (0.02, 0.03, 0.05), (2000, 3))
    return np.concatenate([floor, box])


def test_a_cloud_gets_the_grasps_that_the_library_gives(
    client: PlannerClient, synthesizer: GraspSynthesizer
) -> None:
    from megrasp_core.pointcloud import Cloud

    options = {"num_grasps": 4, "drawn": 6, "keep_all": True, "seed": 3, "sensor": SENSOR}
    answer = client.synthesize(points(), **options)
    cloud = Cloud(points(), None, None)
    direct = synthesizer.synthesize(cloud, **options).to_json()
    assert answer["gripper"] == "franka_hand"
    assert len(answer["grasps"]) == 4
    for sent, made in zip(answer["grasps"], direct["grasps"], strict=True):
        np.testing.assert_allclose(sent["world_from_tcp"], made["world_from_tcp"], atol=1e-6)
    assert answer["rejected"] == direct["rejected"]


def test_region_floor_and_excluded_poses_travel_as_json(client: PlannerClient) -> None:
    answer = client.synthesize(
        points(), num_grasps=2, drawn=2, keep_all=True, seed=3, sensor=np.array(SENSOR),
        region={"pose": [0, 0, 0.1, 0, 0, 0, 1], "size": [0.4, 0.3, 0.2]}, walls=False,
        floor=[0, 0, 2, 0], exclude=[[0, 0, 0.05, 1, 0, 0, 0]],
    )  # fmt: skip
    assert answer["seed"] == 3


def test_places_on_a_map_keep_their_millimetres(monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[np.ndarray] = []

    def send(self: PlannerClient, path: str, body: bytes) -> dict[str, object]:
        with np.load(io.BytesIO(body)) as archive:
            sent.append(archive["points"])
        return {}

    monkeypatch.setattr(PlannerClient, "_send", send)
    far = points() + np.array([512_345.678, 5_403_210.987, 310.0])
    PlannerClient().synthesize(far)
    PlannerClient().synthesize(points().astype(np.float32))
    np.testing.assert_array_equal(sent[0], far)
    assert sent[1].dtype == np.float32  # nothing to lose: half the bytes


def test_a_sensor_for_every_point_and_many_poses_travel_in_the_body(
    client: PlannerClient, synthesizer: GraspSynthesizer
) -> None:
    from megrasp_core.pointcloud import Cloud

    seen_from = np.tile(SENSOR, (len(points()), 1)) + np.linspace(0, 1e-3, len(points()))[:, None]
    failed = [np.array([0.3 + i, 0.0, 0.05, 1.0, 0.0, 0.0, 0.0]) for i in range(700)]
    options = {"num_grasps": 2, "drawn": 4, "keep_all": True, "seed": 3}
    answer = client.synthesize(points(), sensor=seen_from, exclude=failed, **options)
    direct = synthesizer.synthesize(Cloud(points(), None, seen_from), **options).to_json()
    for sent, made in zip(answer["grasps"], direct["grasps"], strict=True):
        np.testing.assert_allclose(sent["world_from_tcp"], made["world_from_tcp"], atol=1e-9)
    with pytest.raises(PlannerError, match=r"expected \(\.\.\., 7\)"):
        client.synthesize(points(), sensor=SENSOR, exclude=[[0.0] * 6] * 1000)


def test_changing_the_gripper(client: PlannerClient) -> None:
    assert client.set_gripper("robotiq_2f85")["name"] == "robotiq_2f85"
    assert client.status()["gripper"] == "robotiq_2f85"
    assert "left" not in client.set_gripper("franka_hand")["open"]
    with pytest.raises(PlannerError, match="'/etc/passwd'") as told:
        client.set_gripper("/etc/passwd")
    assert told.value.code == 200
    assert client.status()["gripper"] == "franka_hand"


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        ({"nonsense": 1}, 5, "nonsense"),
        ({"num_grasps": 0}, 5, "num_grasps 0"),
        ({"gravity": [0, 0, 0]}, 103, "point down"),
        ({"region": {"pose": [0, 0]}}, 5, "expected"),
        ({"region": {"size": [1, 1, 1]}}, 5, "7 numbers"),
        ({"floor": [0, 0, 0, 0]}, 5, "plane"),
        ({"walls": "false"}, 5, "walls 'false'.*true or false"),
        ({"max_tilt": "0.5"}, 5, "max_tilt '0.5'.*rad"),
        ({"min_score": None}, 5, "min_score None.*from 0 to 1"),
        ({"region": {"pose": [5, 0, 0, 0, 0, 0, 1], "size": [0.1, 0.1, 0.1]}}, 104, "region"),
    ],
)
def test_bad_requests_say_what_was_expected(client, options, code, words) -> None:
    with pytest.raises(PlannerError, match=words) as told:
        client.synthesize(points(), **{"sensor": SENSOR, **options})
    assert told.value.code == code


def send(server: PlannerServer, method: str, path: str, body: bytes = b"", **headers: str):
    host, port = server.address.removeprefix("http://").split(":")
    connection = http.client.HTTPConnection(host, int(port), timeout=30)
    connection.request(method, path, body, headers)
    answer = connection.getresponse()
    content = json.loads(answer.read())
    connection.close()
    return answer.status, content["error"]["code"], content["error"]["message"]


@pytest.mark.parametrize(
    ("method", "path", "body", "status", "words"),
    [
        ("POST", "/synthesize", b"", 400, "no cloud"),
        ("POST", "/synthesize", b"PK\x03\x04 cut", 400, "the body"),
        ("POST", "/synthesize?request=[1]", b"", 400, "JSON object"),
        ("POST", "/synthesize?request=" + urllib.parse.quote("[" * 5000), b"", 400, "JSON object"),
        ("POST", "/synthesize?request=body", b"PK\x03\x04 cut", 400, "in the body"),
        ("POST", "/gripper", b"\xff", 400, "JSON object"),
        ("POST", "/gripper", b"{}", 400, "None"),
        ("GET", "/nothing", b"", 404, "expected GET /status"),
        ("GET", "/../../etc/passwd", b"", 404, "expected GET /status"),
    ],
)
def test_malformed_requests_are_refused_and_the_planner_goes_on(
    server, client, method, path, body, status, words
) -> None:
    got, _, message = send(server, method, path, body)
    assert got == status
    assert words in message
    assert "/tmp" not in message
    assert client.status()["model"] == "random"


def test_a_body_that_is_too_long_is_not_read(server, client) -> None:
    status, code, message = send(server, "POST", "/synthesize", **{"Content-Length": str(2**40)})
    assert (status, code) == (400, 5)
    assert "Content-Length" in message
    assert client.status()["busy"] is False


def test_a_second_request_is_told_that_the_planner_is_busy(server, client) -> None:
    with server._one_at_a_time():
        assert client.status()["busy"]
        with pytest.raises(PlannerError, match="at work") as told:
            client.synthesize(points(), sensor=SENSOR)
        assert told.value.code == 1
    assert not client.status()["busy"]


def test_a_busy_planner_and_a_wrong_token_are_told_to_who_sends_a_large_cloud(
    server, client, synthesizer
) -> None:
    cloud = np.zeros((700_000, 3))
    with server._one_at_a_time(), pytest.raises(PlannerError, match="at work"):
        client.synthesize(cloud, sensor=SENSOR)
    guarded = PlannerServer(synthesizer, port=0, token="right")
    thread = threading.Thread(target=guarded.serve)
    thread.start()
    try:
        with pytest.raises(PlannerError, match="token"):
            PlannerClient(guarded.address, "wrong").synthesize(cloud, sensor=SENSOR)
    finally:
        guarded.stop()
        thread.join()


def test_pages_of_others_cannot_reach_it(server) -> None:
    body = json.dumps({"name": "robotiq_2f85"}).encode()
    status, code, message = send(
        server,
        "POST",
        "/gripper",
        body,
        Origin="http://example.org",
        **{"Content-Type": "text/plain"},
    )
    assert (status, code) == (403, 5) and "browser" in message
    assert server.status()["gripper"] == "franka_hand"


def test_many_clients_at_once_get_an_answer_or_are_told_to_wait(client) -> None:
    told = []

    def ask(seed: int) -> None:
        try:
            answer = client.synthesize(points(), num_grasps=1, drawn=2, seed=seed, sensor=SENSOR)
            told.append(answer["seed"] == seed)
        except PlannerError as error:
            told.append(error.code == 1)

    threads = [threading.Thread(target=ask, args=(seed,)) for seed in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert told == [True] * 8


def test_a_token_is_needed_where_one_is_set(synthesizer: GraspSynthesizer) -> None:
    guarded = PlannerServer(synthesizer, port=0, token="right")
    thread = threading.Thread(target=guarded.serve)
    thread.start()
    try:
        assert PlannerClient(guarded.address, "right").status()["model"] == "random"
        for token in ("", "wrong", "rigth", "\u00e9"):
            with pytest.raises(PlannerError, match="token"):
                PlannerClient(guarded.address, token).status()
    finally:
        guarded.stop()
        thread.join()


def test_other_addresses_need_a_token(synthesizer: GraspSynthesizer) -> None:
    with pytest.raises(InvalidRequestError, match=r"0\.0\.0\.0.*token"):
        PlannerServer(synthesizer, host="0.0.0.0", port=0)


def test_nobody_there_is_said(server: PlannerServer) -> None:
    with pytest.raises(PlannerError, match="megrasp serve"):
        PlannerClient("http://127.0.0.1:9", timeout=2.0).status()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_the_command_serves_until_it_is_told_to_stop(
    tmp_path: Path, number: signal.Signals
) -> None:
    torch.manual_seed(0)
    model = save_model(GraspModel(PRESETS["tiny"], model_id="random"), tmp_path / "random")
    start = "import sys; from megrasp_core.cli import main; sys.exit(main())"
    command = [sys.executable, "-c", start, "serve", "--gripper", "franka_hand"]
    process = subprocess.Popen(
        [*command, "--port", "0", "--model", str(model)],
        stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        status = PlannerClient(line.split()[-1]).status()
        assert status["gripper"] == "franka_hand"
        process.send_signal(number)
        assert process.wait(timeout=60) == 0
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
