"""The command line: results, exit codes, messages."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from megrasp_core.cli import main
from megrasp_core.network import PRESETS, GraspModel, save_model
from megrasp_core.pointcloud import Cloud, write_cloud


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> Path:
    """Folder of a small model with random weights."""
    torch.manual_seed(0)
    return save_model(
        GraspModel(PRESETS["tiny"], model_id="random"), tmp_path_factory.mktemp("m") / "random"
    )


@pytest.fixture(scope="module")
def cloud(tmp_path_factory) -> Path:
    """A floor with a box on it, seen from 0.85 m."""
    rng = np.random.default_rng(0)
    floor = rng.uniform((-0.2, -0.15, 0.0), (0.2, 0.15, 0.0005), (6000, 3))
    box = rng.uniform((-0.02, -0.03, 0.0495), (0.02, 0.03, 0.05), (2000, 3))
    path = tmp_path_factory.mktemp("c") / "cloud.npz"
    points = np.concatenate([floor, box])
    write_cloud(path, Cloud(points, None, np.array([0.0, 0.0, 0.85])))
    return path


def run(capsys, *args: object) -> tuple[int, str, str]:
    code = main([str(a) for a in args])
    told = capsys.readouterr()
    return code, told.out, told.err


def test_synthesize_writes_json_and_picture(capsys, model, cloud, tmp_path):
    out, picture = tmp_path / "o" / "grasps.json", tmp_path / "p" / "grasps.png"
    code, said, _ = run(
        capsys, "synthesize", cloud, "--gripper", "robotiq_2f85", "-n", 6, "--drawn", 8, "--all",
        "--model", model, "--seed", 4, "--out", out, "--picture", picture,
    )  # fmt: skip
    content = json.loads(out.read_text())
    assert code in (0, 1) and len(content["grasps"]) == 6
    assert code == (0 if any(g["collision_free"] for g in content["grasps"]) else 1)
    assert content["seed"] == 4 and content["frame"] == "world" and content["model"] == "random"
    assert str(out) in said and str(picture) in said
    with Image.open(picture) as image:
        assert image.width > 1000 and len(np.unique(np.asarray(image))) > 50


def test_nothing_found_is_exit_code_1_with_counts(capsys, model, cloud, tmp_path):
    out = tmp_path / "grasps.json"
    code, said, _ = run(
        capsys, "synthesize", cloud, "--gripper", "robotiq_2f85", "-n", 3, "--drawn", 4,
        "--model", model, "--max-tilt", 0.0001, "--out", out,
    )  # fmt: skip
    assert code == 1 and json.loads(out.read_text())["grasps"] == []
    assert "not returned:" in said


def test_region_file(capsys, model, cloud, tmp_path):
    region = tmp_path / "bin.yaml"
    region.write_text("pose: [0, 0, 0.075, 0, 0, 0, 1]\nsize: [0.4, 0.3, 0.15]\nwalls: true\n")
    args = (
        "synthesize",
        cloud,
        "--gripper",
        "robotiq_2f85",
        "-n",
        2,
        "--drawn",
        2,
        "--model",
        model,
    )
    code, _, _ = run(capsys, *args, "--region", region)
    assert code in (0, 1)
    region.write_text("pose: [9, 9, 9, 0, 0, 0, 1]\nsize: [0.4, 0.3, 0.15]\n")
    code, _, told = run(capsys, *args, "--region", region)
    assert code == 2 and "lies in the region" in told and "Give the region" in told


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("pose: [0, 0]\nsize: [1, 1, 1]\n", "a pose of 2"),
        ("size: [1, 1, 1]\n", "incomplete"),
        ("box: 3\n", "expected JSON or YAML with pose"),
        ("pose: [a\n", "cannot be read"),
        ("pose: [0, 0, 0, 0, 0, 0, 1]\nsize: [1, 0, 1]\n", "full edges over 0"),
    ],
)
def test_wrong_region_files_are_told(capsys, model, cloud, tmp_path, text, words):
    region = tmp_path / "bin.yaml"
    region.write_text(text)
    code, _, told = run(
        capsys,
        "synthesize",
        cloud,
        "--gripper",
        "robotiq_2f85",
        "--model",
        model,
        "--region",
        region,
    )
    assert code == 2 and words in told


def clouds_that_are_wrong(folder: Path) -> dict[str, Path]:
    empty, nan, shape = folder / "empty.npy", folder / "nan.npz", folder / "shape.npy"
    np.save(empty, np.zeros((0, 3)))
    np.savez(nan, points=np.full((50, 3), np.nan))
    np.save(shape, np.zeros((50, 2)))
    text, damaged = folder / "cloud.txt", folder / "damaged.ply"
    text.write_text("0 0 0\n")
    damaged.write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 10\nend_header\n")
    return {
        "missing": folder / "none.ply",
        "empty": empty,
        "all NaN": nan,
        "shape": shape,
        "suffix": text,
        "damaged": damaged,
    }


@pytest.mark.parametrize("kind", ["missing", "empty", "all NaN", "shape", "suffix", "damaged"])
def test_wrong_clouds_are_exit_code_2(capsys, model, tmp_path, kind):
    path = clouds_that_are_wrong(tmp_path)[kind]
    code, _, told = run(capsys, "synthesize", path, "--gripper", "robotiq_2f85", "--model", model)
    assert code == 2 and path.name in told
    assert told.count("megrasp:") == 1 and "Traceback" not in told


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (("-n", "0"), ("num_grasps 0", "from 1 to 1000")),
        (("-n", "-1"), ("num_grasps -1", "from 1 to 1000")),
        (("-n", "1000000"), ("num_grasps 1000000", "from 1 to 1000", "Ask for fewer")),
        (("--frame", "optical"), ("without gravity", "--gravity X Y Z", "--top-down")),
        (("--top-down",), ("--frame optical only",)),
        (("--frame", "optical", "--top-down", "--gravity", "0", "0", "1"), ("one of them",)),
        (("--gravity", "0", "0", "0"), ("point down",)),
        (("--model", "nobody"), ("'nobody' not found", "config.json")),
        (("--region", "none.yaml"), ("none.yaml", "cannot be read")),
        (("--device", "abacus"), ("abacus",)),
    ],
)
def test_wrong_arguments_are_exit_code_2(capsys, model, cloud, args, words):
    base = ["synthesize", cloud, "--gripper", "robotiq_2f85"]
    if "--model" not in args:
        base += ["--model", model]
    code, _, told = run(capsys, *base, *args)
    assert code == 2
    for word in words:
        assert word in told


def test_an_unknown_gripper_lists_the_known_ones(capsys, model, cloud):
    code, _, told = run(capsys, "synthesize", cloud, "--gripper", "claw", "--model", model)
    assert (
        code == 2
        and "'claw'" in told
        and "robotiq_2f85" in told
        and "MEGRASP_GRIPPER_PATH" in told
    )


def test_an_unreadable_description_is_exit_code_2(capsys, model, cloud, tmp_path):
    (tmp_path / "gripper.yaml").write_text("format: 1\nname: broken\nfinger: []\n")
    for args in (
        ("gripper", "check", tmp_path),
        ("gripper", "show", tmp_path),
        ("synthesize", cloud, "--gripper", tmp_path, "--model", model),
    ):
        code, _, told = run(capsys, *args)
        assert code == 2 and "finger" in told


def test_damaged_weights_are_exit_code_2(capsys, cloud, tmp_path):
    folder = save_model(GraspModel(PRESETS["tiny"]), tmp_path / "damaged")
    weights = folder / "model.safetensors"
    weights.write_bytes(weights.read_bytes()[:-1000])
    code, _, told = run(
        capsys, "synthesize", cloud, "--gripper", "robotiq_2f85", "--model", folder
    )
    assert code == 2 and "damaged" in told and "Restore" in told


def test_a_cloud_without_viewpoint_warns_and_says_what_it_assumes(
    capsys, model, cloud, tmp_path, caplog
):
    path = tmp_path / "cloud.ply"
    with np.load(cloud) as file:
        write_cloud(path, Cloud(file["points"]))
    code, _, _ = run(
        capsys,
        "synthesize",
        path,
        "--gripper",
        "robotiq_2f85",
        "-n",
        2,
        "--drawn",
        2,
        "--model",
        model,
    )
    assert code in (0, 1) and "Give --sensor X Y Z" in caplog.text


def test_optical_top_down_uses_the_origin_as_sensor(capsys, model, cloud, tmp_path):
    path = tmp_path / "optical.npy"
    with np.load(cloud) as file:
        np.save(path, file["points"] * [1, -1, -1] + [0, 0, 0.85])
    out = tmp_path / "grasps.json"
    code, _, _ = run(
        capsys, "synthesize", path, "--gripper", "robotiq_2f85", "-n", 4, "--drawn", 4, "--all",
        "--frame", "optical", "--top-down", "--model", model, "--out", out,
    )  # fmt: skip
    content = json.loads(out.read_text())
    assert code in (0, 1) and content["frame"] == "optical"
    from megrasp_core.lie import matrix_from_pose7

    for grasp in content["grasps"]:
        axis = matrix_from_pose7(grasp["world_from_tcp"])[2, 2]
        assert np.cos(grasp["tilt"]) == pytest.approx(axis, abs=1e-5)


def test_gripper_list_show_and_render(capsys, tmp_path):
    code, said, _ = run(capsys, "gripper", "list")
    assert code == 0 and "robotiq_2f85" in said and "85 mm" in said
    code, _, _ = run(capsys, "gripper", "list", "--out", tmp_path / "g.json")
    assert code == 0
    names = [entry["name"] for entry in json.loads((tmp_path / "g.json").read_text())]
    assert {"robotiq_2f85", "franka_hand"} <= set(names)
    code, said, _ = run(capsys, "gripper", "show", "robotiq_2f85")
    facts = json.loads(said)
    assert code == 0 and facts["tcp"][2] == pytest.approx(0.15) and facts["hash"]
    assert set(facts["open_joints"]) == set(facts["closed_joints"])
    code, _, _ = run(capsys, "gripper", "render", "franka_hand", "--out", tmp_path / "f.png")
    with Image.open(tmp_path / "f.png") as image:
        assert code == 0 and len(np.unique(np.asarray(image))) > 30


def test_gripper_check_against_itself_finds_no_difference(capsys):
    args = ("gripper", "check", "robotiq_2f85", "--against", "robotiq_2f85", "--points", 500)
    code, said, _ = run(capsys, *args)
    report = json.loads(said[: said.rindex("}") + 1])
    assert code == 0 and report["findings"] == []
    measures = report["against"]["measures"]
    assert measures["surface_open"]["value"] == measures["tcp"]["value"] == 0.0
    assert "pad motion                0.00     3.0  pass" in said


def test_gripper_check_against_another_names_what_differs(capsys, tmp_path):
    args = ("gripper", "check", "franka_hand", "--against", "robotiq_2f85", "--points", 500)
    code, said, _ = run(capsys, *args, "--out", tmp_path / "c.json")
    report = json.loads((tmp_path / "c.json").read_text())
    assert code == 1 and not report["against"]["passed"]
    assert "finding: against robotiq_2f85: tcp is 46.60 mm; expected at most 2.0 mm" in said
    assert "TCP                      46.60     2.0  FAIL" in said
    code, _, told = run(capsys, *args[:-1], 0)
    assert code == 2 and "--points is 0; expected at least 1" in told


def test_gripper_fidelity_writes_file_and_page(capsys, tmp_path, assets):
    out, page = tmp_path / "f.json", tmp_path / "page.md"
    args = ("gripper", "fidelity", "--out", out, "--page", page)
    page.write_text("no marks\n")
    code, _, told = run(capsys, *args, "schunk_wsg32")
    assert code == 2 and "<!-- fidelity -->" in told and not out.exists()
    page.write_text("before\n<!-- fidelity -->\nold\n<!-- /fidelity -->\nafter\n")
    for name in ("schunk_wsg32", "franka_hand"):
        code, said, _ = run(capsys, *args, name)
        assert code == 0 and f"| {name} |" in said
    entries = json.loads(out.read_text())
    assert [entry["gripper"] for entry in entries] == ["franka_hand", "schunk_wsg32"]
    assert all(entry["passed"] and entry["points"] == 20000 for entry in entries)
    text = page.read_text()
    assert text.startswith("before\n<!-- fidelity -->\n| gripper |") and "old" not in text
    assert text.endswith("<!-- /fidelity -->\nafter\n") and "| franka_hand |" in text


def test_objects_generate(capsys, tmp_path):
    code, _, _ = run(capsys, "objects", "generate", tmp_path, "-n", 2, "--seed", 5)
    assert code == 0 and len(list(tmp_path.rglob("meta.json"))) == 2
    code, _, told = run(capsys, "objects", "generate", tmp_path, "-n", 0)
    assert code == 2 and "expected at least 1" in told


def test_objects_prepare(capsys, tmp_path):
    scans, out = tmp_path / "scans", tmp_path / "out"
    scans.mkdir()
    trimesh.creation.box((60, 50, 40)).export(scans / "box.stl")
    trimesh.creation.cylinder(20, 70).export(scans / "can.ply")
    (scans / "torn.ply").write_text("ply\nformat ascii 1.0\nelement vertex 3\n")
    args = ("objects", "prepare", scans, out, "--scale", 0.001, "--density", 1000)
    code, said, _ = run(capsys, *args)
    assert code == 1 and "failed: torn: " in said and "torn.ply cannot be read" in said
    assert "box: 60 x 50 x 40 mm, 0.12 kg, 1 convex piece" in said
    assert f"wrote 2 objects to {out}" in said
    with Image.open(out / "objects.png") as image:
        assert image.width > 600 and len(np.unique(np.asarray(image))) > 30
    (scans / "torn.ply").unlink()
    code, said, _ = run(capsys, *args, "--no-picture")
    assert code == 0 and said.startswith(f"wrote 0 objects to {out}") and "kept 2" in said
    code, _, told = run(capsys, "objects", "prepare", tmp_path / "none", out)
    assert code == 2 and "no folder" in told


@pytest.mark.parametrize(
    ("args", "word"),
    [
        (("--objects", "none"), "none"),
        (("--gripper", "claw"), "claw"),
        (("--scenes", "0"), "scenes 0"),
        (("--model", "nobody"), "nobody"),
    ],
)
def test_eval_of_wrong_input_is_exit_code_2(capsys, model, tmp_path, args, word):
    base = {"--gripper": "robotiq_2f85", "--model": model, "--protocol": "single"}
    base |= {"--out": tmp_path / "o.json", "--samples": 0, args[0]: args[1]}
    args = [word for pair in base.items() for word in pair]
    code, _, told = run(capsys, "eval", *args)
    assert code == 2 and word in told


@pytest.mark.parametrize("what", ["stats", "verify"])
def test_data_of_a_missing_folder_is_exit_code_2(capsys, tmp_path, what):
    code, _, told = run(capsys, "data", what, "--out", tmp_path / "none")
    assert code == 2 and "none" in told


def test_train_without_data_is_exit_code_2(capsys, tmp_path):
    code, _, told = run(
        capsys, "train", "--data", tmp_path / "none", "--out", tmp_path / "run", "--preset", "tiny"
    )
    assert code == 2 and "none" in told


@pytest.mark.parametrize(
    "args",
    [
        (), ("nonsense",), ("synthesize",), ("synthesize", "a.ply"), ("gripper",), ("objects",),
        ("synthesize", "a.ply", "--gripper", "x", "-n", "many"), ("demo", "--nonsense"),
    ],
)  # fmt: skip
def test_wrong_command_lines_are_exit_code_2(capsys, args):
    assert run(capsys, *args)[0] == 2


@pytest.mark.parametrize(
    "args",
    [
        (), ("demo",), ("synthesize",), ("gripper",), ("gripper", "check"), ("train",), ("bench",),
        ("objects", "generate"), ("objects", "prepare"), ("data", "grasps"), ("data", "scenes"),
        ("data", "pack"), ("eval",), ("data", "look"),
    ],
)  # fmt: skip
def test_help_has_an_example(capsys, args):
    code, said, _ = run(capsys, *args, "--help")
    assert code == 0 and "Try:" in said


def test_help_imports_nothing_heavy():
    script = (
        "import sys\nfrom megrasp_core.cli import main\nmain(['--help'])\n"
        "print(sorted({'torch', 'mujoco', 'open3d', 'scipy', 'viser'} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip().endswith("[]")


def test_a_synthesis_loads_nothing_that_only_other_commands_need():
    script = (
        "import sys\nfrom megrasp_core.synthesizer import GraspSynthesizer\n"
        "GraspSynthesizer.load(gripper='robotiq_2f85')\n"
        "unneeded = {'e3nn', 'matplotlib', 'open3d', 'ray', 'scipy.optimize', 'viser'}\n"
        "print(sorted(unneeded & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"


SPEAKS = """import sys, time
from megrasp_core.cli import app, main
def speak() -> int:
    for _ in range(400):
        print("word " * 40, flush=True)
    sys.stderr.write("spoke to the end")
    return 0
