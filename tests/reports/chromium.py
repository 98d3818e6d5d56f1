"""A real Chromium that tests drive over its debugging pipe: pages, keys, sizes, screenshots, and what they ask for."""

import base64
import json
import os
import select
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
_PATIENCE_S = 60.0
_STARTER = """
import fcntl, os, sys
ends = [fcntl.fcntl(int(end), fcntl.F_DUPFD, 10) for end in sys.argv[1:3]]  # Away from 3 and 4
for number, end in zip((3, 4), ends):  # Where the browser looks for its pipe
    os.dup2(end, number)
os.execv(sys.argv[3], sys.argv[3:])
"""


@dataclass
class Tab:
    """One page, at a size of its own. `console`: its messages and errors; `asked`: addresses beside its own file."""

    _browser: "Chromium"
    _session: str
    console: list[str] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)

    def send(self, method: str, **params: Any) -> Any:
        """Call a method of the DevTools protocol, and return its result."""
        return self._browser.call(method, params, self._session)

    def open(self, page: Path) -> None:
        """Load a page, and wait until its scripts are done."""
        self.send("Page.navigate", url=page.as_uri())
        self.wait("document.readyState === 'complete'")

    def run(self, script: str) -> Any:
        """Evaluate an expression in the page, and return its value as JSON. AssertionError where it throws."""
        done = self.send("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True, userGesture=True)
        assert "exceptionDetails" not in done, done["exceptionDetails"]
        return done["result"].get("value")

    def wait(self, condition: str) -> None:
        """Wait until an expression is true."""
        end = time.monotonic() + _PATIENCE_S
        while not self.run(f"Boolean({condition})"):
            assert time.monotonic() < end, f"never true: {condition}"
            time.sleep(0.02)

    def resize(self, width: int, height: int = 900, dark: bool = False) -> None:
        """Give the page a size [px] and a color scheme."""
        narrow = width < 600
        self.send("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=narrow)
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.send("Emulation.setEmulatedMedia", features=scheme)

    def press(self, key: str) -> None:
        """Press a key, such as `Tab` or `ArrowRight`."""
        for kind in ("keyDown", "keyUp"):
            self.send("Input.dispatchKeyEvent", type=kind, key=key, code=key)

    def shoot(self, out: Path, whole: bool = False) -> None:
        """Write a screenshot of what is seen, or of the whole page."""
        shot = self.send("Page.captureScreenshot", captureBeyondViewport=whole)
        out.write_bytes(base64.b64decode(shot["data"]))


class Chromium:
    """A running browser."""

    def __init__(self, process: subprocess.Popen[bytes], into: int, out: int) -> None:
        self._process, self._into, self._out, self._number, self._rest = process, into, out, 0, b""
        self._tabs: dict[str, Tab] = {}

    def tab(self, width: int = 1280, dark: bool = False) -> Tab:
        """Open an empty page."""
        target = self.call("Target.createTarget", {"url": "about:blank"})["targetId"]
        session = self.call("Target.attachToTarget", {"targetId": target, "flatten": True})["sessionId"]
        tab = self._tabs[session] = Tab(self, session)
        for domain in ("Page", "Runtime", "Network", "Log"):
            tab.send(f"{domain}.enable")
        tab.resize(width, dark=dark)
        return tab

    def call(self, method: str, params: dict[str, Any], session: str | None = None) -> Any:
        """Call a method, and note what happened meanwhile."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": params} | ({"sessionId": session} if session else {})
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self._into, data) :]
        for answer in self._messages():
            if answer.get("id") == self._number:
                assert "error" not in answer, answer["error"]
                return answer["result"]
            self._note(answer)
        raise AssertionError("the browser ended")

    def _messages(self) -> Iterator[dict[str, Any]]:
        end = time.monotonic() + _PATIENCE_S
        while True:
            while b"\0" in self._rest:
                message, _, self._rest = self._rest.partition(b"\0")
                yield json.loads(message)
            assert select.select([self._out], [], [], max(0.0, end - time.monotonic()))[0], "the browser doesn't answer"
            if not (part := os.read(self._out, 1 << 20)):
                return
            self._rest += part

    def _note(self, event: dict[str, Any]) -> None:
        tab, params = self._tabs.get(event.get("sessionId", "")), event.get("params", {})
        if tab is None:
            return
        match event["method"]:
            case "Runtime.consoleAPICalled":
                tab.console.append(" ".join(str(arg.get("value", arg.get("description"))) for arg in params["args"]))
            case "Runtime.exceptionThrown":
                details = params["exceptionDetails"]
                tab.console.append(str(details.get("exception", {}).get("description", details["text"])))
            case "Log.entryAdded":
                tab.console.append(params["entry"]["text"])
            case "Network.requestWillBeSent":
                if not (url := params["request"]["url"]).startswith(("file:", "data:", "blob:", "about:")):
                    tab.asked.append(url)


@contextmanager
def start(scratch: Path) -> Iterator[Chromium]:
    """Run a browser with a profile in `scratch`; the test is skipped where none is installed."""
    if BROWSER is None:
        pytest.skip("no chromium, chromium-browser or google-chrome is installed")
    command = [
        BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
        "--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage",
        f"--user-data-dir={scratch / 'profile'}", "--remote-debugging-pipe",
    ]  # fmt: skip
    (read, into), (out, write) = os.pipe(), os.pipe()
    starter = [sys.executable, "-c", _STARTER, str(read), str(write), *command]
    environment = {**os.environ, "HOME": str(scratch)}
    with subprocess.Popen(
        starter, pass_fds=(read, write), env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        os.close(read)
        os.close(write)
        browser = Chromium(process, into, out)
        try:
            yield browser
        finally:
            process.kill()
            os.close(into)
            os.close(out)
