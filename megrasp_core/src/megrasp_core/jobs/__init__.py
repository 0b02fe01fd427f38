"""Long work: independent units here or over a Ray cluster, stopping, and logs of runs."""

from .executors import ExecutorConfig, Progress, RunSummary, run_units
from .run_log import add_runs, code_hash, log_run, runs_of, versions
from .stopping import StopSignals, deaf_to_ctrl_c

__all__ = [
    "ExecutorConfig",
    "Progress",
    "RunSummary",
    "StopSignals",
    "add_runs",
    "code_hash",
    "deaf_to_ctrl_c",
    "log_run",
    "run_units",
    "runs_of",
    "versions",
]
