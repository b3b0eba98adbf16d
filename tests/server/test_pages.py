"""What the server has for the pages that it serves."""

from __future__ import annotations

import re
import time
import urllib.request
from pathlib import Path
from typing import Any

from tests.server.conftest import Connect
from tests.server.talk import eventually

import uoarm.server
from uoarm.server import Server
from uoarm.testing import patience

STATIC = Path(uoarm.server.__file__).parent / "static"


def test_pages_may_load_nothing_from_elsewhere(server: Server) -> None:
    url = f"http://127.0.0.1:{server.ports[0]}/vendor/dagre.js"
    with urllib.request.urlopen(url, timeout=patience()) as answer:
        policy = answer.headers["Content-Security-Policy"].split("; ")
        assert answer.headers["Content-Type"] == "text/javascript; charset=utf-8"
    assert "default-src 'self'" in policy
    assert not any("unsafe" in item or "http" in item or "*" in item for item in policy)


def test_the_page_names_no_other_place() -> None:
    own = [path for folder in ("app", "style") for path in (STATIC / folder).iterdir()]
    assert len(own) > 30
    for path in [*own, STATIC / "index.html"]:
        text = path.read_text(encoding="utf-8")
        assert "//" not in re.sub(r"(?m)^\s*//.*|\s// .*|/\*[^/]*\*/", "", text), path.name
        assert "innerHTML" not in text, path.name
        assert "eval(" not in text, path.name


def test_files_of_others_are_listed_with_version_and_licence() -> None:
    table = (STATIC / "vendor" / "README.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([^`]+)` \| `[^`]+` \| [0-9.]+ \|.*$", table, re.MULTILINE)
    licences = set(re.findall(r"`([^`]+\.LICENSE\.txt)`", table))
    there = {path.name for path in (STATIC / "vendor").iterdir()} - {"README.md"}
    assert there == {*rows, *licences}


def test_functions_are_listed_with_what_they_use(talk: Connect) -> None:
    functions = {function["name"]: function for function in talk().ask("List")["functions"]}
    assert functions["doubled"]["components"][0]["uses"] == ["numbers"]
    assert functions["numbers"]["components"][0]["uses"] == []
    assert functions["numbers"]["components"][0]["plugin"] == "python"


def test_what_cannot_be_resolved_gives_its_candidates_as_data(talk: Connect) -> None:
    rejected = talk().refused("Resolve", "missing")["rejected"]
    assert [item["component"] for item in rejected] == ["missing"]
    assert "nothing" in rejected[0]["reasons"][0]["sentence"]


def test_who_watches_learns_what_went_before(talk: Connect) -> None:
    begin = time.monotonic()
    talk().open("numbers")
    client = talk()

    def past() -> list[dict[str, Any]]:
        received: list[dict[str, Any]] = client.ask("Status", "watch")["past"]
        return received

    eventually(lambda: len(past()) == 2, "both changes are remembered")
    opening, running = past()
    assert (opening["change"], running["change"]) == ("opening", "running")
    assert 0 <= running["age"] <= opening["age"] <= time.monotonic() - begin
