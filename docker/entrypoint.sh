#!/usr/bin/env bash
# Runs a command with the venv, ROS and the workspace.
set -eo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
. launch_scripts/env.sh
exec "$@"
