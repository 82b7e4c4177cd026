"""Headless Chromium, driven through its debugging pipe, for tests of what a browser shows."""

import base64
import contextlib
import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--no-first-run",
    "--disable-gpu",
    "--disable-quic",
    "--disable-sync",
    "--disable-background-networking",
    "--disable-component-update",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--window-size=1400,900",
    "--remote-debugging-pipe",
)


def find_browser() -> str | None:
    return next((path for path in map(shutil.which, NAMES) if path), None)


class Page:
    """One page; commands and events are JSON messages, each ended by a zero byte."""

    def __init__(self, commands: int, answers: int):
        self._commands, self._answers, self._received, self._last_id = commands, answers, b"", 0
        self._session = None
        target = self.command("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.command("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]

    def open(self, url: str) -> None:
        self.command("Page.navigate", url=url)

    def screenshot(self) -> np.ndarray:
        """(H, W, 3) uint8 RGB."""
        png = base64.b64decode(self.command("Page.captureScreenshot")["data"])
        return cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)[:, :, ::-1]

    def command(self, method: str, **params) -> dict:
        """Send a command and wait for its answer; events meanwhile are dropped."""
        self._last_id += 1
        message = {"id": self._last_id, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._commands, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._next()
            if answer.get("id") == self._last_id:
                assert "error" not in answer, (method, answer["error"])
                return answer["result"]

    def _next(self) -> dict:
        while b"\0" not in self._received:
            chunk = os.read(self._answers, 1 << 20)
            assert chunk, "the browser ended"
            self._received += chunk
        message, self._received = self._received.split(b"\0", 1)
        return json.loads(message)


@contextlib.contextmanager
def browser_page(executable: str, profile: Path) -> Iterator[Page]:
    """A page of a fresh browser, ended with the block."""
    read_commands, commands = os.pipe()
    answers, write_answers = os.pipe()

    def connect():  # Chromium reads commands from descriptor 3 and writes answers to 4
        a, b = os.dup(read_commands), os.dup(write_answers)
        os.dup2(a, 3)
        os.dup2(b, 4)

    process = subprocess.Popen(
        [executable, *FLAGS, f"--user-data-dir={profile}"],
        preexec_fn=connect,
        close_fds=False,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(read_commands)
    os.close(write_answers)
    try:
        yield Page(commands, answers)
    finally:
        process.terminate()
        process.wait(timeout=20)
        os.close(commands)
        os.close(answers)
