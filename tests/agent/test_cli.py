from __future__ import annotations

import subprocess
import sys

import pytest

from linkrover.agent import load_config, parse_config
from linkrover.cli.agent import _merged
from linkrover.errors import ConfigError
from linkrover.records import Role

FILE = """
interfaces = ["wlan0"]
role = "station"
[rates]
wireless_hz = 20.0
utilization_hz = 2.0
[probe]
deadline_s = 1.0
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "agent.toml"
    path.write_text(FILE)
    return path


def test_options_come_before_the_file_and_leave_the_rest_of_it_alone(file):
    config = _merged(
        file,
        {"interfaces": ["eth0", "eth1"], "role": None, "peers": None},
        {"rates": {"wireless_hz": 5.0, "utilization_hz": None}, "probe": {"rate_hz": 50.0}},
    )
    assert config.interfaces == ("eth0", "eth1")
    assert config.role is Role.STATION
    assert (config.rates.wireless_hz, config.rates.utilization_hz) == (5.0, 2.0)
    assert (config.probe.rate_hz, config.probe.deadline_s) == (50.0, 1.0)


def test_without_options_the_file_stands(file):
    assert _merged(file, {}, {}) == load_config(file) == parse_config(FILE)


def test_an_option_out_of_range_is_an_error():
    with pytest.raises(ConfigError, match=r"options: rates.wireless_hz = 99999"):
        _merged(None, {}, {"rates": {"wireless_hz": 99999.0}})


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--interface", "lo", "--role", "rover"], "rover"),
        (["--config", "/nowhere.toml"], "/nowhere.toml"),
        (["--interface", "lo", "--peer", "host:0"], "65535"),
        (["--interface", "lo", "--duration", "-1"], "duration_s = -1"),
        (["--interfase", "lo"], "interfase"),
    ],
)
def test_wrong_usage_is_said_in_a_line_and_not_with_a_traceback(arguments, words):
    command = [sys.executable, "-m", "linkrover", "agent", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    output = done.stdout + done.stderr
    assert done.returncode == 2
    assert words in output
    assert "Traceback" not in output


def test_help_teaches_with_an_example_of_both_ends():
    command = [sys.executable, "-m", "linkrover", "agent", "--help"]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "--role station --reflect" in text
    for option in ("--interface", "--role", "--peer", "--reflect", "--record", "--config", "--duration", "--feed"):
        assert option in text
