"""Sentences on places: dead zones, where the other antenna is, whether the topics fit."""

from __future__ import annotations

from linkrover.analysis.run import Run
from linkrover.analysis.space import dead_zones, link_budget, locate_anchor

MOST_ZONES = 3


def place_words(run: Run) -> list[str]:
    """What the floor and the topics say of one run; nothing where there is no odometry."""
    words = []
    if run.pose is not None:
        zones = dead_zones(run)
        for zone in zones[:MOST_ZONES]:
            signal = f", RSSI down to {zone.worst_rssi_dbm:.0f} dBm" if zone.worst_rssi_dbm is not None else ""
            out = f", out {zone.outage_percent:.0f} % of that time" if zone.outage_percent is not None else ""
            words.append(
                f"Dead zone around x = {zone.x_m:.1f} m, y = {zone.y_m:.1f} m ({zone.area_m2:.0f} m² driven, "
                f"{zone.seconds:.0f} s{out}{signal})."
            )
        if len(zones) > MOST_ZONES:
            words.append(f"{len(zones) - MOST_ZONES} smaller dead zones are not listed.")
        anchor = locate_anchor(run)
        if anchor is not None:
            words.append(
                f"The fixed end's antenna is estimated at x = {anchor.x_m:.1f} m, y = {anchor.y_m:.1f} m (± "
                f"{anchor.radius_m:.1f} m): {anchor.rssi_1m_dbm:.0f} dBm at 1 m, falling with exponent "
                f"{anchor.exponent:.1f}, {anchor.sigma_db:.1f} dB of shadowing."
            )
    budget = link_budget(run)
    if budget.sent and budget.worst is not None:
        fits = "fits" if budget.fits else "does not fit"
        words.append(
            f"Link budget: the robot's topics send {budget.total:.1f} Mbit/s in all, the worst ten seconds of the "
            f"drive carried {budget.worst:.1f} Mbit/s: it {fits}."
        )
    return words
