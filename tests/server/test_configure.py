"""Changing the configuration from outside: who may, what is reported, and what is refused."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from tests.server.conftest import Serve
from tests.server.robot import CONFIGURATION
from tests.server.serving import access_file, url
from tests.server.talk import Talk

from uoarm.cli import main
from uoarm.client import ServerError, connect
from uoarm.errors import ConfigurationError, UsageError
from uoarm.server import Server, make_token

TOKENS = {"keeper": make_token(), "owner": make_token(), "viewer": make_token()}
ACCESS = """
version: 1
roles:
  keeper: {{see: all, request: ["*"], configure: all}}
  owner: {{see: all, configure: all, keep: all}}
  viewer: {{see: all, request: ["*"]}}
tokens:
  - {{name: keeper, role: keeper, sha256: {keeper}}}
  - {{name: owner, role: owner, sha256: {owner}}}
  - {{name: viewer, role: viewer, sha256: {viewer}}}
"""
TORCH = "{name: torch, bridge: python, output: {endpoint: ['tests.server.robot:numbers']}}"
MORE = f"{CONFIGURATION}\n  torch:\n    components: [{TORCH}]\n"
PASSING = "endpoint: ['tests.server.robot:numbers']"
ROUND = f"""
version: 1
bridges: {{python: {{}}}}
functions:
  numbers:
    components:
      - {{name: one, bridge: python, input: {{from: torch, {PASSING}}}, output: {{{PASSING}}}}}
  torch:
    components:
      - {{name: two, bridge: python, input: {{from: numbers, {PASSING}}}, output: {{{PASSING}}}}}
