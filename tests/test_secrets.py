"""What is secret is hidden by its name and within texts; what is only about a secret is not."""

from __future__ import annotations

import pytest

from uoarm._secrets import is_secret_name, without_secrets


@pytest.mark.parametrize(
    "name",
    [
        *("password", "Password", "passwd", "db_pass", "pwd", "passphrase", "token", "api_tokens"),
        *("secret", "client_secret_value", "credentials_json", "Authorization", "cookie", "psk"),
        *("api_key", "X-Api-Key", "apiKey", "private-key", "AWS_SECRET_ACCESS_KEY", "sharedKey"),
    ],
)
def test_names_of_secrets(name: str) -> None:
    assert is_secret_name(name)


@pytest.mark.parametrize(
    "name",
    [
        *("token_file", "password_path", "secret_name", "token_seconds", "access_key_id"),
        *("key", "user", "passes", "compass", "bypass", "pin", "author", "keys"),
    ],
)
def test_names_of_what_is_no_secret(name: str) -> None:
    assert not is_secret_name(name)


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("mqtt://me:hush@there/x", "mqtt://***@there/x"),
        ("http://there/?token=hush&x=1", "http://there/?token=***&x=1"),
        ("Bearer hush", "Bearer ***"),
        ("run --password=hush --token hush --x 1", "run --password=*** --token *** --x 1"),
        ("API_KEY=hush", "API_KEY=***"),
        ("ws://there/?token=hu:sh: no one listens", "ws://there/?token=***: no one listens"),
        ("a token is needed", "a token is needed"),
    ],
)
def test_secrets_within_texts(text: str, shown: str) -> None:
    assert without_secrets({"a": [text]}) == {"a": [shown]}


def test_values_of_any_kind_and_items_of_a_command() -> None:
    plain = {"command": ["run", "--api-token", "hush", "x"], "psk": {"a": 1}, "token": None, "n": 1}
    assert without_secrets(plain) == {
        "command": ["run", "--api-token", "***", "x"],
        "psk": "***",
        "token": None,
        "n": 1,
    }


@pytest.mark.parametrize(
    "part",
    [
        "-",
        "--a",
        "--token",
        "--token ",
        "token=",
        "token=:",
        "bearer ",
        "://",
        "://a",
        "authorization:",
    ],
)
def test_a_text_that_is_nearly_full_of_secrets_costs_no_more_than_it_is_long(part: str) -> None:
    """The interpreter's lock is held all the time: for minutes, if it costs its square."""
    assert without_secrets("x" + part * 50_000 + "\n").startswith("x")
