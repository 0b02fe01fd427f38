#!/usr/bin/env bash
# Builds the wheel of megrasp_core, installs it in a fresh venv outside the checkout, as somebody does who has no
# checkout, and finds grasps with it. Prints the commands, what they say, the size of what was installed and the
# CPU-seconds of a start. Needs pip's index; everything is deleted in the end.
#
#   bash launch_scripts/check_wheel.sh [--from-folder] [--out FILE]
#     --from-folder: `pip install ./megrasp_core`, no wheel first; --out: the figures as JSON too
#
# Variables: MEGRASP_PYTHON (Python 3.11 or 3.12), MEGRASP_TORCH_ARGS (as of setup.sh).

set -euo pipefail

root="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
scratch="$(mktemp -d -t megrasp_wheel_XXXXXX)"
trap 'rm -rf "$scratch"' EXIT
python="$scratch/venv/bin/python"
from_folder=false out=
while [ $# -gt 0 ]; do
  case "$1" in
    --from-folder) from_folder=true ;;
    --out) shift; out="$(realpath -m "${1:?--out needs a file}")" ;;
    *) echo "check_wheel.sh: $1 was given; expected --from-folder or --out FILE" >&2; exit 2 ;;
  esac
  shift
done
read -r -a torch_args <<<"${MEGRASP_TORCH_ARGS:-}"

# What is printed does not name the folder, which is another one each time.
exec > >(sed "s#$scratch#SCRATCH#g")
run() { printf '$ %s\n' "$*"; "$@"; }
pip() { "$python" -m pip --disable-pip-version-check -qq "$@"; }

# Neither the checkout nor anything that a shell of the project sets may help.
unset PYTHONPATH VIRTUAL_ENV AMENT_PREFIX_PATH MEGRASP_MODELS MEGRASP_GRIPPER_PATH MEGRASP_ASSETS
export MEGRASP_CACHE="$scratch/cache" OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}"

"${MEGRASP_PYTHON:-python3}" -m venv "$scratch/venv"
pip install "${torch_args[@]}" -r "$root/launch_scripts/requirements/torch.txt"
# A copy, so that building leaves nothing in the checkout.
mkdir "$scratch/tree"
cp -r "$root/megrasp_core" "$root/models" "$root/gripper_descriptions" "$root/LICENSE" "$scratch/tree"
rm -rf "$scratch/tree/megrasp_core/build"
if $from_folder; then
  run pip install "$scratch/tree/megrasp_core"
else
  run pip wheel --no-deps -w "$scratch/wheels" "$scratch/tree/megrasp_core"
  ls -l "$scratch/wheels" | awk 'NR > 1 {print $5, $9}'
  run pip install "$scratch"/wheels/*.whl
fi
rm -rf "$scratch/tree"

cd "$scratch"
"$python" - <<'PY'
"""A cloud of three boxes on a table, seen from above."""
import numpy as np

rng = np.random.default_rng(0)
x, y = np.meshgrid(np.arange(-0.2, 0.2, 0.003), np.arange(-0.15, 0.15, 0.003))
z = np.zeros_like(x)
for centre, size in (((-0.08, 0.0), (0.02, 0.03)), ((0.05, 0.05), (0.03, 0.015)), ((0.06, -0.06), (0.02, 0.02))):
    z[(abs(x - centre[0]) < size[0]) & (abs(y - centre[1]) < size[1])] = 0.05
points = np.stack([x, y, z], -1).reshape(-1, 3) + rng.normal(0.0, 0.0005, (z.size, 3))
np.savez("cloud.npz", points=points, viewpoint=[0.0, 0.0, 0.8])
PY
megrasp="$scratch/venv/bin/megrasp"
run "$python" -c "import megrasp_core; print(megrasp_core.__file__)"
run "$megrasp" gripper list
run "$megrasp" synthesize cloud.npz --gripper robotiq_2f85 --seed 1 --out grasps.json --picture grasps.png
ls -l grasps.json grasps.png | awk '{print $5, $9}'
size="$(du -sm "$scratch"/venv/lib/python3*/site-packages | cut -f1)"
printf 'site-packages: %s MiB\n' "$size"
"$python" - "$python" "$megrasp" "$size" "$out" <<'PY'
import json
import resource
import subprocess
import sys
from pathlib import Path

from megrasp_core.machine import processor

python, megrasp, size, out = sys.argv[1:]
LOAD = "from megrasp_core.synthesizer import GraspSynthesizer as G; G.load(gripper='robotiq_2f85')"


def seconds(*command: str) -> float:
    """CPU-seconds, the least of three runs."""
    taken = []
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        taken.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(taken)


taken = {
    "megrasp --help": seconds(megrasp, "--help"),
    "import torch": seconds(python, "-c", "import torch"),
    "model and gripper loaded": seconds(python, "-c", LOAD),
}
for what, cpu in taken.items():
    print(f"{what}: {cpu:.2f} CPU-s")
if out:
    content = {
        "site_packages_mib": int(size),
        "cpu_seconds": {what: round(cpu, 3) for what, cpu in taken.items()},
        "hardware": processor(),
    }
    Path(out).parent.mkdir(parents=True, exist_ok=True)
    Path(out).write_text(json.dumps(content, indent=1) + "\n")
PY
