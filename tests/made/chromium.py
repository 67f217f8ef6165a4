"""A headless Chromium that a test drives over its debugging pipe, with real mouse and keys."""

import fcntl
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

PROGRAM = shutil.which("chromium") or shutil.which("chromium-browser")
_PATIENCE_S = 60.0


class Chromium:
    """One page of a Chromium of its own; ``complaints`` holds console messages, ``fetched`` every address asked for."""

    def __init__(self, profile: Path) -> None:
        assert PROGRAM is not None
        theirs, self._out = os.pipe()
        self._in, back = os.pipe()
        command = [
            PROGRAM, "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run",
            "--disable-background-networking", f"--user-data-dir={profile}", "--window-size=1280,1600",
            "--remote-debugging-pipe", "about:blank",
        ]  # fmt: skip
        high = [fcntl.fcntl(one, fcntl.F_DUPFD, 64) for one in (theirs, back)]  # clear of 3 and 4, where it listens
        move = f"import os, sys; os.dup2({high[0]}, 3); os.dup2({high[1]}, 4); os.execv(sys.argv[1], sys.argv[1:])"
        self._program = subprocess.Popen(
            [sys.executable, "-S", "-c", move, *command],
            pass_fds=high, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        for one in high:
            os.close(one)
        os.close(theirs)
        os.close(back)
        self._number, self._rest, self._session = 0, b"", ""
        self.complaints: list[str] = []
        self.fetched: list[str] = []

    def __enter__(self) -> Self:
        try:
            self._attach()
        except BaseException:
            self._end()
            raise
        return self

    def _attach(self) -> None:
        target = self.ask("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.ask(f"{domain}.enable")

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._end()

    def _end(self) -> None:
        self._program.kill()
        self._program.wait()
        os.close(self._out)
        os.close(self._in)

    def ask(self, method: str, **given: Any) -> Any:
        """Answer to a command of the DevTools protocol; what happens meanwhile is kept."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": given}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            one = self._next()
            if one.get("id") == self._number:
                assert "error" not in one, one
                return one["result"]

    def _next(self) -> dict[str, Any]:
        until = time.monotonic() + _PATIENCE_S
        while b"\0" not in self._rest:
            assert time.monotonic() < until, "Chromium does not answer"
            read = os.read(self._in, 1 << 20)
            assert read, "Chromium ended"
            self._rest += read
        text, _, self._rest = self._rest.partition(b"\0")
        one: dict[str, Any] = json.loads(text)
        what, said = one.get("method", ""), one.get("params", {})
        if what in ("Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded"):
            self.complaints.append(json.dumps(said))
        elif what == "Network.requestWillBeSent":
            self.fetched.append(said["request"]["url"])
        return one

    def open(self, page: Path) -> None:
        """Open a ``page`` from disk and wait until it has loaded."""
        self.ask("Page.navigate", url=page.as_uri())
        until = time.monotonic() + _PATIENCE_S
        while self.value("document.readyState") != "complete":
            assert time.monotonic() < until
        self.settle()

    def value(self, expression: str) -> Any:
        """Value of a JavaScript ``expression`` in the page, awaited where it is a promise."""
        told = self.ask("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in told, told
        return told["result"].get("value")

    def settle(self) -> None:
        """Wait until what was asked to be drawn is drawn."""
        self.value("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))")

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        """A real mouse event of a ``kind`` such as ``mouseMoved`` at (``x``, ``y``) of the window."""
        self.ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)
        self.settle()

    def key(self, name: str) -> None:
        """A key pressed and let go, by its ``name`` in JavaScript."""
        text = {"text": name} if len(name) == 1 else {}
        self.ask("Input.dispatchKeyEvent", type="keyDown", key=name, code=name, **text)
        self.ask("Input.dispatchKeyEvent", type="keyUp", key=name, code=name)
        self.settle()