"""
NO_NUMBERS = (
    f"version: 1\nbridges: {{python: {{}}}}\nfunctions:\n  torch:\n    components: [{TORCH}]\n"
)


@pytest.fixture
def guarded(serve: Serve, tmp_path: Path) -> Server:
    return serve(access=access_file(tmp_path, ACCESS, TOKENS))


def enter(server: Server, name: str) -> Talk:
    return Talk(url(server), additional_headers={"Authorization": f"Bearer {TOKENS[name]}"})


def test_who_has_the_right_changes_it_and_sees_the_revisions(guarded: Server) -> None:
    with enter(guarded, "keeper") as keeper:
        change = keeper.ask("Configure", message={"text": MORE, "dry_run": True})
        assert (change["revision"], change["is_applied"]) == (1, False)
        assert "+ function torch" in change["text"]
        change = keeper.ask("Configure", message={"text": MORE, "revision": 0})
        assert change["is_applied"]
        keeper.open("torch")
        revisions = keeper.ask("Configure")["revisions"]
        assert [revision["revision"] for revision in revisions] == [0, 1]
        again = {"text": MORE, "reload_code": True, "dry_run": True}
        assert keeper.ask("Configure", message=again)["differences"] == [
            "~ bridge python: its code"
        ]


def test_only_who_has_that_right_too_writes_the_file(guarded: Server) -> None:
    with enter(guarded, "keeper") as keeper:
        refused = keeper.refused("Configure", message={"text": MORE, "keep": True})
        assert (refused["code"], "may not keep" in refused["text"]) == ("denied", True)
        report = keeper.ask("Configure")
        assert (len(report["revisions"]), report["configuration"]) == (1, CONFIGURATION)
    with enter(guarded, "owner") as owner:  # the robot of these tests is of no file to write to
        refused = owner.refused("Configure", message={"text": MORE, "keep": True})
        assert refused["code"] in {"usage", "configuration"}
        assert owner.ask("Configure", message={"text": MORE, "keep": False})["is_applied"]


def test_discoveries_are_for_roles_that_see_all_and_taken_by_roles_that_may_configure(
    guarded: Server,
) -> None:
    with enter(guarded, "viewer") as viewer:
        (python, *others) = viewer.ask("Discover")["bridges"]
        assert (python["bridge"], python["configured"], python["cause"]) == ("python", True, "")
        assert not any(item["configured"] or item["components"] for item in others)
        take = {"take": {"bridge": "python", "component": "absent"}}
        assert viewer.refused("Discover", message=take)["code"] == "denied"
    with enter(guarded, "keeper") as keeper:
        refused = keeper.refused("Discover", message=take)
        assert (refused["code"], "is not seen now" in refused["text"]) == ("usage", True)


def test_an_earlier_revision_comes_back_by_its_number(guarded: Server) -> None:
    with enter(guarded, "keeper") as keeper:
        keeper.ask("Configure", message={"text": MORE})
        refused = keeper.refused("Configure", message={"rollback": 5})
        assert (refused["code"], "0 to 1" in refused["text"]) == ("usage", True)
        refused = keeper.refused("Configure", message={"rollback": 0, "revision": 0})
        assert refused["code"] == "usage"
        refused = keeper.refused("Configure", message={"rollback": 0, "text": MORE})
        assert refused["code"] == "unreadable"
        change = keeper.ask("Configure", message={"rollback": 0})
        assert (change["revision"], change["differences"][-1]) == (2, "- function torch")


def test_who_has_not_is_denied_and_learns_nothing(guarded: Server) -> None:
    with enter(guarded, "viewer") as viewer:  # a pattern of functions is not enough
        for asked in ({"text": MORE}, {"text": "no: configuration"}, None):
            assert viewer.refused("Configure", message=asked)["code"] == "denied"


def test_without_an_access_file_no_client_may(serve: Serve) -> None:
    with Talk(url(serve())) as local:
        refused = local.refused("Configure", message={"text": MORE})
        assert refused["code"] == "denied"
        assert "may not configure" in refused["text"]


def test_what_is_wrong_or_in_the_way_is_reported_and_nothing_changes(guarded: Server) -> None:
    with enter(guarded, "keeper") as keeper:
        numbers = keeper.open("numbers")
        refused = keeper.refused("Configure", message={"text": "version: 1\nfunktions: {}\n"})
        assert refused["code"] == "configuration"
        assert "funktions" in refused["text"]
        refused = keeper.refused("Configure", message={"text": MORE[: MORE.index("torch") + 3]})
        assert (refused["code"], "expected" in refused["text"]) == ("configuration", True)  # half
        refused = keeper.refused("Configure", message={"text": ROUND})
        assert refused["code"] == "configuration"
        assert "none can be first: numbers -> torch -> numbers" in refused["text"]
        refused = keeper.refused("Configure", message={"text": NO_NUMBERS})
        assert refused["code"] == "configuration"
        assert "(numbers) ends" in refused["text"]
        refused = keeper.refused("Configure", message={"text": MORE, "revision": 3})
        assert refused["code"] == "usage"
        assert [revision["revision"] for revision in keeper.ask("Configure")["revisions"]] == [0]

        keeper.ask("Configure", message={"text": NO_NUMBERS, "force": True})
        report = keeper.next("connection")["jsonMessage"]
        assert (report["connection"], report["state"]) == (numbers, "failed")


async def test_the_python_client(guarded: Server) -> None:
    async with connect(url(guarded), token=TOKENS["keeper"]) as keeper:
        assert (await keeper.configure(MORE))["is_applied"]
        assert [revision["revision"] for revision in await keeper.revisions()] == [0, 1]
        with pytest.raises(ConfigurationError, match="funktions"):
            await keeper.configure("version: 1\nfunktions: {}\n")
        assert (await keeper.rollback(0, dry_run=True))["revision"] == 2
        with pytest.raises(UsageError, match="revision 7"):
            await keeper.configure(MORE, revision=7)
    async with connect(url(guarded), token=TOKENS["viewer"]) as viewer:
        with pytest.raises(ServerError, match="may not configure"):
            await viewer.configure(MORE)


def apply(server: Server, *arguments: str | Path, who: str = "keeper") -> Result:
    given = ["apply", *map(str, arguments), "--url", url(server), "--token", TOKENS[who]]
    return CliRunner().invoke(main, given)


def test_the_command_line(guarded: Server, tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(MORE, encoding="utf-8")
    done = apply(guarded, path, "--dry-run")
    assert (done.exit_code, done.output.splitlines()[0]) == (0, "revision 1, not applied")
    assert json.loads(apply(guarded, path, "--json").stdout)["is_applied"]
    assert apply(guarded, path, "--revision", "0").exit_code == 1
    assert apply(guarded, "--rollback", "0").exit_code == 0
    asked = ["history", "--url", url(guarded), "--token"]
    report = CliRunner().invoke(main, [*asked, TOKENS["keeper"]])
    assert (report.exit_code, "+ function torch" in report.output) == (0, True)
    report = CliRunner().invoke(main, [*asked, TOKENS["keeper"], "--json"])
    assert [load["revision"] for load in json.loads(report.stdout)] == [0, 1, 2]
    assert CliRunner().invoke(main, [*asked, TOKENS["viewer"]]).exit_code == 4
    assert apply(guarded, path, who="viewer").exit_code == 4
    path.write_text("version: 1\nfunktions: {}\n", encoding="utf-8")
    done = apply(guarded, path)
    assert (done.exit_code, "funktions" in done.output) == (3, True)
    assert f"{path}:2:1: $.funktions: " in done.output, "the places in it are those of this file"
    assert apply(guarded, tmp_path / "none.yaml").exit_code == 3
    gone = ["apply", str(path), "--url", "ws://127.0.0.1:1/"]
    assert CliRunner().invoke(main, gone).exit_code == 4


async def test_the_history_says_of_connections_what_the_change_said(
    guarded: Server, tmp_path: Path
) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(NO_NUMBERS, encoding="utf-8")
    async with connect(url(guarded), token=TOKENS["keeper"]) as keeper:
        await keeper.request("numbers")
        done = await asyncio.to_thread(apply, guarded, path, "--force")
        asked = ["history", "--url", url(guarded), "--token", TOKENS["keeper"]]
        report = await asyncio.to_thread(CliRunner().invoke, main, asked)
    head, *lines = done.stdout.splitlines()
    assert (head, "(numbers) ends: " in done.stdout) == ("revision 1, applied", True)
    assert report.stdout.splitlines()[2:] == lines


def test_who_may_configure_gets_the_schema_of_the_text(guarded: Server) -> None:
    with enter(guarded, "keeper") as keeper:
        schema = keeper.ask("Configure", message={"schema": True})["schema"]
        assert "options.python" in schema["$defs"]
    with enter(guarded, "viewer") as viewer:
        assert viewer.refused("Configure", message={"schema": True})["code"] == "denied"
