"""Predictions from a preset, a fit or options."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import msgspec

from linkrover.errors import ConfigError
from linkrover.radio.fading import gamma_quantiles_db
from linkrover.radio.path_loss import LogDistance
from linkrover.radio.presets import Preset
from linkrover.radio.presets import preset as find_preset
from linkrover.radio.throughput import ShannonShare, transmission_delay_s

Z95 = 1.6449


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One distance."""

    distance_m: float
    rssi_dbm: float
    rssi_5_percent_dbm: float
    rssi_95_percent_dbm: float
    snr_db: float
    throughput_bps: float
    transmission_delay_s: float


def assemble(preset: str | None, fit: Path | None, options: dict[str, float | None]) -> Preset:
    """The model: options over the fit or the preset.

    Raises:
        ConfigError: neither preset nor fit nor enough options, both at once, or a fit without what is needed.
    """
    if preset is not None and fit is not None:
        raise ConfigError("--preset and --fit: give one of them")
    figures: dict[str, float | None] = {"sigma_db": 0.0, "nakagami_m": 1000.0, "frequency_mhz": 2437.0}
    name = "options"
    if preset is not None:
        name = preset
        base = find_preset(preset)
        figures |= {
            "rss_1m_dbm": base.path_loss.rss_1m_dbm,
            "exponent": base.path_loss.exponent,
            "sigma_db": base.sigma_db,
            "nakagami_m": base.nakagami_m,
            "alpha_b_hz": base.share.alpha_b_hz,
            "noise_dbm": base.share.noise_dbm,
            "cap_bps": base.share.cap_bps,
        }
    elif fit is not None:
        name = str(fit)
        figures |= _read(fit)
    figures |= {key: value for key, value in options.items() if value is not None}
    missing = [key for key in ("rss_1m_dbm", "exponent", "alpha_b_hz", "noise_dbm") if figures.get(key) is None]
    if missing:
        wanted = ", ".join("--" + key.replace("_", "-").replace("alpha-b-hz", "alpha-b-mhz") for key in missing)
        raise ConfigError(f"the model lacks {wanted}: give them, or --preset, or --fit")
    value: dict[str, Any] = figures
    return Preset(
        name=name,
        frequency_mhz=value["frequency_mhz"],
        path_loss=LogDistance(rss_1m_dbm=value["rss_1m_dbm"], exponent=value["exponent"]),
        sigma_db=value["sigma_db"],
        decorrelation_m=3.0,
        nakagami_m=value["nakagami_m"],
        share=ShannonShare(alpha_b_hz=value["alpha_b_hz"], noise_dbm=value["noise_dbm"], cap_bps=value.get("cap_bps")),
    )


def _read(file: Path) -> dict[str, float | None]:
    try:
        tree = msgspec.json.decode(file.read_bytes())
        figures = tree["fits"][0]["figures"]
        return {key: each["value"] for key, each in figures.items()}
    except OSError as error:
        raise ConfigError(f"--fit {file}: cannot be read: {error.strerror}") from error
    except (msgspec.DecodeError, KeyError, IndexError, TypeError, AttributeError) as error:
        raise ConfigError(f"--fit {file}: must be what `linkrover model fit --json` prints") from error


def rows(model: Preset, distances: tuple[float, ...], octets: int) -> list[Row]:
    """Predictions at distances.

    Raises:
        ConfigError: a distance that is not above 0, or negative sigma.
    """
    if model.sigma_db < 0:
        raise ConfigError(f"--sigma-db {model.sigma_db}: must be 0 or more")
    if not 0.5 <= model.nakagami_m <= 1000:
        raise ConfigError(f"--nakagami-m {model.nakagami_m}: must be 0.5 to 1000")
    low, high = _spread(model)
    out = []
    for distance in distances:
        rssi = float(model.path_loss.rssi_dbm(distance))
        throughput = float(model.share.throughput_bps(rssi))
        out.append(
            Row(
                distance_m=float(distance),
                rssi_dbm=rssi,
                rssi_5_percent_dbm=rssi + low,
                rssi_95_percent_dbm=rssi + high,
                snr_db=rssi - model.share.noise_dbm,
                throughput_bps=throughput,
                transmission_delay_s=float(transmission_delay_s(octets, throughput)),
            )
        )
    return out


def _spread(model: Preset) -> tuple[float, float]:
    """5 % and 95 % of shadowing plus multipath, dB: shadowing (normal) folded with the gamma quantiles."""
    fades = gamma_quantiles_db(model.nakagami_m)
    steps = [-4.5 + 0.05 * index for index in range(len(fades))]
    weights = [math.exp(-z * z / 2) for z in steps]
    total = sum(weights)

    def below(level: float) -> float:
        if model.sigma_db == 0:
            return sum(w for w, fade in zip(weights, fades, strict=True) if fade <= level) / total
        return sum(
            w * 0.5 * math.erfc((fade - level) / model.sigma_db / math.sqrt(2))
            for w, fade in zip(weights, fades, strict=True)
        ) / total  # fmt: skip

    return _solve(below, 0.05), _solve(below, 0.95)


def _solve(below: Any, share: float) -> float:
    low, high = -80.0, 80.0
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if below(middle) < share else (low, middle)
    return low


def show(model: Preset, distances: tuple[float, ...], throughput_bps: float | None, octets: int, as_json: bool) -> None:
    """Print the predictions."""
    found = rows(model, distances, octets)
    reach = None
    if throughput_bps is not None:
        needed = float(model.share.rssi_dbm(throughput_bps))
        reach = {
            "throughput_bps": throughput_bps,
            "rssi_dbm": needed,
            "distance_m": float(model.path_loss.distance_m(needed)),
        }
    if as_json:
        print(msgspec.json.encode({"model": model, "rows": found, "reach": reach}).decode())
        return
    from rich.console import Console
    from rich.table import Table

    table = Table(title=f"{model.name}: RSSI {model.path_loss.rss_1m_dbm:g} dBm at 1 m, exponent "
                  f"{model.path_loss.exponent:g}", title_justify="left")  # fmt: skip
    for heading in (
        "distance m", "RSSI dBm", "RSSI 5 %", "RSSI 95 %", "SNR dB", "Mbit/s", f"s for {octets / 1e6:g} MB",
    ):  # fmt: skip
        table.add_column(heading, justify="right")
    for row in found:
        table.add_row(
            f"{row.distance_m:g}",
            f"{row.rssi_dbm:.1f}",
            f"{row.rssi_5_percent_dbm:.1f}",
            f"{row.rssi_95_percent_dbm:.1f}",
            f"{row.snr_db:.1f}",
            f"{row.throughput_bps / 1e6:.3g}",
            f"{row.transmission_delay_s:.3g}",
        )
    console = Console()
    console.print(table)
    if reach is not None:
        console.print(
            f"{reach['throughput_bps'] / 1e6:g} Mbit/s needs {reach['rssi_dbm']:.1f} dBm: on average up to "
            f"{reach['distance_m']:.1f} m",
            highlight=False,
        )
