"""What all tests share: the assets guard and, for those below ros/, a built workspace."""

from __future__ import annotations

import os
import signal
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

ROS_FOLDERS = {"ros"}
SUPPORT = Path(__file__).parent / "support"


def pytest_configure(config: pytest.Config) -> None:
    """Keep what the tests render in a folder of their own, and hear Ctrl-C."""
    # A shell's background jobs ignore it, and so would every process that a test starts.
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    folder = tempfile.TemporaryDirectory(prefix="megrasp_cache_", ignore_cleanup_errors=True)
    os.environ["MEGRASP_CACHE"] = folder.name
    config.add_cleanup(folder.cleanup)


def _ros_missing() -> str:
    """Return why the ROS tests cannot run, "" when they can."""
    try:
        import megrasp_msgs.msg  # noqa: F401
        import rclpy  # noqa: F401
    except ImportError as error:
        return f"{error}; run `bash launch_scripts/setup.sh`, then `. launch_scripts/env.sh`"
    return ""


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out tests/ros where ROS is not set up; launch_scripts/test.sh makes that an error."""
    if collection_path.name not in ROS_FOLDERS or collection_path.parent != Path(__file__).parent:
        return None
    missing = _ros_missing()
    if missing and os.environ.get("MEGRASP_REQUIRE_ROS"):
        raise pytest.UsageError(f"tests/ros cannot run: {missing}")
    if missing:
        config.issue_config_time_warning(pytest.PytestWarning(f"tests/ros left out: {missing}"), 2)
    return bool(missing) or None


@pytest.fixture(scope="session")
def assets() -> Path:
    """Return the folder of real grippers and objects, or skip."""
    folder = os.environ.get("MEGRASP_ASSETS", "")
    if not folder or not Path(folder).is_dir():
        pytest.skip("MEGRASP_ASSETS is not set to a folder")
    return Path(folder)


@pytest.fixture
def no_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    """Render anew even what was rendered before."""
    monkeypatch.setenv("MEGRASP_CACHE", "off")


@pytest.fixture(scope="session")
def ray_cluster() -> Iterator[None]:
    """Start Ray on this machine, or skip; its workers find the helper modules of the tests."""
    ray = pytest.importorskip("ray", reason="ray is missing: pip install 'megrasp-core[ray]'")
    helpers = [str(SUPPORT), os.environ.get("PYTHONPATH", "")]
    before = signal.getsignal(signal.SIGTERM)
    ray.init(
        num_cpus=2,
        include_dashboard=False,
        log_to_driver=False,
        runtime_env={"env_vars": {"PYTHONPATH": os.pathsep.join(filter(None, helpers))}},
    )
    # Ray takes SIGTERM for itself, and the tests of other files share the process.
    signal.signal(signal.SIGTERM, before)
    yield
    ray.shutdown()
