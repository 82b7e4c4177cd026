"""The real Rerun viewer without a display, listening on loopback only, in a window of any size and either theme."""

import contextlib
import json
import os
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import rerun_cli
from rerun.experimental import ViewerClient

from adagmm_fusion.errors import OutputError, RecordingError
from adagmm_fusion.files.input_file import check_input
from adagmm_fusion.rerun_log.streams import LOOPBACK, free_port

Theme = Literal["dark", "light"]
THEMES: tuple[Theme, ...] = ("dark", "light")

RERUN = Path(rerun_cli.__file__).parent / "rerun"
STARTING_SECONDS = LOADING_SECONDS = 120.0
SECONDS_BETWEEN_LOOKS = 0.1
MCP_VERSION = "2025-03-26"
# What the client raises of a viewer that is gone, or that a busy machine keeps from answering.
NO_ANSWER = (ConnectionError, TimeoutError)


@contextlib.contextmanager
def headless_viewer(
    path: Path, *, size: tuple[int, int] = (1280, 720), theme: Theme | None = None
) -> Iterator[ViewerClient]:
    """The viewer with a recording loaded, ended with the block.

    size : (width, height) of its window.    theme : None for what it opens with.

    Raises
    ------
    RecordingError  if the file is not there or does not load.
    OutputError  if the viewer cannot be started, or no longer answers.
    """
    check_input(Path(path), RecordingError, missing="no such Rerun recording")
    port = free_port()
    # The SDK's own `spawn` would listen on every interface.
    command = [str(RERUN), "--headless", "--bind", LOOPBACK, "--port", str(port), "--hide-welcome-screen"]
    command += ["--window-size", f"{size[0]}x{size[1]}"]
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    try:
        process = subprocess.Popen(command, env={"RUST_LOG": "error"} | dict(os.environ), **quiet)
    except OSError as error:
        raise OutputError(f"rerun viewer: could not be started: {error}") from error
    try:
        viewer = _connected(process, port)
        viewer.open(str(path))
        give_up = time.monotonic() + LOADING_SECONDS
        while viewer.get_state().loading:
            if time.monotonic() > give_up:
                raise RecordingError(f"{path}: still loading after {LOADING_SECONDS:g} s")
            time.sleep(SECONDS_BETWEEN_LOOKS)
        if theme is not None:
            choose_theme(viewer, theme, port)
        yield viewer
    except NO_ANSWER as error:
        raise OutputError(f"rerun viewer: no answer: {first_line(error)}") from error
    finally:
        process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(timeout=5.0)
        process.kill()
        process.wait()


def _connected(process: subprocess.Popen, port: int) -> ViewerClient:
    give_up = time.monotonic() + STARTING_SECONDS
    while process.poll() is None and time.monotonic() < give_up:
        try:
            viewer = ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy")
            viewer.get_state()
        except (*NO_ANSWER, RuntimeError):
            time.sleep(SECONDS_BETWEEN_LOOKS)
        else:
            return viewer
    why = f"still silent after {STARTING_SECONDS:g} s" if process.poll() is None else f"ended with {process.poll()}"
    raise OutputError(f"rerun viewer: could not be started: {why}; it needs a Vulkan driver (mesa-vulkan-drivers)")


def first_line(error: BaseException) -> str:
    """What the error says, less what the viewer writes below it."""
    return str(error).split("\n")[0] or type(error).__name__


def choose_theme(viewer: ViewerClient, theme: Theme, port: int) -> None:
    """Click on the theme in the settings: the viewer takes it from nowhere else. Raises OutputError if it has none."""
    shown = viewer.get_location()
    viewer.run_command("ui.open_settings")
    with _tools(port) as call:
        call("wait_for", content_contains=theme.capitalize())
        call("click", content_contains=theme.capitalize())
        viewer.set_location(shown)
        call("hover", pos={"x": 1.0, "y": 1.0})  # else what lies under the pointer would look pointed at


@contextlib.contextmanager
def _tools(port: int) -> Iterator[Any]:
    """What presses the viewer's buttons: `rerun viewer-mcp`, one JSON message a line."""
    command = [str(RERUN), "viewer-mcp", "--endpoint", f"http://{LOOPBACK}:{port}"]
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command, text=True, **pipes) as process:

        def send(**message: Any) -> None:
            process.stdin.write(json.dumps({"jsonrpc": "2.0"} | message) + "\n")
            process.stdin.flush()

        def ask(method: str, params: dict[str, Any]) -> dict[str, Any]:
            send(id=method, method=method, params=params)
            for line in process.stdout:
                answer = json.loads(line)
                if answer.get("id") == method:
                    return answer
            raise OutputError("rerun viewer-mcp: ended without an answer")

        def call(tool: str, **arguments: Any) -> None:
            answer = ask("tools/call", {"name": tool, "arguments": arguments})
            if "error" in answer or answer["result"].get("isError"):
                raise OutputError(f"rerun viewer: {tool} {arguments}: {answer.get('error') or answer['result']}")

        try:
            client = {"name": "adagmm-fusion", "version": "1"}
            ask("initialize", {"protocolVersion": MCP_VERSION, "capabilities": {}, "clientInfo": client})
            send(method="notifications/initialized")
            yield call
        finally:
            process.terminate()
