#!/usr/bin/env bash
# Empties a simulated bin through ROS 2: sets up what is missing, starts sim_cell, grasp_server and bin_clearing as
# separate processes, and ends by itself. Pictures, logs and summary.json: out/demo.
#
#   bash launch_scripts/demo.sh [--objects N] [--seed N] [--out DIR] [--no-setup]
#
# Exit code: 0 the run was completed, 1 a part of the system failed, 2 bad arguments, 130 Ctrl-C.

set -euo pipefail

root="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
objects=8
seed=1
out="$root/out/demo"
setup=yes

usage() {
  sed -n '2,7s/^# \{0,1\}//p' "${BASH_SOURCE[0]}"
}

while [ $# -gt 0 ]; do
  case "$1" in
    --objects | --seed | --out)
      [ $# -ge 2 ] || { echo "$1 was given without a value" >&2; usage >&2; exit 2; }
      case "$1" in
        --objects) objects="$2" ;;
        --seed) seed="$2" ;;
        --out) out="$(realpath -m "$2")" ;;
      esac
      shift 2
      ;;
    --no-setup) setup=no; shift ;;
    -h | --help) usage; exit 0 ;;
    *) echo "unknown argument $1" >&2; usage >&2; exit 2 ;;
  esac
done
for number in "$objects" "$seed"; do
  [[ "$number" =~ ^[1-9][0-9]*$ ]] || { echo "expected a whole number from 1, got '$number'" >&2; exit 2; }
done

if [ "$setup" = yes ]; then
  bash "$root/launch_scripts/setup.sh"
fi
# shellcheck source=launch_scripts/env.sh
. "$root/launch_scripts/env.sh"

mkdir -p "$out"
export ROS_LOG_DIR="${ROS_LOG_DIR:-$out/ros_log}"
# Another run on this machine must not hear this one.
export ROS_DOMAIN_ID="${ROS_DOMAIN_ID:-$((60 + $$ % 40))}"
# Two threads that have to share a core are many times slower than one; a synthesis on one takes about 2 s.
export OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}"

nodes="$root/ros2_ws/install/megrasp_ros/lib/megrasp_ros"
parameters="$root/launch_scripts/config/demo.yaml"
running=()

stop_all() {
  trap - EXIT INT TERM
  [ ${#running[@]} -eq 0 ] || kill -TERM "${running[@]}" 2>/dev/null || true
  for _ in $(seq 50); do
    any_alive "${running[@]}" || return 0
    sleep 0.1
  done
  kill -KILL "${running[@]}" 2>/dev/null || true
}

any_alive() {
  local pid
  for pid in "$@"; do
    if kill -0 "$pid" 2>/dev/null; then return 0; fi
  done
  return 1
}

trap stop_all EXIT
trap 'stop_all; exit 130' INT
trap 'stop_all; exit 143' TERM

# start NAME [parameters ..]: runs a node in the background, its output in out/demo/NAME.log.
start() {
  local name="$1"
  shift
  "$nodes/$name" --ros-args --params-file "$parameters" "$@" >"$out/$name.log" 2>&1 &
  running+=($!)
}

start sim_cell -p "num_objects:=$objects" -p "seed:=$seed"
cell=$!
start grasp_server
server=$!

# bin_clearing waits for the services of the two, so nothing here needs to know how long they take to start.
"$nodes/bin_clearing" --ros-args --params-file "$parameters" \
  -p "num_objects:=$objects" -p "seed:=$seed" -p "out:=$out" \
  > >(tee "$out/bin_clearing.log") 2>&1 &
clearing=$!
running+=("$clearing")

# If one of the nodes dies, waiting for its services would only take the whole timeout.
while kill -0 "$clearing" 2>/dev/null; do
  for pair in "sim_cell $cell" "grasp_server $server"; do
    read -r name pid <<<"$pair"
    if ! kill -0 "$pid" 2>/dev/null; then
      echo "$name ended before the run was over; the end of $out/$name.log:" >&2
      tail -n 20 "$out/$name.log" >&2
      exit 1
    fi
  done
  sleep 0.5
done
code=0
wait "$clearing" || code=$?
if [ "$code" -ne 0 ]; then
  echo "bin_clearing ended with exit code $code; logs: $out/*.log" >&2
fi
exit "$code"
