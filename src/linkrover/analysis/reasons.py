"""No `null` without a word on why: fills the `reason` of every group of figures."""

from __future__ import annotations

from typing import TypeVar

import msgspec

S = TypeVar("S", bound=msgspec.Struct)

# Why a field may be unknown although its group is known.
_WHY = {
    "mean_ci95": "too few samples",
    "median_ci95": "too few independent samples",
    "p95_ci95": "too few independent samples",
    "p99_ci95": "too few independent samples",
    "loss_ci95": "too few independent samples",
    "loss_forward_percent": "given for the whole run only, where the probe tells directions",
    "loss_back_percent": "given for the whole run only, where the probe tells directions",
    "forward": "no one-way delay without a clock offset",
    "back": "no one-way delay without a clock offset",
    "duplicates": "this probe does not count them",
    "reordered": "this probe does not count them",
    "mac_retries": "not recorded for this interface",
    "link_quality": "given by the paper's method only",
    "static_no_lead": "given by the paper's method only",
    "outage_threshold_s": "the paper's method has none",
    "std": "fewer than two samples",
    "offset_ms": "not measured",
    "error_bound_ms": "not measured",
    "jitter": "given for the whole run only",
    "ipdv_p95": "given for the whole run only",
    "pdv_p95": "given for the whole run only",
    "pdv_p99": "given for the whole run only",
    "x_m": "no odometry",
    "y_m": "no odometry",
    "distance_m": "no odometry",
    "rssi_dbm": "no reading",
    **dict.fromkeys(
        (
            "tx_rate_median_mbps",
            "tx_rate_p5_mbps",
            "tx_mode",
            "tx_mcs_median",
            "tx_mcs_p5",
            "tx_streams",
            "rx_rate_median_mbps",
            "rx_mcs_median",
            "frames_sent",
            "retries",
            "retries_percent",
            "failed",
            "beacon_losses",
            "receiving_percent",
            "sending_percent",
            "noise_dbm",
            "noise_max_dbm",
        ),
        "not given by this driver",
    ),
    "peer_is": "of neither end's interfaces",
    "load_percent": "its access point does not tell (no BSS Load element)",
    "load_stations": "its access point does not tell (no BSS Load element)",
    "strongest_co_channel_dbm": "no such network",
    "strongest_adjacent_dbm": "no such network",
    "process": "not permitted, or no program holds it",
    "on_host": "its addresses are unknown",
    "retransmitted_percent": "nothing was sent, or this kernel does not count it",
    "receiver_limited_percent": "there was nothing to send, or this kernel does not count it",
    "buffer_limited_percent": "there was nothing to send, or this kernel does not count it",
    "lateness_median_ms": "no sample was due",
    "lateness_max_ms": "no sample was due",
    "received_to_sent": "nothing was sent",
}


def with_reasons(figures: S) -> S:
    """The same figures, every group with unknown members saying why in its `reason`."""
    changes: dict[str, object] = {}
    members = figures.__struct_fields__
    for member in members:
        value = getattr(figures, member)
        if isinstance(value, msgspec.Struct):
            changes[member] = with_reasons(value)
        elif isinstance(value, dict) and any(isinstance(v, msgspec.Struct) for v in value.values()):
            changes[member] = {k: with_reasons(v) if isinstance(v, msgspec.Struct) else v for k, v in value.items()}
        elif isinstance(value, list) and value and isinstance(value[0], msgspec.Struct):
            changes[member] = [with_reasons(v) for v in value]
    names = set(members)
    if "reason" in names:
        reason = getattr(figures, "reason") or ""  # noqa: B009 - only some structs have the field
        unknown = [n for n in sorted(names - {"reason"}) if getattr(figures, n) is None]
        if reason and len(unknown) > len(names) / 2:
            unknown = []  # the reason given is that of the whole group
        by_why: dict[str, list[str]] = {}
        for name in unknown:
            if name not in reason:
                by_why.setdefault(_WHY.get(name, "not in this recording"), []).append(name)
        parts = [reason, *(f"{', '.join(found)}: {why}" for why, found in by_why.items())]
        changes["reason"] = "; ".join(p for p in parts if p) or None
    return msgspec.structs.replace(figures, **changes) if changes else figures
