"""A headless Chromium for tests of pages: the DevTools protocol over a pipe, without further libraries."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path
from urllib.parse import unquote

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
TIMEOUT_S = 60.0

KEY_CODES = {"Tab": 9, "Enter": 13, "Escape": 27, "Home": 36, "+": 187} | {
    f"Arrow{direction}": 37 + number for number, direction in enumerate(("Left", "Up", "Right", "Down"))
}

RECORD_VIOLATIONS = """
window.violations = [];
addEventListener("securitypolicyviolation", event =>
  window.violations.push(event.effectiveDirective + " " + event.blockedURI));
"""
"""Script that runs before a page: what its content security policy blocks."""

# The browser reads commands from file descriptor 3 and answers on 4.
_LAUNCH = (
    "import os, sys; read, write = (os.dup(int(number)) for number in sys.argv[1:3]); "
    "os.dup2(read, 30); os.dup2(write, 31); os.dup2(30, 3); os.dup2(31, 4); "
    "os.execvp(sys.argv[3], sys.argv[3:])"
)


def find_chromium() -> str | None:
    """Path of the browser, or None if there is none."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


class Browser:
    """One browser with one page.

    Args:
        profile: an empty folder for its files.
    """

    def __init__(self, profile: Path) -> None:
        read_commands, self._commands = os.pipe()
        self._answers, write_answers = os.pipe()
        arguments = [
            find_chromium(), "--headless=new", "--remote-debugging-pipe", "--no-first-run", "--disable-gpu",
            "--disable-dev-shm-usage", "--disable-background-networking", "--disable-component-update",
            "--disable-sync", "--hide-scrollbars", "--mute-audio", f"--user-data-dir={profile}",
            # Required as root, as in containers; the pages are our own.
            "--no-sandbox",
            # WebGL on machines without a graphics card.
            "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
        ]  # fmt: skip
        streams = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
        pipes = (read_commands, write_answers)
        command = [sys.executable, "-c", _LAUNCH, *map(str, pipes), *arguments]
        self._process = subprocess.Popen(command, pass_fds=pipes, **streams)
        os.close(read_commands)
        os.close(write_answers)
        self._number = 0
        self._messages: queue.Queue[dict] = queue.Queue()
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()
        self._session = None
        self._events: list[dict] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.call("Page.addScriptToEvaluateOnNewDocument", source=RECORD_VIOLATIONS)

    def close(self) -> None:
        """End the browser."""
        self._session = None
        try:
            self.call("Browser.close")
            self._process.wait(TIMEOUT_S)
        finally:
            self._process.kill()
            self._process.wait()
            self._listener.join(TIMEOUT_S)
            os.close(self._commands)
            os.close(self._answers)

    def call(self, method: str, **parameters) -> dict:
        """Send a command and wait for its result; events in between are kept."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._commands, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._messages.get(timeout=TIMEOUT_S)
            if answer.get("id") == self._number:
                assert "error" not in answer, f"{method}: {answer['error']}"
                return answer["result"]
            self._events.append(answer)

    def open(self, page: Path, width: int = 1280, height: int = 800, dark: bool = False) -> None:
        """Load a page from the disk without a network, and wait until it is complete."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **size)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        # Scroll without animation, which would be cut short on a busy machine.
        motion = {"name": "prefers-reduced-motion", "value": "reduce"}
        self.call("Emulation.setEmulatedMedia", media="", features=[scheme, motion])
        network = {"latency": 0, "downloadThroughput": -1, "uploadThroughput": -1}
        self.call("Network.emulateNetworkConditions", offline=True, **network)
        self._events.clear()
        self.call("Page.navigate", url=page.resolve().as_uri())
        while not self.events("Page.loadEventFired"):
            self._events.append(self._messages.get(timeout=TIMEOUT_S))

    def events(self, method: str) -> list[dict]:
        """The events of a kind since the page was opened."""
        return [event["params"] for event in self._events if event.get("method") == method]

    def assert_quiet(self, page: Path, allowed: tuple[str, ...] = ()) -> None:
        """The page has requested only itself, without errors, blocked content and further log entries."""
        urls = (event["request"]["url"] for event in self.events("Network.requestWillBeSent"))
        requested = {unquote(url.partition(",")[0]) for url in urls if not url.startswith("data:")}
        assert requested == {f"file://{page.resolve()}"}
        assert self.events("Runtime.exceptionThrown") == self.events("Runtime.consoleAPICalled") == []
        entries = [event["entry"] for event in self.events("Log.entryAdded")]
        assert [entry for entry in entries if entry["source"] not in allowed] == []
        assert self.run("window.violations") == []

    def run(self, script: str):
        """The value of a JavaScript expression; promises are awaited."""
        done = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in done, done
        return done["result"].get("value")

    def wait_until(self, script: str) -> None:
        """Wait for a JavaScript expression to become true."""
        end = time.monotonic() + TIMEOUT_S
        while not self.run(script):
            assert time.monotonic() < end, f"never true: {script}"
            time.sleep(0.05)

    def press(self, key: str) -> None:
        """Press and release a key, or a letter or digit."""
        code = KEY_CODES.get(key) or ord(key.upper())
        event = {"key": key, "code": key, "windowsVirtualKeyCode": code}
        if key == "Enter" or len(key) == 1:
            event["text"] = "\r" if key == "Enter" else key
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, **event)

    def click(self, selector: str) -> None:
        """Scroll to an element and click into its centre, once it no longer moves."""
        element = f"document.querySelector({selector!r})"
        self.wait_until(f"!!{element} && {element}.getClientRects().length > 0")
        x, y = self.run(
            f"""(async () => {{
              const element = {element};
              element.scrollIntoView({{block: "center", behavior: "instant"}});
              const drawn = () => new Promise(
                next => requestAnimationFrame(() => requestAnimationFrame(next)));
              for (let before = null; ; ) {{
                await drawn();
                const box = element.getBoundingClientRect();
                const centre = [box.x + box.width / 2, box.y + box.height / 2];
                if (before && before[0] === centre[0] && before[1] === centre[1]) return centre;
                before = centre;
              }}
            }})()"""
        )
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Move the mouse from a point of the window to another with the left button down."""
        event = {"button": "left", "clickCount": 1}
        self.call("Input.dispatchMouseEvent", type="mousePressed", x=start[0], y=start[1], **event)
        self.move(*end, button="left", buttons=1)
        self.call("Input.dispatchMouseEvent", type="mouseReleased", x=end[0], y=end[1], **event)

    def move(self, x: float, y: float, **buttons) -> None:
        """Move the mouse to a point of the window."""
        self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y, **buttons)

    def _listen(self) -> None:
        """Read messages, which end with a zero byte."""
        rest = b""
        while True:
            part = b""
            with contextlib.suppress(OSError):
                part = os.read(self._answers, 1 << 16)
            if not part:
                return
            *messages, rest = (rest + part).split(b"\0")
            for message in messages:
                self._messages.put(json.loads(message))
