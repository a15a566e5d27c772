"""`linkrover model`: radio models fitted to recordings, and predictions from them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter

if TYPE_CHECKING:
    from linkrover.radio.presets import Preset

app = App(name="model", help="Fit radio models to recordings, and predict from them.")

Flag = Parameter(negative=())


@app.command
def fit(
    *runs: Path,
    access_point: Annotated[tuple[float, float] | None, Parameter(name="--access-point", negative=())] = None,
    end: str | None = None,
    together: Annotated[bool, Flag] = False,
    json: Annotated[bool, Flag] = False,
) -> int:
    """Fit path loss, shadowing, fading, the access point's place and throughput to runs, each with a 95 % interval.

    Needs odometry and RSSI. Every run is fitted on its own unless --together is given. A figure that the data do not
    bound is shown as such, with the reason, and never as a bare number.

    Examples:
      linkrover model fit runs/today --access-point 8.0 4.5
      linkrover model fit runs/trial1 runs/trial2 --together --json > fit.json

    Parameters
    ----------
    runs
        Runs: folders with robot/ and station/, recordings, or CSV files of 2021.
    access_point
        Where the other antenna stands: x and y in metres in the odometry's frame. Without it the place is fitted
        first, and the line is of distances from that place: its doubt is then not in the line's intervals.
    end
        Whose RSSI to take: robot or station. By default the end with more readings.
    together
        Fit all runs as one. Only right if their odometry began at the same place with the same heading.
    json
        One JSON object instead of tables; `linkrover model predict --fit` reads it.
    """
    import msgspec
    from rich.console import Console

    from linkrover.cli import _fitting
    from linkrover.errors import ConfigError

    if not runs:
        raise ConfigError("RUN: name at least one run")
    if end not in (None, "robot", "station"):
        raise ConfigError(f"--end {end}: must be robot or station")
    with Console(stderr=True).status("reading and fitting ..."):
        results = _fitting.fit_runs(runs, access_point, end, together)
    if json:
        print(msgspec.json.format(msgspec.json.encode({"fits": results}), indent=1).decode())
        return 0
    console = Console()
    for result in results:
        console.print(_fitting.table(result))
        for note in result.notes:
            console.print(f"  {note}", style="dim", highlight=False)
    return 0


@app.command
def predict(
    *,
    preset: str | None = None,
    fit: Path | None = None,
    rss_1m_dbm: float | None = None,
    exponent: float | None = None,
    sigma_db: float | None = None,
    nakagami_m: float | None = None,
    alpha_b_mhz: float | None = None,
    noise_dbm: float | None = None,
    cap_mbps: float | None = None,
    distance: Annotated[tuple[float, ...], Parameter(negative=(), consume_multiple=True)] = (1, 2, 5, 10, 15, 20),
    throughput_mbps: float | None = None,
    octets: int = 1_500_000,
    json: Annotated[bool, Flag] = False,
) -> int:
    """RSSI, throughput and transmission delay at distances, and how far a throughput reaches.

    Figures come from a preset of the 2021 laboratory, from a fit of your own, or from options, which replace single
    values of either. `RSSI 5 %` and `95 %`: between these lie nine readings of ten, by shadowing and multipath.

    Examples:
      linkrover model predict --preset internal-5 --distance 2 8 16
      linkrover model predict --fit fit.json --throughput-mbps 10
      linkrover model predict --rss-1m-dbm -40 --exponent 3 --alpha-b-mhz 5 --noise-dbm -90

    Parameters
    ----------
    preset
        router-2.4, router-5, internal-2.4, internal-5, external-2.4-robot, external-2.4-station or external-5.
    fit
        What `linkrover model fit --json` printed; its first fit is used.
    rss_1m_dbm
        Mean RSSI at 1 m, dBm.
    exponent
        Path-loss exponent.
    sigma_db
        Shadowing, dB.
    nakagami_m
        Multipath: Nakagami m.
    alpha_b_mhz
        Share of the channel times bandwidth (alpha_T * B), MHz.
    noise_dbm
        Noise, dBm.
    cap_mbps
        Highest throughput, Mbit/s.
    distance
        Distances, metres.
    throughput_mbps
        Also: the RSSI and the distance up to which this throughput is carried on average, Mbit/s.
    octets
        Size of the message whose transmission delay is shown.
    json
        One JSON object instead of a table.
    """
    from linkrover.cli import _prediction

    model: Preset = _prediction.assemble(
        preset,
        fit,
        {
            "rss_1m_dbm": rss_1m_dbm,
            "exponent": exponent,
            "sigma_db": sigma_db,
            "nakagami_m": nakagami_m,
            "alpha_b_hz": None if alpha_b_mhz is None else alpha_b_mhz * 1e6,
            "noise_dbm": noise_dbm,
            "cap_bps": None if cap_mbps is None else cap_mbps * 1e6,
        },
    )
    _prediction.show(model, distance, None if throughput_mbps is None else throughput_mbps * 1e6, octets, json)
    return 0
