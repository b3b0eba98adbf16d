"""Hostile and unreadable files: one clear error, within bounded time and memory."""

from __future__ import annotations

import os
import re
import socket
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from uoarm._spelling import Speller
from uoarm.config import inspect, loads
from uoarm.errors import ConfigurationError

FRAME = "version: 1\nbridges: {}\nfunctions: {}\n"


def refusal(text: str) -> str:
    with pytest.raises(ConfigurationError) as caught:
        loads(text)
    return str(caught.value)


def problems_of(text: str) -> list[str]:
    try:
        loads(text)
    except ConfigurationError as error:
        return str(error).splitlines()
    return []


def bomb(levels: int) -> str:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    for level in range(1, levels):
        inner = ", ".join([f"*a{level - 1}"] * 10)
        lines.append(f"a{level}: &a{level} [{inner}]")
    return "\n".join(lines)


def test_aliases_that_unfold_without_end_are_refused() -> None:
    assert "more than 200,000 values, aliases counted in full" in refusal(bomb(20))


def test_aliases_within_the_limit_are_read() -> None:
    text = f"{FRAME}".replace("bridges: {}", "bridges:\n  p: {options: {" + "a: &x [1], b: *x}}")
    robot = loads(text)
    assert robot.bridges["p"].options == {"a": [1], "b": [1]}


def test_a_file_over_ten_megabytes_is_refused_with_the_limit(tmp_path: Path) -> None:
    path = tmp_path / "big.yaml"
    path.write_bytes(b"a: " + b"x" * 10_000_000)
    problem = inspect(path).problems[0]
    assert problem.sentence == "the file cannot be read: it has more than 10,000,000 bytes"
    assert "10,000,000 are allowed" in refusal("a: " + "x" * 10_000_000)


def test_a_file_just_below_ten_megabytes_is_read(tmp_path: Path) -> None:
    path = tmp_path / "big.yaml"
    comment = b"# " + b"x" * (9_999_998 - len(FRAME)) + b"\n"
    path.write_bytes((FRAME.encode() + comment)[:10_000_000])
    assert inspect(path).robot is not None


def test_a_lone_surrogate_is_refused() -> None:
    assert (
        refusal("version: \ud800") == "<text>:1:10: $: the character U+D800 is not allowed in YAML"
    )


def test_many_values_without_an_alias_are_refused() -> None:
    assert "more than 200,000 values" in refusal("[" + "1," * 200_001 + "]")


def test_thousands_of_wrong_references_are_reported_in_bounded_text() -> None:
    functions = "".join(
        f"  f{n}: {{components: [{{name: c{n}, bridge: p, "
        f"input: {{from: g{n}, endpoint: [x]}}}}]}}\n"
        for n in range(2000)
    )
    lines = refusal(f"version: 1\nbridges: {{}}\nfunctions:\n{functions}").splitlines()
    assert len(lines) == 51
    assert lines[-1] == "... and 3,950 more"


def test_guesses_end_when_they_have_cost_enough() -> None:
    speller = Speller()
    known = [f"name{number}" for number in range(1000)]
    guesses = [speller.guess(f"nam{number}", known) for number in range(1000)]
    assert guesses[0] == 'did you mean "name0"?'
    assert 100 < sum(map(bool, guesses)) < 500
    assert guesses[-1] == ""


def test_long_keys_and_values_are_cut_in_the_text() -> None:
    text = refusal(f"{FRAME}{'k' * 100_000}: {'v' * 100_000}\n? {'q' * 500}\n: 1\nversion: 1")
    assert len(text) < 2000


def test_a_key_with_a_line_end_cannot_forge_a_line_of_the_report() -> None:
    text = refusal(f'{FRAME}"a\\nrobot.yaml:1:1: forged": 1\n')
    assert len(text.splitlines()) == 1


