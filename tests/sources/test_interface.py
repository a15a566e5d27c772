from __future__ import annotations

import pytest

from linkrover.errors import ConfigError
from linkrover.records import EventKind
from linkrover.sources.interface import InterfaceSocket, InterfaceWatch, check_name, interface_names, no_such_interface
from tests.namespace import Namespace


@pytest.fixture
def space():
    space = Namespace()
    yield space
    space.close()


class Changes(list):
    def __call__(self, iface, kind, detail):
        self.append((iface, kind))


def watch_in(space, name, changes):
    return space.run(lambda: InterfaceWatch(name, sockets=InterfaceSocket(), on_change=changes))


@pytest.mark.parametrize("name", ["", "a" * 16, "a/b", "..", ".", "a b", "eth0:1", "a\0b", "ü" * 8])
def test_a_name_the_kernel_cannot_give_is_refused(name):
    with pytest.raises(ConfigError):
        check_name(name)


def test_the_error_for_an_absent_interface_names_those_there_are_and_the_nearest():
    text = str(no_such_interface("wlna0", ["lo", "wlan0"]))
    assert "lo, wlan0" in text
    assert "did you mean wlan0?" in text


def test_a_watch_stays_in_the_namespace_it_was_made_in(space):
    space.ip("link add only0 type veth peer name only1")
    watch = watch_in(space, "only0", None)
    assert "only0" not in interface_names()
    assert watch.look().index is not None


def test_an_interface_that_is_deleted_and_made_again_is_gone_and_back(space):
    space.ip("link add v0 type veth peer name v1")
    changes = Changes()
    watch = watch_in(space, "v0", changes)
    first = watch.look()
    space.ip("link delete v0")
    gone = watch.look()
    assert (gone.index, gone.epoch) == (None, first.epoch + 1)
    space.ip("link add v0 type veth peer name v1")
    back = watch.look()
    assert back.index not in (None, first.index)
    assert back.epoch > gone.epoch
    assert changes == [("v0", EventKind.INTERFACE_GONE), ("v0", EventKind.INTERFACE_BACK)]


def test_a_device_replaced_between_two_looks_is_noticed(space):
    space.ip("link add v0 type veth peer name v1")
    changes = Changes()
    watch = watch_in(space, "v0", changes)
    first = watch.look()
    space.ip("link delete v0")
    space.ip("link add v0 type veth peer name v1")
    assert watch.look().epoch > first.epoch
    assert [kind for _, kind in changes] == [EventKind.INTERFACE_GONE, EventKind.INTERFACE_BACK]


def test_a_renamed_device_is_followed_and_its_counters_go_on(space):
    space.ip("link add v0 type veth peer name v1")
    changes = Changes()
    watch = watch_in(space, "v0", changes)
    first = watch.look()
    space.ip("link set v0 name w0")
    second = watch.look()
    assert (second.index, second.name, second.epoch) == (first.index, "w0", first.epoch)
    assert changes == [("v0", EventKind.INTERFACE_RENAMED)]
    # a newcomer under the old name is another device
    space.ip("link add v0 type veth peer name x1")
    assert watch.look().name == "w0"


def test_a_device_moved_to_another_namespace_is_gone(space):
    space.ip("link add v0 type veth peer name v1")
    watch = watch_in(space, "v0", None)
    watch.look()
    other = Namespace()
    space.ip(f"link set v0 netns {other.path}")
    assert watch.look().index is None
    other.close()


def test_a_hot_plugged_interface_is_found(space):
    changes = Changes()
    watch = watch_in(space, "v0", changes)
    assert watch.look().index is None
    space.ip("link add v0 type veth peer name v1")
    assert watch.look().index is not None
    assert changes == [("v0", EventKind.INTERFACE_BACK)]


def test_hardware_address_and_mtu_are_the_kernels(space):
    space.ip("link add v0 address 02:00:00:00:00:07 mtu 1400 type veth peer name v1")
    sockets = space.run(InterfaceSocket)
    assert (sockets.mac("v0"), sockets.mtu("v0"), sockets.mac("lo")) == ("02:00:00:00:00:07", 1400, None)
    assert sockets.name(sockets.index("v0")) == "v0"
    assert (sockets.index("nosuch0"), sockets.name(99999)) == (None, None)
