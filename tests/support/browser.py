"""A headless Chromium, driven over its own debugging protocol."""

from __future__ import annotations

import base64
import contextlib
import itertools
import json
import shutil
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome")
ARGUMENTS = (
    "--headless=new", "--no-sandbox", "--no-first-run", "--hide-scrollbars",
    "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--remote-debugging-port=0",
)  # fmt: skip
PATIENCE = 120.0


def chromium() -> str | None:
    """Path of the program, None where there is none."""
    return next(filter(None, map(shutil.which, NAMES)), None)


class Page:
    """One open page."""

    def __init__(self, socket: Any) -> None:
        self._socket, self._ids = socket, itertools.count(1)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command and wait for its answer."""
        number = next(self._ids)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=PATIENCE))
            if answer.get("id") == number:
                return answer["result"]

    def evaluate(self, script: str) -> Any:
        """The value of a JavaScript expression."""
        found = self.call("Runtime.evaluate", expression=script, returnByValue=True)
        return found["result"].get("value")

    def text(self) -> str:
        """What can be read on the page."""
        return str(self.evaluate("document.body ? document.body.innerText : ''"))

    def press(self, label: str) -> bool:
        """Click the button with this label; returns whether there is one."""
        script = (
            "(() => {const b = [...document.querySelectorAll('button')]"
            f".find(b => b.innerText.trim() === {json.dumps(label)});"
            "if (!b) return false; b.click(); return true;})()"
        )
        return bool(self.evaluate(script))

    def picture(self) -> bytes:
        """PNG of what is shown."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])


def eventually(what: Callable[[], Any], patience: float = PATIENCE) -> Any:
    """The first true value of `what`, or the last one after so many seconds."""
    end = time.monotonic() + patience
    while not (value := what()) and time.monotonic() < end:
        time.sleep(0.2)
    return value


@contextlib.contextmanager
def opened(url: str, size: tuple[int, int] = (1400, 900)) -> Iterator[Page]:
    """A page at an address; the browser ends with the block."""
    from websockets.sync.client import connect

    program = chromium()
    assert program is not None
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        own = (f"--user-data-dir={folder}", f"--window-size={size[0]},{size[1]}")
        process = subprocess.Popen(
            [program, *ARGUMENTS, *own, url],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            file = Path(folder) / "DevToolsActivePort"
            assert eventually(lambda: file.is_file() and file.read_text().count("\n") > 0)
            port = file.read_text().split()[0]

            def page() -> dict[str, Any] | None:
                with urllib.request.urlopen(f"http://127.0.0.1:{port}/json", timeout=30) as answer:
                    pages = json.loads(answer.read())
                return next((one for one in pages if one["type"] == "page"), None)

            address = eventually(page)["webSocketDebuggerUrl"]
            with connect(address, max_size=None) as socket:
                yield Page(socket)
        finally:
            process.terminate()
            process.wait(timeout=30)
