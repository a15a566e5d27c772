"""As `columns`, for the 2021 and the standard types. Mirrors messages/legacy, messages/standard and interpret."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import numpy.typing as npt
import polars as pl

from linkrover.messages.legacy import COUNTERS, ERRORS, NO_READING, NOTHING_YET
from linkrover.records import LinkUtilization, NetworkDelay, NetworkErrors, Pose, VelocityCommand, WirelessLink

from .blocks import Topic
from .columns import Convert, complete, null_where, number, repeated, stamps, texts
from .interpret import COUNTER_STEP, DEADLINE_2021_NS, RATES, STALE_STAMP_NS
from .layout import Columns, Indices, UnfitTypeError
from .patterns import Meaning


def foreign(topic: Topic, meaning: Meaning) -> Convert:
    """The conversion for this topic. Raises UnfitTypeError where messages must be read one by one."""
    if topic.type == "network_analysis/LinkUtilization":
        return _Utilization(meaning)
    if topic.type == "network_analysis/NetworkDelay":
        return _Delay(meaning)
    simple = {
        "network_analysis/NetworkErrors": _errors,
        "network_analysis/WirelessLink": _wireless,
        "nav_msgs/Odometry": _odometry,
        "geometry_msgs/Twist": _twist,
        "geometry_msgs/TwistStamped": _twist,
    }
    if topic.type not in simple:
        raise UnfitTypeError(topic.type)
    return functools.partial(simple[topic.type], meaning)


def _done(kind: Any, meaning: Meaning, columns: Columns, known: dict[str, Any]) -> tuple[pl.DataFrame, int]:
    frame = complete(kind, meaning.end, known, columns.rows)
    return (frame.filter(pl.Series(~columns.bad)) if columns.bad.any() else frame), 0


def _base(meaning: Meaning, columns: Columns, *, iface: bool) -> dict[str, Any]:
    wall_ns = stamps(columns)
    names = texts(columns, "iface", empty=(meaning.iface if iface else "") or "")
    return {"wall_ns": wall_ns, "mono_ns": wall_ns, "iface": names}


def _count(columns: Columns, path: str) -> pl.Series:
    values = number(columns, path).astype(np.int64)
    return null_where(pl.Series(values), values < 0)


def _reading(columns: Columns, path: str) -> pl.Series:
    values = number(columns, path).astype(np.float64)
    return null_where(pl.Series(values), (values == NO_READING) | (values == NOTHING_YET))


def _errors(meaning: Meaning, columns: Columns, _: Indices) -> tuple[pl.DataFrame, int]:
    known = _base(meaning, columns, iface=False)
    known |= {field: _count(columns, name) for name, field in ERRORS.items()}
    return _done(NetworkErrors, meaning, columns, known)


def _wireless(meaning: Meaning, columns: Columns, _: Indices) -> tuple[pl.DataFrame, int]:
    quality = number(columns, "lqi").astype(np.float64)
    known = _base(meaning, columns, iface=True) | {
        "source": repeated("source", "2021", pl.String, columns.rows),
        "connected": pl.Series(number(columns, "status") > 0),
        "ssid": texts(columns, "ssid", empty=None),
        "tx_power_dbm": _reading(columns, "txpower"),
        "rssi_dbm": _reading(columns, "rssi"),
        "link_quality": null_where(pl.Series(quality), ~(quality >= 0)),
        "noise_dbm": _reading(columns, "noise"),
    }
    return _done(WirelessLink, meaning, columns, known)


class _Delay:
    """NetworkDelay; keeps the last stamp, because the 2021 nodes stamp every sample alike."""

    def __init__(self, meaning: Meaning) -> None:
        self._meaning = meaning
        self._last: int | None = None

    def __call__(self, columns: Columns, times: Indices) -> tuple[pl.DataFrame, int]:
        delay = number(columns, "delay").astype(np.float64)
        stamp = stamps(columns)
        good = np.flatnonzero(~columns.bad)
        before = np.full(columns.rows, -1, dtype=np.int64)
        if len(good):
            before[good[1:]] = stamp[good[:-1]]
            before[good[0]] = -1 if self._last is None else self._last
            self._last = int(stamp[good[-1]])
        stale = (stamp == before) | (np.abs(times - stamp) > STALE_STAMP_NS)
        finite = np.where(np.isfinite(delay), delay, -1.0)
        with np.errstate(all="ignore"):
            whole = np.rint(finite * 1e6).astype(np.int64)
        wall_ns = np.where(stale, times - np.where(finite < 0, DEADLINE_2021_NS, whole), stamp)
        known = _base(self._meaning, columns, iface=True) | {
            "wall_ns": wall_ns,
            "mono_ns": wall_ns,
            "peer": repeated("peer", "", pl.String, columns.rows),
            "method": repeated("method", "ros1 action", pl.String, columns.rows),
            "delay_ns": null_where(pl.Series(whole), finite < 0),
            "alive": pl.Series(number(columns, "alive") > 0),
        }
        return _done(NetworkDelay, self._meaning, columns, known)


class _Utilization:
    """LinkUtilization; keeps the last row of every interface, from which the next batch's rates are reckoned."""

    def __init__(self, meaning: Meaning) -> None:
        self._meaning = meaning
        self._last: pl.DataFrame | None = None

    def __call__(self, columns: Columns, _: Indices) -> tuple[pl.DataFrame, int]:
        known = _base(self._meaning, columns, iface=True)
        known |= {field: _count(columns, name) for name, field in COUNTERS.items()}
        frame, _unfit = _done(LinkUtilization, self._meaning, columns, known)
        old = 0 if self._last is None else len(self._last)
        whole = frame if self._last is None else pl.concat([self._last, frame])
        self._last = whole.group_by("iface", maintain_order=True).last().select(frame.columns)
        return _with_rates(whole)[old:], 0


