"""A server behind a real nginx, with the lines of the page."""

from __future__ import annotations

import asyncio
import re
import shutil
import socket
import subprocess
import urllib.request
from pathlib import Path

import pytest
from tests.server.conftest import Serve
from tests.server.talk import Talk
from websockets.exceptions import InvalidHandshake
from websockets.typing import Origin

from uoarm.client import connect
from uoarm.testing import free_port, patience, wait

PAGE = Path(__file__).parents[2] / "docs" / "deploy.md"
PROGRAM = shutil.which("nginx") or "/usr/sbin/nginx"  # Debian: not on every user's PATH
FRAME = """
daemon off; master_process off; pid {folder}/pid; error_log {folder}/log;
events {{}}
http {{
    access_log off;
    client_body_temp_path {folder}/body; proxy_temp_path {folder}/proxy;
    fastcgi_temp_path {folder}/fcgi; uwsgi_temp_path {folder}/uwsgi; scgi_temp_path {folder}/scgi;
    server {{
        listen 127.0.0.1:{port};
        {lines}
    }}
}}
"""


async def _connect(url: str) -> None:
    async with connect(url, timeout=patience()):
        pass


@pytest.mark.needs("nginx")
def test_a_page_and_its_websocket_work_below_a_path_of_a_proxy(
    serve: Serve, tmp_path: Path
) -> None:
    server, port = serve(), free_port()
    found = re.search(r"(?s)```nginx\n(.*?)```", PAGE.read_text(encoding="utf-8"))
    assert found
    lines = found[1].replace("127.0.0.1:9080", f"127.0.0.1:{server.ports[0]}")
    file = tmp_path / "nginx.conf"
    file.write_text(FRAME.format(folder=tmp_path, port=port, lines=lines), encoding="utf-8")
    place = f"127.0.0.1:{port}"

    def answers() -> bool:
        assert nginx.poll() is None, (tmp_path / "log").read_text(encoding="utf-8")
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", port)) == 0

    nginx = subprocess.Popen([PROGRAM, "-e", "stderr", "-c", str(file)], stderr=subprocess.DEVNULL)
    try:
        wait(answers, "nginx does not answer")
        main = f"http://{place}/robot/app/main.js"
        request = urllib.request.Request(main, headers={"Origin": f"http://{place}"})
        urllib.request.urlopen(request, timeout=patience()).close()
        with Talk(f"ws://{place}/robot/", origin=Origin(f"http://{place}")) as client:
            assert client.ask("List")
        with pytest.raises(InvalidHandshake, match=f"it redirects: give ws://{place}/robot/ as"):
            asyncio.run(_connect(f"ws://{place}/robot"))
    finally:
        nginx.terminate()
        nginx.wait()
