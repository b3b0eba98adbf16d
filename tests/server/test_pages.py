"""What the server has for the pages that it serves."""

from __future__ import annotations

import urllib.request
from typing import Any

from tests.server.conftest import Connect
from tests.server.talk import eventually

from uoarm.server import Server


def test_pages_may_load_nothing_from_elsewhere(server: Server) -> None:
    url = f"http://127.0.0.1:{server.ports[0]}/vendor/dagre.js"
    with urllib.request.urlopen(url, timeout=20) as answer:
        policy = answer.headers["Content-Security-Policy"].split("; ")
        assert answer.headers["Content-Type"] == "text/javascript; charset=utf-8"
    assert "default-src 'self'" in policy
    assert not any("unsafe" in one or "http" in one or "*" in one for one in policy)


def test_functions_are_listed_with_what_they_use(talk: Connect) -> None:
    functions = {one["name"]: one for one in talk().ask("List")["functions"]}
    assert functions["doubled"]["components"][0]["uses"] == ["numbers"]
    assert functions["numbers"]["components"][0]["uses"] == []


def test_what_cannot_be_resolved_tells_its_candidates_as_data(talk: Connect) -> None:
    rejected = talk().refused("Resolve", "missing")["rejected"]
    assert [one["component"] for one in rejected] == ["missing"]
    assert "nothing" in rejected[0]["reasons"][0]["sentence"]


def test_who_watches_learns_what_went_before(talk: Connect) -> None:
    talk().open("numbers")
    client = talk()

    def past() -> list[dict[str, Any]]:
        told: list[dict[str, Any]] = client.ask("Status", "watch")["past"]
        return told

    eventually(lambda: len(past()) == 2, "both changes are remembered")
    opening, running = past()
    assert (opening["change"], running["change"]) == ("opening", "running")
    assert 0 <= running["age"] <= opening["age"] < 120
