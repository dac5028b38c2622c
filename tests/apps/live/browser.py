"""A headless Chromium for the tests, driven through chromedriver's plain HTTP.

The module needs only the standard library.
"""

import base64
import json
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.request import Request, urlopen

import pytest

FLAGS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run "
    "--disable-background-networking "
    "--disable-component-update --disable-sync --hide-scrollbars"
)
PACKAGES = "chromium chromium-driver"


@dataclass(frozen=True)
class Browser:
    """One window."""

    session: str

    def open(self, url: str) -> None:
        self._ask("POST", "/url", url=url)

    def run(self, script: str, *arguments: Any) -> Any:
        """Return the value of a script."""
        return self._ask("POST", "/execute/sync", script=script, args=arguments)

    def text(self, identity: str) -> str:
        """Return the visible text of the element with this id."""
        return str(self.run(f"return document.getElementById('{identity}').innerText"))

    def resized(self, width: int, height: int, scheme: str = "light") -> None:
        """A screen of so many pixels, light or dark, however small the window can be."""
        screen = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
        self._ask(
            "POST", "/goog/cdp/execute", cmd="Emulation.setDeviceMetricsOverride", params=screen
        )
        wish = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
        self._ask("POST", "/goog/cdp/execute", cmd="Emulation.setEmulatedMedia", params=wish)

    def until(
        self, script: str, expected: Callable[[Any], bool] = bool, seconds: float = 20.0
    ) -> Any:
        """Return the value of a script once it is the expected one."""
        end = time.monotonic() + seconds
        while not expected(answer := self.run(script)):
            assert time.monotonic() < end, f"{script}: {answer} after {seconds:g} s"
            time.sleep(0.05)
        return answer

    def screenshot(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(base64.b64decode(self._ask("GET", "/screenshot")))

    def complaints(self) -> list[str]:
        """Return the messages of the page's scripts and of the browser since the last call."""
        return [entry["message"] for entry in self._ask("POST", "/se/log", type="browser")]

    def _ask(self, method: str, path: str, **body: Any) -> Any:
        return ask(method, self.session + path, body)


def ask(method: str, url: str, body: dict[str, Any]) -> Any:
    request = Request(url, json.dumps(body).encode() if method == "POST" else None, method=method)
    with urlopen(request, timeout=60) as answer:
        return json.load(answer)["value"]


@contextmanager
def browser(folder: Path, width: int = 1280, height: int = 1000) -> Iterator[Browser]:
    """A new, empty browser.

    Where the package is missing the test fails with the sentence that names it.
    """
    chromium = shutil.which("chromium")
    driver = shutil.which("chromedriver")
    if not chromium or not driver:
        pytest.fail(
            "The page of lampest live is tested in Chromium; install it with: apt-get install "
            f"{PACKAGES}",
            pytrace=False,
        )
    words = [driver, "--port=0"]
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        try:
            base = f"http://127.0.0.1:{listening_port(process)}"
            arguments = [
                *FLAGS.split(),
                f"--user-data-dir={folder / 'browser'}",
                f"--window-size={width},{height}",
            ]
            capabilities = {
                "browserName": "chrome",
                "goog:chromeOptions": {"binary": chromium, "args": arguments},
                "goog:loggingPrefs": {"browser": "ALL"},
            }
            session = ask(
                "POST", f"{base}/session", {"capabilities": {"alwaysMatch": capabilities}}
            )["sessionId"]
            try:
                yield Browser(f"{base}/session/{session}")
            finally:
                with suppress(OSError):
                    ask("DELETE", f"{base}/session/{session}", {})
        finally:
            process.terminate()


def listening_port(process: "subprocess.Popen[str]") -> int:
    """The port that chromedriver says it was given."""
    for line in process.stdout:
        if "started successfully on port" in line:
            return int(line.rsplit(" ", 1)[1].strip().rstrip("."))
    pytest.fail("chromedriver ended before it listened", pytrace=False)
