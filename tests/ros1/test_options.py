from __future__ import annotations

from typing import Any

import msgspec
import pytest

from linkrover.errors import ConfigError
from linkrover.records import Role
from linkrover.ros1.options import Ros1Options, agent_config, layout, resolve, split_interfaces


def resolved(parameters: dict[str, Any], **given: Any) -> Ros1Options:
    return resolve(Ros1Options(**given), parameters.get)


def test_the_command_line_comes_before_parameters_and_parameters_before_defaults() -> None:
    parameters = {"update_rate_network_errors": 4, "update_rate_network_delay": 2.5, "INTERFACE_NAME": "lo"}
    found = resolved(parameters, errors_hz=7.0)
    assert (found.errors_hz, found.delay_hz, found.utilization_hz) == (7.0, 2.5, 1.0)
    assert found.interface == ("lo",)


@pytest.mark.parametrize("text", ["iface1=lo,iface2=eth0", "iface1=lo, iface2=eth0", "iface1=lo iface2=eth0"])
def test_several_interfaces_in_one_parameter(text: str) -> None:
    found = resolved({"INTERFACE_NAME": text, "prefix": "robot/{iface}"})
    assert split_interfaces(found.interface or ()) == (("lo", "eth0"), {"lo": "iface1", "eth0": "iface2"})
    assert layout(found).interface_prefix("robot", "lo") == "robot/iface1/"


@pytest.mark.parametrize("text", ["=lo", "iface1="])
def test_half_an_alias_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="expected NAME or ALIAS=NAME"):
        split_interfaces((text,))


@pytest.mark.parametrize(
    ("name", "value"), [("timeout_network_delay", "soon"), ("trial", "first"), ("thresholds", {"rssi_wrn_dbm": 1})]
)
def test_a_parameter_of_the_wrong_kind_is_named(name: str, value: Any) -> None:
    with pytest.raises(ConfigError, match=f"parameter {name}"):
        resolved({name: value, "INTERFACE_NAME": "lo"})


def test_numbers_given_as_text_are_taken_as_roslaunch_passes_them() -> None:
    assert resolved({"timeout_network_delay": "1.5", "INTERFACE_NAME": "lo"}).timeout_s == 1.5


def test_thresholds_come_as_a_dictionary() -> None:
    found = resolved({"thresholds": {"rssi_warn_dbm": -60}, "INTERFACE_NAME": "lo"})
    assert found.thresholds.rssi_warn_dbm == -60


def test_the_agent_waits_for_an_interface_that_is_not_there(caplog: pytest.LogCaptureFixture) -> None:
    options = msgspec.structs.replace(resolved({"INTERFACE_NAME": "nope0"}), end="station")
    with caplog.at_level("ERROR", logger="linkrover.ros1"):
        config = agent_config(options)
    assert config.wait
    assert config.role is Role.STATION
    assert config.probe.deadline_s == 2.0
