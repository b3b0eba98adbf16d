"""The tutorial of a page in the browser works as written, in a real Chromium."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from urllib.request import urlopen

import pytest
from tests.server.browser import Browser, says

from uoarm.testing import free_port, patience

PAGE = (Path(__file__).parents[2] / "docs" / "tutorial-browser.md").read_text(encoding="utf-8")
pytestmark = pytest.mark.needs("chromium")


def block(language: str) -> str:
    (found,) = re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)
    return str(found)


class Quiet(SimpleHTTPRequestHandler):
    """Files of a folder, without a line for each."""

    def log_message(self, *_: object) -> None:
        """Say nothing."""


@pytest.fixture
def clean_up() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def serve(folder: Path, port: int, origin: str, clean_up: ExitStack) -> subprocess.Popen[str]:
    command = ["serve", "robot.yaml", "--port", str(port), "--origin", origin]
    server = subprocess.Popen(
        [sys.executable, "-m", "uoarm", *command], cwd=folder, stdout=subprocess.PIPE, text=True
    )
    assert server.stdout
    clean_up.enter_context(server.stdout)
    clean_up.callback(server.wait, patience())
    clean_up.callback(server.terminate)
    assert "serving" in server.stdout.readline()
    return server


def test_the_page_shows_a_stream_and_a_call(
    tmp_path: Path, clean_up: ExitStack, browser: Browser
) -> None:
    port = free_port()
    (tmp_path / "lab.py").write_text(block("python"))
    (tmp_path / "robot.yaml").write_text(block("yaml"))
    html = block("html").replace("127.0.0.1:9080", f"127.0.0.1:{port}")
    (tmp_path / "index.html").write_text(html, encoding="utf-8")
    pages = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(tmp_path)))
    clean_up.enter_context(pages)
    Thread(target=pages.serve_forever, daemon=True).start()
    clean_up.callback(pages.shutdown)
    origin = f"http://127.0.0.1:{pages.server_port}"
    server = serve(tmp_path, port, origin, clean_up)
    (names,) = re.findall(r"^for file in (.*?);", PAGE, re.MULTILINE)
    for name in names.split():
        with urlopen(f"http://127.0.0.1:{port}/{name}") as answer:
            (tmp_path / name).write_bytes(answer.read())
    browser.go(f"{origin}/")
    browser.until(says("#celsius", "20.2 °C"))
    browser.click("#add")
    browser.until(says("#sum", "5"))
    server.terminate()
    server.wait(patience())
    serve(tmp_path, port, origin, clean_up)
    browser.js("document.getElementById('celsius').textContent = ''")
    browser.until(says("#celsius", "°C"))
    expected = ("favicon.ico", f":{port}/")  # no icon on the page; no server meanwhile
    others = [text for text in browser.complaints if not any(part in text for part in expected)]
    browser.complaints[:] = others
