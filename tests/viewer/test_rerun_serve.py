"""`--serve`: loopback only, shown by a real browser, and gone with the process that started it."""

import argparse
import os
import re
import signal
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import psutil
import pytest
from browser import browser_page, find_browser
from viewer import PATIENCE_SECONDS, eventually

from adagmm_fusion.errors import OutputError
from adagmm_fusion.rerun_log import add_rerun_arguments, open_stream
from adagmm_fusion.rerun_log.streams import free_port

pytestmark = pytest.mark.slow
SUPPORT = Path(__file__).parents[1] / "support"
BROWSER_SECONDS = 300.0
SERVE = """
import argparse
from registered_scene import known_estimate, room_clouds, room_pair
from adagmm_fusion.rerun_log import add_rerun_arguments, dashboard, log_pair, open_stream

parser = argparse.ArgumentParser()
add_rerun_arguments(parser)
with open_stream(parser.parse_args(["--serve"]), "room", dashboard()) as rec:
    log_pair(rec, room_pair(), *room_clouds(), known_estimate())
"""


@pytest.fixture
def serving():
    path = os.pathsep.join([str(SUPPORT), os.environ.get("PYTHONPATH", "")])
    process = subprocess.Popen(
        [sys.executable, "-c", SERVE],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
    )
    try:
        line = process.stdout.readline()
        address = re.search(r"http://\S+", line)
        assert address, line
        yield process, address.group()
    finally:
        process.terminate()
        process.wait(timeout=PATIENCE_SECONDS)


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM])
def test_only_loopback_listens_and_the_server_ends_with_us(serving, ending):
    process, address = serving
    assert address.startswith("http://127.0.0.1:")
    family = psutil.Process(process.pid).children(recursive=True)

    def listening_places() -> list:
        found = [c.laddr for p in family for c in p.net_connections() if c.status == psutil.CONN_LISTEN]
        assert len(found) == 2
        return found

    listening = eventually(listening_places)
    assert {place.ip for place in listening} == {"127.0.0.1"}
    process.send_signal(ending)
    assert (
        process.wait(timeout=PATIENCE_SECONDS) in {signal.SIGINT: (0, -signal.SIGINT), signal.SIGTERM: (143,)}[ending]
    )
    gone, alive = psutil.wait_procs(family, timeout=PATIENCE_SECONDS)
    assert alive == [] and len(gone) == len(family)


@pytest.mark.parametrize("url", ["rerun+http://127.0.0.1:FREE/proxy", "nonsense", "http://127.0.0.1:port/proxy"])
def test_no_viewer_where_one_was_expected(url):
    url = url.replace("FREE", str(free_port()))
    parser = argparse.ArgumentParser()
    add_rerun_arguments(parser)
    with pytest.raises(OutputError, match=f"^{re.escape(url)}: "), open_stream(parser.parse_args(["--url", url]), "x"):
        pass


def test_a_taken_port_is_named():
    parser = argparse.ArgumentParser()
    add_rerun_arguments(parser)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        args = parser.parse_args(["--serve", "--port", port])
        with pytest.raises(OutputError, match=f"^--port: cannot listen on 127.0.0.1:{port}: "), open_stream(args, "x"):
            pass


@pytest.mark.skipif(find_browser() is None, reason="no Chromium is installed (Debian: chromium)")
def test_a_browser_shows_both_clouds(serving, tmp_path):
    _, address = serving
    with browser_page(find_browser(), tmp_path / "profile") as page:
        page.open(address)

        def look() -> None:
            red, green, blue = np.moveaxis(page.screenshot().astype(int), 2, 0)
            assert np.mean((red > blue + 60) & (red > green + 20)) >= 0.01  # orange
            assert np.mean((blue > red + 60) & (blue > green + 20)) >= 0.01

        eventually(look, seconds=BROWSER_SECONDS, pause=1.0)
