"""The site is built without complaint and without network, the notebook runs."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
NOTEBOOK = ROOT / "docs" / "tutorial.ipynb"


class Fetched(HTMLParser):
    """Addresses that a browser fetches for a page, without those one can click."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag != "a":
            self.addresses |= {
                value for name, value in attrs if value and name in ("src", "href", "srcset")
            }


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("mkdocs", reason="mkdocs is missing: pip install 'megrasp-core[docs]'")
    folder = tmp_path_factory.mktemp("site")
    # A proxy that nobody listens at: whatever wants to fetch something fails.
    nowhere = {name: "http://127.0.0.1:9" for name in ("http_proxy", "https_proxy")}
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=ROOT, env=os.environ | nowhere | {"NO_MKDOCS_2_WARNING": "1"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.slow
def test_the_site_fetches_nothing_from_elsewhere(site: Path) -> None:
    pages = list(site.rglob("*.html"))
    assert len(pages) > 40
    for page in pages:
        found = Fetched()
        found.feed(page.read_text())
        outside = {address for address in found.addresses if re.match(r"(https?:)?//", address)}
        assert not outside, page


@pytest.mark.slow
def test_the_site_has_what_docstrings_and_help_say(site: Path) -> None:
    assert (
        "Draw grasps for a cloud, check and rank them."
        in (site / "reference/python/synthesizer.html").read_text()
    )
    assert "megrasp gripper score-wizard" in (site / "reference/cli.html").read_text()
    assert "SynthesizeGrasps.srv" in (site / "reference/ros.html").read_text()
    linked = (site / "results.html").read_text()
    assert "models/megrasp-bin/evaluation/binpick_robotiq_2f85.json" in linked
    assert (site / "models/megrasp-bin/evaluation/binpick_robotiq_2f85.json").is_file()
    start = (site / "index.html").read_text()
    assert 'href="ros.html"' in start and 'src="images/grasps.png"' in start, (
        "links of the README are turned"
    )


def test_the_notebook_is_kept_without_outputs() -> None:
    cells = json.loads(NOTEBOOK.read_text())["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert 5 <= len(code) <= 10
    assert all(not cell["outputs"] and cell["execution_count"] is None for cell in code)


@pytest.mark.slow
def test_the_notebook_lifts_an_object(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nbclient = pytest.importorskip("nbclient")
    nbformat = pytest.importorskip("nbformat")
    manager = pytest.importorskip("jupyter_client.manager")
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    # The interpreter that runs the tests, not a kernel that somebody has registered.
    kernel = manager.AsyncKernelManager(kernel_name="python3")
    kernel.kernel_spec.argv[0] = sys.executable
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    done = nbclient.NotebookClient(
        notebook, km=kernel, timeout=600, resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    outputs = [
        output for cell in done.cells if cell.cell_type == "code" for output in cell.outputs
    ]
    pictures = [output for output in outputs if "image/png" in output.get("data", {})]
    assert len(pictures) == 4
    said = "".join(output.get("text", "") for output in outputs)
    assert "lifted" in said, said
