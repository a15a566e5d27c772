from __future__ import annotations

import contextlib
import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkrover.agent.config import AgentConfig, Outage, Probe, Rates, load_config, parse_config, to_toml
from linkrover.errors import ConfigError
from linkrover.records import Role

FULL = """
interfaces = ["wlan0", "wlan1"]
role = "station"
peers = ["10.0.0.2:8620"]
reflect = true
record = "runs/001"
case = "5"
trial = 2
[rates]
wireless_hz = 20
[probe]
rate_hz = 50.0
deadline_s = 1.5
[notes]
adapter = "external"
"""


def test_a_file_is_decoded_whole():
    config = parse_config(FULL)
    assert config.interfaces == ("wlan0", "wlan1")
    assert (config.role, config.reflect, config.trial) == (Role.STATION, True, 2)
    assert (config.rates.wireless_hz, config.rates.utilization_hz) == (20.0, 1.0)
    assert (config.probe.deadline_s, config.notes) == (1.5, {"adapter": "external"})


@pytest.mark.parametrize(
    ("text", "key", "proposal"),
    [
        ('interface = ["wlan0"]', "interface", "did you mean 'interfaces'?"),
        ("[rates]\nwireles_hz = 1", "rates.wireles_hz", "did you mean 'wireless_hz'?"),
        ("[prob]\nrate_hz = 1", "prob", "did you mean 'probe'?"),
        ("wireless_hz = 5", "wireless_hz", "did you mean 'rates.wireless_hz'?"),
        ("zzzzz = 5", "zzzzz", "allowed are: interfaces"),
    ],
)
def test_an_unknown_key_is_an_error_that_proposes_the_nearest(text, key, proposal):
    with pytest.raises(ConfigError) as caught:
        parse_config(text, "agent.toml")
    assert f"agent.toml: unknown key '{key}'" in str(caught.value)
    assert proposal in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('reflect = "yes"', "reflect: Expected `bool`, got `str`"),
        ('role = "rover"', "role: Invalid enum value 'rover'; allowed are: robot, station"),
        ("[rates]\nwireless_hz = 5000", "rates.wireless_hz = 5000"),
        ("[rates]\nwireless_hz = -1", "rates.wireless_hz = -1"),
        ("[rates]\nwireless_hz = nan", "rates.wireless_hz = nan"),
        ("[probe]\nrate_hz = 0.5", "probe.rate_hz = 0.5: must be 0 (off) or 1 to 1000 Hz"),
        ("duration_s = 0", "duration_s = 0"),
        ("[probe]\ndeadline_s = inf", "probe.deadline_s = inf"),
        ('interfaces = ["a", "a"]', "a is named twice"),
        ("rates = 5", "rates: Expected `object`, got `int`"),
        ("interfaces = [", "is not TOML"),
    ],
)
def test_a_value_that_cannot_be_used_is_named_with_its_key(text, words):
    with pytest.raises(ConfigError) as caught:
        parse_config(text)
    assert words in str(caught.value)


def test_a_file_that_is_not_there_is_named():
    with pytest.raises(ConfigError, match=r"/nowhere/agent.toml"):
        load_config("/nowhere/agent.toml")


def test_the_configuration_in_the_docs_is_accepted_and_shows_the_defaults():
    text = (Path(__file__).parents[2] / "docs" / "agent.md").read_text()
    toml = text.split("```toml\n")[1].split("```")[0]
    shown, defaults = parse_config(toml), AgentConfig()
    for table in ("rates", "probe", "reflector", "outage", "log_period_s", "scan_period_s", "wait", "reflect"):
        assert getattr(shown, table) == getattr(defaults, table), table
    parse_config(re.sub(r"(?m)^# (\w+ = )", r"\1", toml))


NAMES = st.text(st.characters(blacklist_categories=("Cs",)), max_size=12)


@given(
    st.builds(
        AgentConfig,
        interfaces=st.lists(NAMES, max_size=3, unique=True).map(tuple),
        role=st.sampled_from(Role),
        record=st.none() | NAMES,
        case=st.none() | NAMES,
        rates=st.builds(Rates, wireless_hz=st.floats(0.001, 1000)),
        probe=st.builds(Probe, deadline_s=st.floats(0.001, 60)),
        outage=st.builds(Outage, threshold_s=st.floats(0.01, 100)),
        notes=st.dictionaries(NAMES, NAMES, max_size=2),
    )
)
@settings(max_examples=60)
def test_what_is_written_as_toml_is_read_back_the_same(config):
    assert parse_config(to_toml(config)) == config


@given(st.text(max_size=80) | st.text("[]=.\"'\n #abcdeinrst_0123456789", max_size=80))
@settings(max_examples=200)
def test_any_text_gives_a_configuration_or_a_config_error(text):
    with contextlib.suppress(ConfigError):
        parse_config(text)
