#!/usr/bin/env bash
# Builds the wheel of megrasp_core, installs it in a fresh venv outside the checkout, as somebody does who has no
# checkout, and finds grasps with it. Prints the commands, what they say, the size of what was installed and the
# CPU-seconds of a start. Needs pip's index; everything is deleted in the end.
#
#   bash launch_scripts/check_wheel.sh [--from-folder]     # --from-folder: `pip install ./megrasp_core`, no wheel first
#
# Variables: MEGRASP_PYTHON (Python 3.11 or 3.12), MEGRASP_TORCH_ARGS (as of setup.sh).

set -euo pipefail

root="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
scratch="$(mktemp -d -t megrasp_wheel_XXXXXX)"
trap 'rm -rf "$scratch"' EXIT
python="$scratch/venv/bin/python"
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
if [ "${1:-}" = --from-folder ]; then
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
printf 'site-packages: %s MiB\n' "$(du -sm "$scratch"/venv/lib/python3*/site-packages | cut -f1)"
"$python" - "$python" "$megrasp" <<'PY'
import resource
import subprocess
import sys

python, megrasp = sys.argv[1:]
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


print(f"megrasp --help: {seconds(megrasp, '--help'):.2f} CPU-s")
print(f"import torch: {seconds(python, '-c', 'import torch'):.2f} CPU-s")
print(f"model and gripper loaded: {seconds(python, '-c', LOAD):.2f} CPU-s")
PY
