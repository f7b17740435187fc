"""The keys of a connection over RTDE."""

from __future__ import annotations

import pytest
from each import each

from drivers.core.errors import UsageError
from drivers.rtde.settings import parse_settings


@each(
    ("connection", "key"),
    [
        ({}, "host"),
        ({"host": ""}, "host"),
        ({"host": 7}, "host"),
        ({"host": "h", "port": 0}, "port"),
        ({"host": "h", "port": 70000}, "port"),
        ({"host": "h", "port": "30004"}, "port"),
        ({"host": "h", "port": True}, "port"),
        ({"host": "h", "rate": 0}, "rate"),
        ({"host": "h", "rate": 501}, "rate"),
        ({"host": "h", "rate": "fast"}, "rate"),
        ({"host": "h", "rate": float("nan")}, "rate"),
        ({"host": "h", "rate": True}, "rate"),
        ({"host": "h", "timeout": -1}, "timeout"),
        ({"host": "h", "timeout": float("inf")}, "timeout"),
        ({"host": "h", "hots": "x"}, "hots"),
    ],
)
def test_wrong_keys_are_named_with_what_is_allowed(connection: dict[str, object], key: str) -> None:
    with pytest.raises(UsageError, match=f"'{key}' of the RTDE connection") as caught:
        parse_settings(connection)
    assert caught.value.hint.startswith("allowed:")
    if key in connection and key != "hots":
        assert repr(connection[key]) in caught.value.message


def test_settings_have_defaults() -> None:
    settings = parse_settings({"host": " arm "})
    assert (settings.host, settings.port, settings.rate, settings.timeout) == ("arm", 30004, None, 5.0)


def test_everything_that_is_wrong_is_said_at_once() -> None:
    with pytest.raises(UsageError) as caught:
        parse_settings({"host": 7, "prot": 30004, "rate": True})
    assert caught.value.message == (
        "3 keys of the RTDE connection are wrong: "
        "'host' is 7 (allowed: the controller's name or address, such as 192.168.56.101); "
        "'rate' is True (allowed: a number from 1 to 500 [Hz] of the samples, usually 500 or 125; default: the "
        "controller's maximum); "
        "unknown key 'prot' (allowed: host, port, rate, serial, timeout; did you mean 'port'?)"
    )
