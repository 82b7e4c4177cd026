"""Where a recording goes: the `--save`, `--connect`, `--serve`, `--headless`, `--stdout` that Rerun users know."""

import argparse
import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.parse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import rerun as rr

from adagmm_fusion.errors import OutputError
from adagmm_fusion.files.atomic_file import check_output_file, replacing
from adagmm_fusion.processes.interruption import Terminated, exit_code, heard_afterwards, signals_as_interrupts
from adagmm_fusion.rerun_log.words import shown

APPLICATION_ID = "adagmm_fusion"
LOOPBACK = "127.0.0.1"
VIEWER_PORT = 9876
VIEWER_URL = f"rerun+http://{LOOPBACK}:{VIEWER_PORT}/proxy"
CONNECT_SECONDS = 5.0
SERVER_START_SECONDS = 20.0
FLUSH_SECONDS = 120.0
LEAST_ROOM_BYTES = 1 << 20  # the SDK waits for ever where there is no room for a file's beginning


def check_destination(args: argparse.Namespace) -> None:
    """Before the work: whether what is logged can go where `args` say, as far as that can be known.

    Raises
    ------
    OutputError  if --save names no file that can be written, or --port no port.
    """
    if args.save is not None:
        check_output_file(args.save)
        try:
            os.fspath(args.save).encode()
        except UnicodeEncodeError as error:
            wanted = "expected a name in UTF-8 for a Rerun recording"
            raise OutputError(
                f"{args.save}: {wanted}; give another --save, or --no-rerun where there is that"
            ) from error
    if args.port is not None and not 0 <= args.port < 1 << 16:
        raise OutputError(f"--port: expected a number from 0 to 65535, got {args.port}")


@contextlib.contextmanager
def open_stream(
    args: argparse.Namespace, name: str, blueprint: Any = None, *, kind: str = ""
) -> Iterator[rr.RecordingStream]:
    """A recording stream that goes where `args` say, closed at the end so that a file has its footer.

    A file is written beside its final name and moved there when it is complete. With `--serve` this blocks at the end,
    until Ctrl-C, as Rerun's own scripts do. Without a destination what is logged is dropped.

    kind : what the recording is of, where that has another blueprint; the viewer has one for all recordings of a kind.

    Raises
    ------
    OutputError  if the file cannot be written, the server not started, or the viewer not reached.
    """
    with heard_afterwards():  # one that is half made prints a traceback when it is thrown away
        rec = rr.RecordingStream("_".join(filter(None, (APPLICATION_ID, kind))))
    rec.send_recording_name(shown(name))
    with contextlib.ExitStack() as stack:
        if args.stdout:
            rec.stdout(default_blueprint=blueprint)
        elif args.serve:
            url, server = stack.enter_context(_serve_on_loopback(args.port))
            rec.connect_grpc(url, default_blueprint=blueprint)
        elif args.connect or args.url:
            _connect(rec, args.url or VIEWER_URL, blueprint)
        elif args.save is not None:
            partial = stack.enter_context(_with_room(Path(args.save)))
            try:
                rec.save(partial, default_blueprint=blueprint)
            except RuntimeError as error:
                raise OutputError(f"{args.save}: cannot be written: {error}") from error
        try:
            yield rec
        finally:
            _close(rec)
        if args.serve:
            _wait_for_interrupt(server)


def _connect(rec: rr.RecordingStream, url: str, blueprint: Any) -> None:
    """Connect to a viewer that is there: the SDK itself would wait for one for ever."""
    try:
        address = urllib.parse.urlsplit(url)
        host, port = address.hostname or LOOPBACK, address.port or VIEWER_PORT
        with socket.create_connection((host, port), timeout=CONNECT_SECONDS):
            pass
        rec.connect_grpc(url, default_blueprint=blueprint)
    except OSError as error:
        raise OutputError(
            f"{url}: no viewer answers ({error.strerror or error}); start one with `rerun`, or use --save FILE.rrd"
        ) from error
    except (RuntimeError, ValueError) as error:
        raise OutputError(f"{url}: expected a viewer's address such as {VIEWER_URL}: {error}") from error


def _close(rec: rr.RecordingStream) -> None:
    try:
        rec.flush(timeout_sec=FLUSH_SECONDS)
    except RuntimeError as error:
        raise OutputError(f"Rerun recording: not all of it was written within {FLUSH_SECONDS:g} s: {error}") from error
    finally:
        rec.disconnect()


@contextlib.contextmanager
def _with_room(path: Path) -> Iterator[Path]:
    """As `replacing`, a file that is there to be written into by the SDK."""
    with replacing(path) as temporary:
        temporary.write_bytes(bytes(LEAST_ROOM_BYTES))
        os.truncate(temporary, 0)
        yield temporary


@contextlib.contextmanager
def _serve_on_loopback(port: int | None) -> Iterator[tuple[str, subprocess.Popen]]:
    """Rerun's own server and web viewer, bound to loopback: the SDK's `serve_grpc` would bind to every interface."""
    grpc_port, web_port = free_port(port or 0), free_port()
    command = [sys.executable, "-m", "rerun_cli", "--serve-web", "--bind", LOOPBACK, "--port", str(grpc_port)]
    command += ["--web-viewer-port", str(web_port)]
    with signals_as_interrupts():  # so that the server does not outlive us
        server = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
        try:
            _wait_for_port(grpc_port, server)
            _wait_for_port(web_port, server)
            url = f"rerun+http://{LOOPBACK}:{grpc_port}/proxy"
            print(f"viewer: http://{LOOPBACK}:{web_port}/?url={url.replace('+', '%2B')} (Ctrl-C ends it)", flush=True)
            yield url, server
        except Terminated as stop:
            sys.exit(exit_code(stop))
        finally:
            _stop(server)


def free_port(port: int = 0) -> int:
    """A TCP port on loopback that nothing listens on: this one, or any for 0.

    Raises
    ------
    OutputError  if this one is taken, or not allowed.
    """
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, port))
        except (OSError, OverflowError) as error:
            raise OutputError(f"--port: cannot listen on {LOOPBACK}:{port}: {error}; choose another") from error
        return probe.getsockname()[1]


def _wait_for_port(port: int, server: subprocess.Popen) -> None:
    give_up = time.monotonic() + SERVER_START_SECONDS
    while time.monotonic() < give_up and server.poll() is None:
        with contextlib.suppress(OSError), socket.create_connection((LOOPBACK, port), timeout=1.0):
            return
        time.sleep(0.05)
    raise OutputError(f"rerun server: did not start listening on {LOOPBACK}:{port} within {SERVER_START_SECONDS:g} s")


def _wait_for_interrupt(server: subprocess.Popen) -> None:
    try:
        server.wait()
    except Terminated:
        raise
    except KeyboardInterrupt:
        pass


def _stop(server: subprocess.Popen) -> None:
    """`rerun` is a shim that starts the real program: end its process group, where there are such."""
    groups = hasattr(os, "killpg")
    with contextlib.suppress(ProcessLookupError):
        os.killpg(server.pid, signal.SIGTERM) if groups else server.terminate()
    with contextlib.suppress(subprocess.TimeoutExpired):
        server.wait(timeout=5.0)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(server.pid, signal.SIGKILL) if groups else server.kill()
