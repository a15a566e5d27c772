import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkrover.errors import ConfigError
from linkrover.probe.address import load_key, numeric, resolve, split_host_port


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("robot", ("robot", 8620)),
        ("10.0.0.1:862", ("10.0.0.1", 862)),
        ("fe80::1%wlan0", ("fe80::1%wlan0", 8620)),
        ("[fe80::1]:862", ("fe80::1", 862)),
        ("[fe80::1]", ("fe80::1", 8620)),
    ],
)
def test_host_and_port_are_told_apart(text, expected):
    assert split_host_port(text) == expected


@pytest.mark.parametrize(
    "text", ["", ":5", "robot:", "robot:0", "robot:65536", "robot:x", "[::1", "[::1]5", "[::1]:", "[]:5"]
)
def test_what_is_no_host_and_port_is_refused(text):
    with pytest.raises(ConfigError, match=r"expected|port must|no host"):
        split_host_port(text)


@given(st.text(max_size=40))
def test_any_text_gives_host_and_port_or_a_config_error(text):
    try:
        host, port = split_host_port(text)
    except ConfigError:
        return
    assert host
    assert 1 <= port <= 65_535


def test_addresses_in_figures_need_no_name_service(monkeypatch):
    assert numeric("10.0.0.1", 5).family == socket.AF_INET
    assert str(numeric("::1", 5)) == "[::1]:5"
    assert numeric("station", 5) is None


def test_an_unknown_name_says_what_to_do(monkeypatch):
    def fail(*_a, **_k):
        raise socket.gaierror(-2, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", fail)
    with pytest.raises(ConfigError, match="DNS or /etc/hosts"):
        resolve("robot", 5)


def test_a_key_is_read_without_its_line_end_and_a_short_one_is_refused(tmp_path):
    path = tmp_path / "key"
    path.write_bytes(b"0123456789abcdef\n")
    assert load_key(path) == b"0123456789abcdef"
    path.write_bytes(b"short\n")
    with pytest.raises(ConfigError, match="openssl rand"):
        load_key(path)
    with pytest.raises(ConfigError, match="cannot read"):
        load_key(tmp_path / "absent")
