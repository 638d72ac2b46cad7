"""A headless Chromium to look at pages with: the DevTools protocol over a pipe, without further libraries."""

from __future__ import annotations

import base64
import json
import os
import queue
import shutil
import subprocess
import sys
import threading
import time
from pathlib import Path

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
PATIENCE_S = 60.0

# The browser reads commands from descriptor 3 and answers on 4.
_LAUNCH = (
    "import os, sys; read, write = (os.dup(int(number)) for number in sys.argv[1:3]); "
    "os.dup2(read, 30); os.dup2(write, 31); os.dup2(30, 3); os.dup2(31, 4); "
    "os.execvp(sys.argv[3], sys.argv[3:])"
)


def chromium() -> str | None:
    """Path of the browser, or None where there is none."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


class Browser:
    """One browser with one page.

    Args:
        profile: an empty folder for what it writes.
    """

    def __init__(self, profile: Path) -> None:
        read_commands, self._commands = os.pipe()
        self._answers, write_answers = os.pipe()
        arguments = [
            chromium(), "--headless=new", "--remote-debugging-pipe", "--no-first-run", "--disable-gpu",
            "--disable-dev-shm-usage", "--disable-background-networking", "--disable-component-update",
            "--disable-sync", "--hide-scrollbars", "--mute-audio", f"--user-data-dir={profile}",
            # As root, as in containers, it does not start otherwise; the pages are our own.
            "--no-sandbox",
        ]  # fmt: skip
        launch = [sys.executable, "-c", _LAUNCH, str(read_commands), str(write_answers), *arguments]
        self._process = subprocess.Popen(
            launch,
            pass_fds=(read_commands, write_answers),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(read_commands)
        os.close(write_answers)
        self._number = 0
        self._messages: queue.Queue[dict] = queue.Queue()
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()
        self._session = None
        self.events: list[dict] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")

    def close(self) -> None:
        """End the browser."""
        self._session = None
        try:
            self.call("Browser.close")
            self._process.wait(PATIENCE_S)
        finally:
            self._process.kill()
            self._process.wait()
            self._listener.join(PATIENCE_S)
            os.close(self._commands)
            os.close(self._answers)

    def call(self, method: str, **parameters) -> dict:
        """Send a command and wait for its result; events that come before it are kept."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._commands, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._messages.get(timeout=PATIENCE_S)
            if answer.get("id") == self._number:
                assert "error" not in answer, f"{method}: {answer['error']}"
                return answer["result"]
            self.events.append(answer)

    def open(
        self, page: Path, width: int = 1280, height: int = 800, dark: bool = False, offline: bool = True
    ) -> None:
        """Load a page from the disk, and wait until all of it is there."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        # Leaps to a place are taken at once: a glide can be cut short on a machine with much to do.
        motion = {"name": "prefers-reduced-motion", "value": "reduce"}
        self.call("Emulation.setEmulatedMedia", media="", features=[scheme, motion])
        self.call(
            "Network.emulateNetworkConditions",
            offline=offline,
            latency=0,
            downloadThroughput=-1,
            uploadThroughput=-1,
        )
        self.events.clear()
        self.call("Page.navigate", url=page.resolve().as_uri())
        while not self.told("Page.loadEventFired"):
            self.events.append(self._messages.get(timeout=PATIENCE_S))

    def told(self, method: str) -> list[dict]:
        """The events of a kind since the page was opened."""
        return [event["params"] for event in self.events if event.get("method") == method]

    def run(self, script: str):
        """The value of a JavaScript expression; promises are awaited."""
        done = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in done, done
        return done["result"].get("value")

    def until(self, script: str) -> None:
        """Wait for a JavaScript expression to become true."""
        end = time.monotonic() + PATIENCE_S
        while not self.run(script):
            assert time.monotonic() < end, f"never true: {script}"
            time.sleep(0.05)

    def press(self, key: str) -> None:
        """Press a key and let it go."""
        codes = {
            "ArrowLeft": 37,
            "ArrowUp": 38,
            "ArrowRight": 39,
            "ArrowDown": 40,
            "Escape": 27,
            "Enter": 13,
            "Tab": 9,
        }
        text = {"text": "\r"} if key == "Enter" else {}
        for kind in ("keyDown", "keyUp"):
            self.call(
                "Input.dispatchKeyEvent",
                type=kind,
                key=key,
                code=key,
                windowsVirtualKeyCode=codes[key],
                **text,
            )

    def click(self, selector: str) -> None:
        """Click with the mouse on the middle of an element, once it lies there for two pictures on end."""
        found = f"document.querySelector({selector!r})"
        self.until(f"!!{found} && {found}.getClientRects().length > 0")
        place = self.run(
            f"""(async () => {{
              const one = {found};
              one.scrollIntoView({{block: "center", behavior: "instant"}});
              const drawn = () => new Promise(
                next => requestAnimationFrame(() => requestAnimationFrame(next)));
              for (let before = null; ; ) {{
                await drawn();
                const box = one.getBoundingClientRect();
                const place = [box.x + box.width / 2, box.y + box.height / 2];
                if (before && before[0] === place[0] && before[1] === place[1]) return place;
                before = place;
              }}
            }})()"""
        )
        for kind in ("mousePressed", "mouseReleased"):
            self.call(
                "Input.dispatchMouseEvent", type=kind, x=place[0], y=place[1], button="left", clickCount=1
            )

    def screenshot(self, path: Path, whole: bool = False) -> None:
        """Write what is seen, or the whole page, as a PNG file."""
        data = self.call("Page.captureScreenshot", captureBeyondViewport=whole)["data"]
        path.write_bytes(base64.b64decode(data))

    def _listen(self) -> None:
        """Messages end with a zero byte."""
        rest = b""
        while True:
            try:
                part = os.read(self._answers, 1 << 16)
            except OSError:
                return
            if not part:
                return
            *whole, rest = (rest + part).split(b"\0")
            for message in whole:
                self._messages.put(json.loads(message))