def _with_rates(frame: pl.DataFrame) -> pl.DataFrame:
    elapsed = pl.col("wall_ns") - pl.col("wall_ns").shift(1).over("iface")
    first = elapsed.is_null() | (elapsed <= 0)
    steps = {name: pl.col(name) - pl.col(name).shift(1).over("iface") for name, _, _ in RATES}
    reset = pl.any_horizontal([((step < 0) | (step >= COUNTER_STEP)).fill_null(value=False) for step in steps.values()])
    rates = [
        pl.when(first | reset).then(None).otherwise(steps[name] * factor * 1e9 / elapsed).alias(rate)
        for name, rate, factor in RATES
    ]
    continuity = pl.when(first).then(pl.lit("first")).when(reset).then(pl.lit("reset")).otherwise(pl.lit("steady"))
    interval = pl.when(first).then(None).otherwise(elapsed)
    found = frame.with_columns(*rates, continuity.alias("continuity"), interval.alias("interval_ns"))
    missing = [pl.when(pl.col(rate).is_null()).then(pl.lit(f"{rate}=no base")) for _, rate, _ in RATES]
    return found.with_columns(pl.concat_list(missing).list.drop_nulls().alias("unknown"))


def _odometry(meaning: Meaning, columns: Columns, _: Indices) -> tuple[pl.DataFrame, int]:
    wall_ns = stamps(columns)
    x, y, z, w = (number(columns, f"pose.pose.orientation.{axis}") for axis in "xyzw")
    with np.errstate(all="ignore"):  # a quaternion of a damaged message may be anything
        heading_rad = np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)
    known: dict[str, Any] = {
        "wall_ns": wall_ns,
        "mono_ns": wall_ns,
        "x_m": number(columns, "pose.pose.position.x"),
        "y_m": number(columns, "pose.pose.position.y"),
        "heading_rad": heading_rad,
        "forward_m_per_s": pl.Series(number(columns, "twist.twist.linear.x")).fill_nan(None),
        "turn_rad_per_s": pl.Series(number(columns, "twist.twist.angular.z")).fill_nan(None),
        "frame": texts(columns, "header.frame_id"),
    }
    return _done(Pose, meaning, columns, known)


def _twist(meaning: Meaning, columns: Columns, times: Indices) -> tuple[pl.DataFrame, int]:
    stamped = "twist.linear.x" in columns.columns
    place = "twist." if stamped else ""
    wall_ns: npt.NDArray[np.int64] = times
    if stamped:
        stamp = stamps(columns)
        wall_ns = np.where(stamp > 0, stamp, times)
    known: dict[str, Any] = {
        "wall_ns": wall_ns,
        "mono_ns": wall_ns,
        "forward_m_per_s": number(columns, f"{place}linear.x"),
        "sideways_m_per_s": number(columns, f"{place}linear.y"),
        "turn_rad_per_s": number(columns, f"{place}angular.z"),
    }
    return _done(VelocityCommand, meaning, columns, known)
