"""What a file name of the 2021 data says about its case and trial."""

from __future__ import annotations

import re
from pathlib import PurePath

import msgspec

# Table I of the paper: (adapter, where the access point is, band) -> case.
CASES: dict[tuple[str, str, str], int] = {
    ("internal", "router", "2.4 GHz"): 1,
    ("internal", "router", "5 GHz"): 2,
    ("internal", "robot", "2.4 GHz"): 3,
    ("internal", "robot", "5 GHz"): 4,
    ("internal", "station", "2.4 GHz"): 5,
    ("internal", "station", "5 GHz"): 6,
    ("external", "robot", "2.4 GHz"): 7,
    ("external", "robot", "5 GHz"): 8,
    ("external", "station", "2.4 GHz"): 9,
    ("external", "station", "5 GHz"): 10,
}
_FACTORS = {number: factors for factors, number in CASES.items()}


class Setup(msgspec.Struct, frozen=True, kw_only=True):
    """The set-up of one trial; `None` = the name does not say."""

    case: str | None = None
    trial: int | None = None
    ap: str | None = None  # router, robot, station
    band: str | None = None  # "2.4 GHz", "5 GHz"
    adapter: str | None = None  # internal, external

    def factors(self) -> dict[str, str]:
        """The known factors, as they go into a manifest's notes."""
        pairs = (("ap", self.ap), ("band", self.band), ("adapter", self.adapter))
        return {name: value for name, value in pairs if value is not None}


def guess_setup(path: str | PurePath, case: str | None = None, trial: int | None = None) -> Setup:
    """Case, trial and factors from a file name such as `external_robot_5G.csv` or `client/2G/trial2.csv`.

    "client" in a name means the access point was on the robot, "server" on the station. `case` and `trial` override
    what the name says; an overriding case 1 to 10 also gives the factors of Table I.
    """
    pure = PurePath(path)
    parents = [
        part
        for part in pure.parts[:-1]
        if re.fullmatch(
            r"(?i)(router|client|server|robot|station|internal|"
            r"external|2g|5g|trial\d*)",
            part,
        )
    ]
    words = [word for part in [*parents, pure.stem] for word in re.split(r"[^A-Za-z0-9.]+", part.lower()) if word]
    ap = next((place for word in words for key, place in _PLACES if word.startswith(key)), None)
    band = next(
        (
            "2.4 GHz" if m[1].startswith("2") else "5 GHz"
            for w in words
            if (m := re.fullmatch(r"(2\.?4?|5)g(?:hz)?", w))
        ),
        None,
    )
    adapter = next((kind for word in words for kind in ("internal", "external") if word.startswith(kind[:3])), None)
    if ap == "router":
        adapter = adapter or "internal"
    number = CASES.get((adapter or "internal", ap, band)) if ap and band else None
    if case is not None and case.isdigit() and int(case) in _FACTORS:
        adapter, ap, band = _FACTORS[int(case)]
    found = next((int(m[1]) for w in words if (m := re.match(r"trial(\d+)", w))), None)
    if found is None and number is not None:
        found = 1
    return Setup(
        case=case if case is not None else (str(number) if number is not None else None),
        trial=trial if trial is not None else found,
        ap=ap,
        band=band,
        adapter=adapter,
    )


_PLACES = (("router", "router"), ("client", "robot"), ("robot", "robot"), ("server", "station"), ("station", "station"))


def factors_of_case(case: str) -> dict[str, str]:
    """The factors a case's name tells: a number of Table I, or words such as `robot-ap-internal-2.4`."""
    if case.isdigit():
        return guess_setup("", case=case).factors()
    words = [word for word in re.split(r"[^a-z0-9.]+", case.lower()) if word]
    found = guess_setup(case).factors()
    band = next((m[1] for w in words if (m := re.fullmatch(r"(2\.4|5|6)(?:ghz|g)?", w))), None)
    if band is not None:
        found["band"] = f"{band} GHz"
    return found
