"""The browser application is handed every file that the JavaScript client consists of."""

from __future__ import annotations

import sys
import threading
import urllib.request
from functools import partial
from http.server import ThreadingHTTPServer
from importlib.resources import files
from pathlib import Path

from tests.examples.healthbot import EXAMPLE

from uoarm.testing import patience

sys.path.insert(0, str(EXAMPLE))

from healthbot_scene.pages import PageHandler

CLIENT = Path(str(files("uoarm.server"))) / "static"


def test_every_file_of_the_client_is_handed_out() -> None:
    names = {file.name for file in CLIENT.glob("uoarm*.js")}
    assert len(names) > 1
    handler = partial(PageHandler, directory=str(EXAMPLE / "browser"))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            for name in (*names, "main.js"):
                url = f"http://127.0.0.1:{server.server_port}/{name}?robot=somewhere"
                with urllib.request.urlopen(url, timeout=patience()) as answer:
                    assert answer.read()
        finally:
            server.shutdown()
            thread.join()