class Commands:
    def cli(self, **_):
        return speak()
app.commands.app = Commands
sys.exit(main())
"""


HELPS = "import sys; from megrasp_core.cli import main; sys.exit(main(['--help']))"


@pytest.mark.parametrize("script", [SPEAKS, HELPS])
def test_output_that_is_closed_early_ends_a_command_quietly(script):
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [sys.executable, "-c", script], stdout=write, stderr=subprocess.PIPE, text=True
    )
    os.close(write)
    assert done.returncode == 1 and done.stderr == ""


def test_another_broken_pipe_is_told(capsys, monkeypatch):
    class Commands:
        def cli(self, **_):
            raise BrokenPipeError(32, "Broken pipe")

    monkeypatch.setattr("megrasp_core.cli.commands.app", Commands)
    code, _, told = run(capsys)
    assert code == 1 and "a process that it worked with has ended" in told


def test_explain_takes_what_synthesize_takes_and_writes_a_page(capsys, model, cloud, tmp_path):
    args = (
        cloud,
        "--gripper",
        "robotiq_2f85",
        "-n",
        3,
        "--drawn",
        6,
        "--model",
        model,
        "--seed",
        4,
    )
    code, said, _ = run(capsys, "explain", *args, "--out", tmp_path / "why")
    content = json.loads((tmp_path / "why/explanation.json").read_text())
    assert code == (0 if content["grasps"] else 1) and content["seed"] == 4
    assert len(content["poses"]) == 6
    assert str(tmp_path / "why/explanation.html") in said
    run(capsys, "synthesize", *args, "--out", tmp_path / "grasps.json")
    grasps = json.loads((tmp_path / "grasps.json").read_text())["grasps"]
    assert [one["score"] for one in grasps] == [one["score"] for one in content["grasps"]]


def test_explain_also_draws_what_is_refused(capsys, model, cloud, tmp_path):
    code, said, _ = run(
        capsys, "explain", cloud, "--gripper", "robotiq_2f85", "--model", model,
        "--sensor", 0, 0, -0.8, "--out", tmp_path,
    )  # fmt: skip
    assert code == 2 and "sensor at 0 0 -0.8 lies below" in said
    assert (tmp_path / "map.png").is_file()
