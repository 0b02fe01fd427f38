"""What the site has besides docs/*.md: pages of other folders, and references made from the code.
A hook of MkDocs.

Links in all pages are those of the repository, so that they work where it is read; here they are
turned into links of the site. What the site does not have becomes text.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import posixpath
import re
from collections.abc import Iterator
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[1]
ELSEWHERE = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "models/README.md": "models.md",
    "docker/README.md": "docker.md",
}
"""Pages of the repository that the site has under other names."""
PACKAGES = (
    "synthesizer", "pointcloud", "grippers", "ranking", "network", "diffusion", "simulation",
    "cell.robot_cell", "objects", "library", "scenes", "storage", "training",
    "evaluation.protocols", "evaluation.report", "drawing.grasp_picture", "service", "viewer",
    "jobs", "lie", "errors",
)  # fmt: skip
"""What the Python reference shows, in the order in which a user meets it."""
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s#]*)(#[^)\s]*)?\)")
CODE = re.compile(r"(^```.*?^```)", re.DOTALL | re.MULTILINE)
SHOWN = (".png", ".json")
"""Files of other folders that the site holds where a page links to them."""
TYPES = ("msg", "srv", "action")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Put the pages of the packages under that of Python."""
    for _, pages in (entry for part in config.nav or () for entry in part.items()):
        for number, part in enumerate(pages if isinstance(pages, list) else ()):
            if part == {"Python": "reference/python.md"}:
                below = [{name: f"reference/python/{name}.md"} for name in PACKAGES]
                pages[number] = {"Python": ["reference/python.md", *below]}
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that do not lie in docs/, pictures and results that pages link to."""
    made = {site: (ROOT / source).read_text() for source, site in ELSEWHERE.items()}
    made |= {
        "reference/cli.md": commands(),
        "reference/python.md": python_index(),
        **{f"reference/python/{name}.md": python_page(name) for name in PACKAGES},
        "reference/ros.md": interfaces(),
        "tutorial.md": tutorial(ROOT / "docs" / "tutorial.ipynb"),
    }
    for site, text in made.items():
        files.append(File.generated(config, site, content=text))
    for file in list(files.documentation_pages()):
        for _, _, target, _ in LINK.findall(file.content_string):
            source = in_repository(file.src_uri, target)
            wanted = source.endswith(SHOWN) and not source.startswith("docs/")
            if wanted and (ROOT / source).is_file() and files.get_file_from_path(source) is None:
                files.append(File.generated(config, source, abs_src_path=str(ROOT / source)))
    return files


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn the links of the repository into those of the site."""
    here = page.file.src_uri
    # Made of the code: their links are the site's.
    if here.startswith("reference/") or here == "tutorial.md":
        return markdown

    def turned(found: re.Match[str]) -> str:
        mark, text, target, anchor = found.groups(default="")
        if not target or "://" in target or target.startswith("mailto:"):
            return found[0]
        source = in_repository(here, target)
        site = ELSEWHERE.get(source, source.removeprefix("docs/"))
        site = {"README.md": "index.md", "tutorial.ipynb": "tutorial.md"}.get(site, site)
        if files.get_file_from_path(site) is None:
            return text if source in text else f"{text} (`{source}`)"
        return f"{mark}[{text}]({posixpath.relpath(site, posixpath.dirname(here) or '.')}{anchor})"

    # Every other part is code.
    parts = CODE.split(markdown)
    parts[::2] = [LINK.sub(turned, part) for part in parts[::2]]
    return "".join(parts)


def in_repository(page: str, target: str) -> str:
    """Path in the repository of what a page of the site links to."""
    source = next((path for path, site in ELSEWHERE.items() if site == page), f"docs/{page}")
    return posixpath.normpath(posixpath.join(posixpath.dirname(source), target))


def commands() -> str:
    """What `--help` says of every command."""
    from megrasp_core.cli.commands import COMMANDS, app

    text = [
        "# Commands",
        "",
        "What `megrasp COMMAND --help` says. [The command line](../cli.md) has the rest.",
        "",
    ]
    with columns(100):
        for name, entry in COMMANDS.items():
            for member in [""] if not isinstance(entry, tuple) else entry[1]:
                words = [name, *filter(None, [member])]
                said = io.StringIO()
                with contextlib.redirect_stdout(said), contextlib.suppress(SystemExit):
                    app().cli(prog="megrasp", args=[*words, "--help"])
                text += [
                    f"## megrasp {' '.join(words)}",
                    "",
                    "```text",
                    said.getvalue().strip("\n"),
                    "```",
                    "",
                ]
    return "\n".join(text)


@contextlib.contextmanager
def columns(count: int) -> Iterator[None]:
    """Within, help texts are so wide."""
    before = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = str(count)
    try:
        yield
    finally:
        del os.environ["COLUMNS"]
        if before is not None:
            os.environ["COLUMNS"] = before


def python_index() -> str:
    """The list of packages in the reference."""
    import importlib

    rows = ["# Python", "", "| package | |", "| --- | --- |"]
    for name in PACKAGES:
        says = (
            (importlib.import_module(f"megrasp_core.{name}").__doc__ or "")
            .split("\n\n")[0]
            .replace("\n", " ")
        )
        rows.append(f"| [`megrasp_core.{name}`](python/{name}.md) | {says} |")
    return "\n".join(rows) + "\n"


def python_page(name: str) -> str:
    """The page of a package, which mkdocstrings fills."""
    options = "    options:\n      show_root_heading: false\n"
    return f"# megrasp_core.{name}\n\n::: megrasp_core.{name}\n{options}"


def interfaces() -> str:
    """The ROS interfaces, whose comments are their documentation."""
    folder = ROOT / "ros2_ws" / "src" / "megrasp_msgs"
    text = [
        "# ROS interfaces",
        "",
        "Package `megrasp_msgs`. [ROS](../ros.md) says who offers what.",
        "",
    ]
    for kind in TYPES:
        for file in sorted((folder / kind).glob(f"*.{kind}")):
            text += [f"## {file.name}", "", "```text", file.read_text().strip("\n"), "```", ""]
    return "\n".join(text)


def tutorial(notebook: Path) -> str:
    """The cells of the notebook."""
    parts = []
    for cell in json.loads(notebook.read_text())["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
    return "\n\n".join(parts) + "\n"
