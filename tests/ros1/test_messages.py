"""Our classes against the real tools: md5sums, generation, and exchange with C++."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.middleware.contract import ROOT

from .conftest import Master, Programs

GENERATED = ROOT / "src/linkrover/ros1/generated"


def ours() -> list[str]:
    return sorted(
        f"{package}/{file.stem}"
        for package in ("network_analysis", "linkrover_msgs")
        for file in (ROOT / "src/linkrover/messages" / package / "msg").glob("*.msg")
    )


def test_the_shipped_classes_are_what_genpy_makes_of_the_texts_now(tmp_path: Path) -> None:
    subprocess.run([sys.executable, "scripts/generate-ros1-messages", str(tmp_path / "out")], cwd=ROOT, check=True)
    made = {f.relative_to(tmp_path / "out"): f.read_bytes() for f in (tmp_path / "out").rglob("*.py")}
    shipped = {f.relative_to(GENERATED): f.read_bytes() for f in GENERATED.rglob("*.py")}
    assert made.keys() == shipped.keys(), "run scripts/generate-ros1-messages"
    assert made == shipped, "run scripts/generate-ros1-messages"


def test_md5sums_are_the_published_ones() -> None:
    from linkrover.ros1.types import PUBLISHED_MD5, message_class

    assert {name: message_class(name)._md5sum for name in PUBLISHED_MD5} == PUBLISHED_MD5


def test_rosmsg_computes_the_same_md5sums_from_the_catkin_packages(master: Master) -> None:
    from linkrover.ros1.types import message_class

    for name in ("network_analysis/NetworkAnalysis", "network_analysis/WirelessLinkVector", "linkrover_msgs/Manifest"):
        told = subprocess.run(["rosmsg", "md5", name], env=master.environment(), capture_output=True, text=True)
        assert told.stdout.strip() == message_class(name)._md5sum, name + told.stderr


def test_generated_code_says_that_it_is() -> None:
    assert all(f.read_text().startswith("# @generated") for f in GENERATED.rglob("_*.py") if f.stat().st_size > 0)


def test_a_type_that_is_not_installed_is_an_error_that_says_what_to_install() -> None:
    from linkrover.ros1.types import Ros1MissingError, message_class

    with pytest.raises(Ros1MissingError, match=r"foo_msgs/Bar is not installed: apt install ros-noetic-foo-msgs"):
        message_class("foo_msgs/Bar")


@pytest.mark.parametrize(
    "name", ["nav_msgs/Odometry", "visualization_msgs/MarkerArray", "diagnostic_msgs/DiagnosticArray"]
)
def test_packages_that_are_there_as_texts_only_get_their_classes_in_memory(name: str) -> None:
    from linkrover.ros1.types import message_class

    assert message_class(name)._type == name


def test_the_users_workspace_comes_before_the_shipped_classes(tmp_path: Path) -> None:
    package = tmp_path / "network_analysis"
    (package / "msg").mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "msg/__init__.py").write_text("class NetworkDelay:\n    _md5sum = 'theirs'\n")
    code = (
        "from linkrover.ros1.types import message_class; print(message_class('network_analysis/NetworkDelay')._md5sum)"
    )
    told = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env={"PYTHONPATH": str(tmp_path)}
    )
    assert told.stdout.strip() == "theirs"
    assert "the published one is 6050d41552a71fd0a5d0a11f9f6b844d" in told.stderr


EXCHANGE = """
import json, sys, time
import rospy
from linkrover.ros1.fill import build, plain
from linkrover.ros1.types import message_class

samples = json.loads(sys.stdin.read())
rospy.init_node("exchange")
back = {}
pubs, subs = {}, []
for name in samples:
    cls = message_class(name)
    subs.append(rospy.Subscriber("out/" + name, cls, lambda m, n=name: back.setdefault(n, m)))
    pubs[name] = rospy.Publisher("in/" + name, cls, queue_size=1)
sent = {name: build(name, fields) for name, fields in samples.items()}
until = time.monotonic() + 60
while len(back) < len(samples) and time.monotonic() < until:
    for name, pub in pubs.items():
        if name not in back and pub.get_num_connections():
            pub.publish(sent[name])
    time.sleep(0.1)
wrong = []
for name in samples:
    if name not in back:
        wrong.append(name + ": never came back")
    else:
        a, b = plain(sent[name]), plain(back[name])
        for m in (a, b):
            m.get("header", {}).pop("seq", None)
        if repr(a) != repr(b):
            wrong.append(f"{name}: {a} became {b}")
print(json.dumps(wrong))
"""


def sample(name: str) -> dict[str, object]:
    """Every field set to something that is not its default."""
    from linkrover.ros1.types import message_class

    cls = message_class(name)
    values: dict[str, object] = {}
    for index, (field, kind) in enumerate(zip(cls.__slots__, cls._slot_types, strict=True), 1):
        base, array, count = kind.partition("[")
        one: object
        if base == "std_msgs/Header":
            one = {"stamp": {"sec": 1_600_000_000, "nanosec": index}, "frame_id": "wlan0"}
        elif "/" in base:
            one = sample(base)
        elif base == "string":
            one = f"text {index} \u00e4"
        elif base.startswith("float"):
            one = index + 0.5
        elif base == "bool":
            one = True
        elif base in ("time", "duration"):
            one = {"sec": index, "nanosec": index}
        else:
            one = index
        values[field] = [one] * int(count.rstrip("]") or 2) if array else one
    return values


def test_every_message_type_survives_the_way_through_cpp(master: Master, programs: Programs, cpp_peers: Path) -> None:
    names = ours()
    programs.start([str(cpp_peers / "echo")], master.environment())
    told = subprocess.run(
        [sys.executable, "-c", EXCHANGE],
        input=json.dumps({name: sample(name) for name in names}),
        env=master.environment(),
        capture_output=True,
        text=True,
        timeout=110,
    )
    assert told.returncode == 0, told.stderr
    assert json.loads(told.stdout.splitlines()[-1]) == []
    assert len(names) > 20


def test_rospy_is_what_debian_or_ubuntu_installed() -> None:
    spec = importlib.util.find_spec("rospy")
    assert spec is not None
    assert spec.origin is not None
    assert ".venv" not in spec.origin
