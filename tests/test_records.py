from __future__ import annotations

import dataclasses
import enum
import functools
import operator
import time
import types
import typing

import msgspec
import pytest

from linkrover import records
from linkrover.records import LinkEvent, NetworkErrors, Pose, Record, Unknown, WirelessLink, now

KINDS = sorted(
    (
        kind
        for kind in vars(records).values()
        if isinstance(kind, type) and issubclass(kind, Record) and kind is not Record
    ),
    key=lambda kind: kind.__name__,
)
UNIT_ENDINGS = (
    "_ns", "_us", "_ms", "_s", "_bps", "_dbm", "_db", "_mhz", "_bytes", "_packets", "_m", "_rad", "_per_s", "_ppb",
    "_max", "_percent",
)  # fmt: skip


@pytest.fixture(params=KINDS, ids=lambda kind: kind.__name__)
def kind(request):
    return request.param


def hints(kind):
    return typing.get_type_hints(kind)


def example(kind, **given):
    """A record with the least that must be given."""
    values = {}
    for field in msgspec.structs.fields(kind):
        if field.required and field.name not in given:
            values[field.name] = plain(field.type)
    return kind(**{**values, **given})


def plain(annotation):
    if isinstance(annotation, type) and issubclass(annotation, enum.Enum):
        return next(iter(annotation))
    return {int: 1, float: 1.5, str: "x", bool: True}[annotation]


def test_every_record_is_exported_and_frozen(kind):
    assert kind.__name__ in records.__all__
    record = example(kind)
    with pytest.raises((AttributeError, dataclasses.FrozenInstanceError)):
        record.wall_ns = 2


def test_every_record_has_both_clocks_and_reasons(kind):
    names = {field.name for field in msgspec.structs.fields(kind)}
    assert {"wall_ns", "mono_ns", "unknown"} <= names


def test_every_float_and_time_carries_its_unit_in_its_name(kind):
    shares = {"utilization", "link_quality", "pose_heading"}
    for name, annotation in hints(kind).items():
        kinds = set(typing.get_args(annotation)) if isinstance(annotation, types.UnionType) else {annotation}
        if float in kinds and name not in shares:
            assert name.endswith(UNIT_ENDINGS), f"{kind.__name__}.{name} has no unit in its name"


def test_every_record_survives_json_with_its_name(kind):
    record = example(kind, unknown={"wall_ns": Unknown.STALE})
    data = msgspec.json.encode(record)
    assert msgspec.json.decode(data)["type"] == kind.__name__
    assert msgspec.json.decode(data, type=kind) == record


def test_all_records_are_told_apart_by_their_name():
    union = functools.reduce(operator.or_, KINDS)
    decoder = msgspec.json.Decoder(union)
    for kind in KINDS:
        assert type(decoder.decode(msgspec.json.encode(example(kind)))) is kind


def test_unknown_is_none_by_default_never_a_number():
    link = WirelessLink(wall_ns=1, mono_ns=1, iface="w", source="wext")
    errors = NetworkErrors(wall_ns=1, mono_ns=1, iface="w")
    assert link.rssi_dbm is link.noise_dbm is link.connected is None
    assert errors.tcp_retransmits is errors.mac_tx_retries is None


def test_a_record_of_the_wrong_kind_is_refused_on_decoding():
    with pytest.raises(msgspec.ValidationError):
        msgspec.json.decode(b'{"type":"Pose","wall_ns":1,"mono_ns":1,"x_m":"1","y_m":0,"heading_rad":0}', type=Pose)
    with pytest.raises(msgspec.ValidationError):
        msgspec.json.decode(b'{"type":"Pose","wall_ns":1,"mono_ns":1}', type=LinkEvent)


def test_now_reads_both_clocks_at_one_instant():
    wall, mono = time.time_ns(), time.monotonic_ns()
    stamp = now()
    assert wall <= stamp.wall_ns <= time.time_ns()
    assert mono <= stamp.mono_ns <= time.monotonic_ns()
