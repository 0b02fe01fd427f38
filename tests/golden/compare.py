"""Holds this tree against an older commit: the same work, with the same seeds, on this machine.

    python tests/golden/compare.py COMMIT [--parts synthesize eval scenes train wizard ros]

For changes that must not change anything. Poses must agree to 1e-6, counts, reasons and names
exactly; times are not looked at. Ends with exit code 1 and the list of what differs.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from measure import PARTS
from safetensors.torch import load_file

ROOT = Path(__file__).resolve().parents[2]
TOLERANCE = 1e-6
VOLATILE = {
    "cpu_seconds", "created", "duration", "elapsed", "ended", "hardware", "machine", "memory_mb",
    "now", "path", "seconds", "sha256", "started", "timing", "version", "versions",
}  # fmt: skip
"""Keys of JSON files that differ from run to run."""
SKIPPED = {".png", ".log"}
LINES_SKIPPED = {"runs.jsonl"}


def main() -> int:
    """Run both trees and compare; see the module."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("commit", help="the older commit")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--keep", type=Path, help="folder that keeps the results of both")
    options = parser.parse_args()
    with contextlib.ExitStack() as stack:
        scratch = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="megrasp_golden_")))
        results = options.keep or scratch
        folders = []
        commit = _git("rev-parse", "--short", options.commit)
        trees = {commit: stack.enter_context(_worktree(commit, scratch)), "here": ROOT}
        for name, tree in trees.items():
            out = results / name
            if name == "here" or not (out / "done").is_file():
                _measure(tree, out, options.parts)
                (out / "done").touch()
            folders.append(out)
        differences = list(compared(*folders))
    for line in differences:
        print(line)
    print(f"{len(differences)} differences from {commit}" if differences else f"as {commit}")
    return 1 if differences else 0


def compared(old: Path, new: Path) -> Iterator[str]:
    """Say what differs between two folders of results."""
    names = {
        path.relative_to(folder)
        for folder in (old, new)
        for path in folder.rglob("*")
        if path.is_file() and path.suffix not in SKIPPED and path.name not in LINES_SKIPPED
    }
    for name in sorted(names - {Path("done")}):
        pair = old / name, new / name
        missing = [path.parent for path in pair if not path.is_file()]
        if missing:
            yield f"{name}: missing in {missing[0]}"
            continue
        yield from (f"{name}: {line}" for line in _files_differ(*pair))


def _files_differ(old: Path, new: Path) -> Iterator[str]:
    if old.suffix == ".json":
        yield from values_differ(json.loads(old.read_text()), json.loads(new.read_text()))
    elif old.suffix == ".jsonl":
        lines = [
            [json.loads(line) for line in path.read_text().splitlines()] for path in (old, new)
        ]
        yield from values_differ(*lines)
    elif old.suffix in (".npz", ".safetensors"):
        read = _arrays if old.suffix == ".npz" else _tensors
        yield from values_differ(read(old), read(new))
    elif old.read_bytes() != new.read_bytes():
        yield "contents differ"


def _arrays(path: Path) -> dict[str, np.ndarray]:
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def _tensors(path: Path) -> dict[str, np.ndarray]:
    return {name: tensor.double().numpy() for name, tensor in load_file(path).items()}


def values_differ(old: Any, new: Any, where: str = "") -> Iterator[str]:
    """Say where two values, of JSON or arrays, differ."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted((old.keys() | new.keys()) - VOLATILE):
            if key not in old or key not in new:
                yield f"{where}/{key}: only {'before' if key in old else 'now'}"
            else:
                yield from values_differ(old[key], new[key], f"{where}/{key}")
    elif isinstance(old, list) and isinstance(new, list):
        if len(old) != len(new):
            yield f"{where}: {len(old)} entries, now {len(new)}"
            return
        for index, (a, b) in enumerate(zip(old, new, strict=True)):
            yield from values_differ(a, b, f"{where}[{index}]")
    elif isinstance(old, np.ndarray) and isinstance(new, np.ndarray):
        if old.shape != new.shape or old.dtype != new.dtype:
            yield f"{where}: {old.dtype}{old.shape}, now {new.dtype}{new.shape}"
        elif old.dtype.kind == "f":
            a, b = old.astype(np.float64), new.astype(np.float64)
            if not np.allclose(a, b, rtol=TOLERANCE, atol=TOLERANCE, equal_nan=True):
                yield f"{where}: off by {np.nanmax(abs(a - b)):.3g}"
        elif not np.array_equal(old, new):
            yield f"{where}: {int((old != new).sum())} of {old.size} differ"
    elif isinstance(old, float) and isinstance(new, float):
        if not np.isclose(old, new, rtol=TOLERANCE, atol=TOLERANCE, equal_nan=True):
            yield f"{where}: {old!r}, now {new!r}"
    elif old != new:
        yield f"{where}: {old!r}, now {new!r}"


def _measure(tree: Path, out: Path, parts: list[str]) -> None:
    out.mkdir(parents=True, exist_ok=True)
    sources = [str(tree / "megrasp_core" / "src"), str(tree / "megrasp_ros")]
    kept = [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(sources + kept),
        "OMP_NUM_THREADS": "1",
        "MEGRASP_MODELS": str(tree / "models"),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }
    for part in parts:
        began = time.monotonic()
        command = [
            sys.executable,
            str(Path(__file__).with_name("measure.py")),
            "--out",
            str(out),
            part,
        ]
        done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"{part} failed in {tree}:\n{done.stdout}\n{done.stderr}")
        print(f"{out.name}: {part} in {time.monotonic() - began:.0f} s", flush=True)


@contextlib.contextmanager
def _worktree(commit: str, scratch: Path) -> Iterator[Path]:
    folder = scratch / "old"
    _git("worktree", "add", "--detach", str(folder), commit)
    try:
        yield folder
    finally:
        _git("worktree", "remove", "--force", str(folder))


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", "-C", str(ROOT), *arguments], capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"git {' '.join(arguments)}: {done.stderr}")
    return done.stdout.strip()


if __name__ == "__main__":
    sys.exit(main())
