#!/usr/bin/env bash
# Sets up what is missing, then runs every check: ruff, pyright, all tests. Ends with pytest's summaries, one of the
# core's tests and one of the nodes'; exit code 0 only if everything passed.
#
#   bash launch_scripts/test.sh [pytest arguments]
#
# Variables: those of setup.sh; MEGRASP_ASSETS, the folder of real grippers and objects (tests that need it are
# skipped without); MEGRASP_TEST_WORKERS, processes that share the tests (by default one a core, two at most);
# MEGRASP_JUNIT, an .xml file for pytest's JUnit report; that of the nodes goes beside it, NAME_ros.xml.

set -euo pipefail

root="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
cd "$root"
bash launch_scripts/setup.sh
. launch_scripts/env.sh

# One thread for each of the many small processes: more only get in each other's way.
export OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}"
# Here the ROS tests must run; elsewhere they are left out where ROS is missing.
export MEGRASP_REQUIRE_ROS=1
export PYTHONUNBUFFERED=1
# Nothing here needs a display or OpenGL.
unset MUJOCO_GL DISPLAY
if [ -z "${ROS_LOG_DIR:-}" ]; then
  ROS_LOG_DIR="$(mktemp -d)"
  export ROS_LOG_DIR
  trap 'rm -rf "$ROS_LOG_DIR"' EXIT
fi

status=0
echo "[test] ruff"
ruff check . || status=1
# Takes one core for a minute, in which the tests begin.
pyright_log="$(mktemp)"
pyright --pythonpath "$(command -v python)" > "$pyright_log" 2>&1 &
pyright=$!

echo "[test] pytest"
# dash comes with open3d and brings a pytest plugin that nobody needs here
# The same examples in every run, so that a run tells of this change; `pytest tests` alone draws new ones.
options=(-q -p no:dash --hypothesis-profile=ci)
# nproc obeys OMP_NUM_THREADS, which has nothing to do with the number of processes.
cores="$(env -u OMP_NUM_THREADS nproc)"
# A file stays in one process, so that what its tests share is made once.
options+=(-n "${MEGRASP_TEST_WORKERS:-$((cores < 2 ? cores : 2))}" --dist loadfile)

run_tests() {  # NAME [pytest arguments]
  local junit=()
  if [ -n "${MEGRASP_JUNIT:-}" ]; then junit=("--junitxml=${MEGRASP_JUNIT%.xml}$1.xml"); fi
  python -m pytest "${options[@]}" "${junit[@]}" "${@:2}" || status=1
}

tell_pyright() {
  echo "[test] pyright"
  wait "$pyright" || status=1
  cat "$pyright_log"
  rm -f "$pyright_log"
}

chosen=false
for argument in "$@"; do
  if [ -e "${argument%%::*}" ]; then chosen=true; fi
done
if $chosen; then
  tell_pyright
  run_tests "" "$@"
else
  # Apart from each other: threads that spin nodes do not get along with tests that send signals.
  run_tests "" tests/core tests/golden "$@"
  tell_pyright
  run_tests _ros tests/ros megrasp_ros/test/test_linters.py "$@"
fi

exit "$status"
