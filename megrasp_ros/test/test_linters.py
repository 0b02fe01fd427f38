"""The linters of ROS packages, where they are installed."""

from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[1]
SOURCES = [str(PACKAGE / name) for name in ("megrasp_ros", "test", "setup.py")]

# Those of ament_pep257 itself, and what ruff.toml leaves out.
DOCSTRINGS = [
    *("D100", "D101", "D102", "D103", "D104", "D105", "D106", "D107", "D203", "D212", "D404"),
    *("D205", "D213", "D400", "D401", "D402", "D406", "D407", "D413", "D415"),
]


@pytest.mark.linter
@pytest.mark.flake8
def test_flake8() -> None:
    main = pytest.importorskip("ament_flake8.main")
    code, errors = main.main_with_errors(
        argv=["--config", str(PACKAGE / "test" / "flake8.ini"), *SOURCES]
    )
    assert code == 0, "\n".join(errors)


@pytest.mark.linter
@pytest.mark.pep257
def test_pep257() -> None:
    main = pytest.importorskip("ament_pep257.main")
    assert main.main(argv=["--ignore", *DOCSTRINGS, "--", *SOURCES]) == 0