class TestFiles:
    def said(self, path: Path | str) -> str:
        report = inspect(path)
        assert report.robot is None
        assert len(report.problems) == 1
        assert report.problems[0].file == str(path)
        with pytest.raises(ConfigurationError, match=f"{re.escape(str(path)[:1000])}.*: the file"):
            report.require()
        return report.problems[0].sentence

    def test_missing(self, tmp_path: Path) -> None:
        assert "No such file" in self.said(tmp_path / "none.yaml")

    def test_folder(self, tmp_path: Path) -> None:
        assert "it is a folder" in self.said(tmp_path)

    def test_pipe(self, tmp_path: Path) -> None:
        os.mkfifo(tmp_path / "pipe")
        assert "not a regular file" in self.said(tmp_path / "pipe")

    def test_device_without_end(self) -> None:
        assert "not a regular file" in self.said("/dev/zero")

    def test_socket(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.chdir(tmp_path)
        with socket.socket(socket.AF_UNIX) as server:
            server.bind("s")
            assert "not a regular file" in self.said("s")

    def test_path_with_a_null(self) -> None:
        assert "null" in self.said("a\0b")

    def test_endless_link(self, tmp_path: Path) -> None:
        (tmp_path / "a").symlink_to(tmp_path / "b")
        (tmp_path / "b").symlink_to(tmp_path / "a")
        assert "cannot be read" in self.said(tmp_path / "a")

    def test_path_too_long(self) -> None:
        assert "too long" in self.said("x" * 5000)

    def test_unreadable(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        def refuse(*_: object, **__: object) -> None:
            raise PermissionError(13, "Permission denied")

        (tmp_path / "a.yaml").write_text(FRAME)
        monkeypatch.setattr(Path, "open", refuse)
        assert "Permission denied" in self.said(tmp_path / "a.yaml")

    def test_not_utf8(self, tmp_path: Path) -> None:
        path = tmp_path / "latin.yaml"
        path.write_bytes(b"version: 1\n# caf\xe9\n")
        problem = inspect(path).problems[0]
        assert (problem.place.line, problem.hint) == (2, "save it as UTF-8")

    def test_utf16(self, tmp_path: Path) -> None:
        path = tmp_path / "wide.yaml"
        path.write_bytes(FRAME.encode("utf-16"))
        assert "not UTF-8" in self.said(path)

    def test_byte_order_mark_is_passed_over(self, tmp_path: Path) -> None:
        path = tmp_path / "bom.yaml"
        path.write_bytes(FRAME.encode("utf-8-sig"))
        assert inspect(path).robot is not None

    @given(st.binary(max_size=300))
    def test_any_bytes_give_a_report(
        self, tmp_path_factory: pytest.TempPathFactory, raw: bytes
    ) -> None:
        path = tmp_path_factory.getbasetemp() / "any.yaml"
        path.write_bytes(raw)
        report = inspect(path)
        assert (report.robot is None) == bool(report.problems)


LETTERS = st.sampled_from(
    [*"ab:-[]{}&*!|>'\"%@`#,?~ \n\t0.1", "version", "functions", "<<", "\n  "]
)


@given(st.lists(LETTERS, max_size=60).map("".join))
def test_any_text_is_read_or_refused(text: str) -> None:
    assert all(line.startswith("<text>:") for line in problems_of(text))


@given(st.lists(LETTERS, max_size=40).map("".join))
def test_without_libyaml_the_same_values_are_read(text: str) -> None:
    """The pure Python parser differs in a few corners of syntax, never in values."""
    from uoarm._support.yaml import read

    fast = read(text)
    with pytest.MonkeyPatch.context() as patch:
        patch.delattr(yaml, "CSafeLoader")
        slow = read(text)
    if fast.whole and slow.whole:
        assert fast.value == slow.value


def test_without_libyaml_a_configuration_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(yaml, "CSafeLoader")
    assert loads(FRAME).functions == {}
    assert "use spaces" in refusal("version: 1\n\tbridges: {}\n")
