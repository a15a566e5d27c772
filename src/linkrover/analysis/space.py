"""The link over the floor: cells, an estimated map with its error, dead zones, the antenna's place, the budget."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import msgspec

from .addresses import stays_inside
from .delay import find_probes, hold_weights, outage_window
from .group import last_word
from .link import signal_steps
from .motion import position_at
from .run import End, Run

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

QUANTITIES = {"rssi": "dBm", "throughput": "Mbit/s", "delay": "ms"}
MOST_POINTS = 200  # of a Gaussian process: its cost grows with the cube
DEAD_RSSI_DBM = -80.0
WORST_WINDOW_S = 10.0


class Cell(msgspec.Struct, frozen=True, kw_only=True):
    """What was measured in one square of the floor; names of figures as in a need."""

    x_m: float  # of its middle
    y_m: float
    seconds: float
    rssi_dbm: float | None = None
    throughput: float | None = None
    mean: float | None = None  # time-outs at the deadline
    median: float | None = None
    p95: float | None = None
    p99: float | None = None
    loss: float | None = None
    outage: float | None = None


class Surface(msgspec.Struct, frozen=True, kw_only=True):
    """A quantity estimated over the floor: `mean[j][i]` at (`x_m[i]`, `y_m[j]`), with its standard error."""

    quantity: str
    unit: str
    x_m: list[float]
    y_m: list[float]
    mean: list[list[float]]
    standard_error: list[list[float]]
    points: int
    length_scale_m: float


class DeadZone(msgspec.Struct, frozen=True, kw_only=True):
    """A patch of driven floor where the link was out or weaker than the limit."""

    x_m: float
    y_m: float
    area_m2: float
    seconds: float
    worst_rssi_dbm: float | None = None
    outage_percent: float | None = None


class Anchor(msgspec.Struct, frozen=True, kw_only=True):
    """Where the other end's antenna is, from the signal along the way (log-distance law).

    `radius_m`: the standard error as a circle; it is of the fit, walls are not in it.
    """

    x_m: float
    y_m: float
    radius_m: float
    rssi_1m_dbm: float
    exponent: float
    sigma_db: float


class Budget(msgspec.Struct, frozen=True, kw_only=True):
    """What the topics send against what the link carried at its worst, Mbit/s."""

    sent: dict[str, float]  # by topic, from the robot
    total: float
    worst: float | None = None  # lowest throughput over any ten seconds of the drive
    fits: bool | None = None
    reason: str | None = None


def samples(run: Run, quantity: str) -> tuple[Floats, Floats]:
    """Times (s) and values of a quantity at the moving end: valid readings, interval rates, answered delays."""
    import numpy as np

    nothing = np.zeros(0)
    if quantity == "delay":
        probes = find_probes(run)
        if probes is None:
            return nothing, nothing
        known = np.isfinite(probes.delay_ms)
        return probes.sent_s[known], probes.delay_ms[known]
    if quantity == "throughput":
        robot = run.robot
        table = robot.utilization.get(robot.primary or "") if robot is not None else None
        if table is None:
            return nothing, nothing
        good = table["has_base"]
        begin, end = table["begin_s"][good], table["t_s"][good]
        return (begin + end) / 2, table["bits"][good] / (end - begin) / 1e6
    for place in (run.robot, run.station):
        table = _signal_table(place)
        if table is not None:
            _, _, valid, _ = signal_steps(table, run.published_2021)
            if valid.any():
                return table["t_s"][valid], table["rssi_dbm"][valid]
    return nothing, nothing


def _signal_table(end: End | None) -> Any:
    if end is None or end.primary is None:
        return None
    return end.wireless.get(end.primary)


def cell_figures(run: Run, cell_m: float = 2.0) -> list[Cell]:
    """Figures of every cell the robot was in; none without odometry."""
    import numpy as np

    pose = run.pose
    if pose is None or len(pose["t_s"]) < 2:
        return []
    x0, y0 = float(np.floor(pose["x_m"].min())), float(np.floor(pose["y_m"].min()))
    width = int((float(pose["x_m"].max()) - x0) / cell_m) + 1

    def cells_of(t: Floats) -> NDArray[np.int64]:
        x, y = position_at(run, t)
        known = np.isfinite(x)
        index = np.full(len(t), -1, np.int64)
        index[known] = ((y[known] - y0) / cell_m).astype(int) * width + ((x[known] - x0) / cell_m).astype(int)
        return index

    seconds = np.minimum(np.diff(pose["t_s"]), 1.0)
    at = cells_of(pose["t_s"][:-1])
    stayed = np.bincount(at[at >= 0], seconds[at >= 0])
    found: dict[int, dict[str, float]] = {int(i): {"seconds": float(stayed[i])} for i in np.flatnonzero(stayed > 0)}
    for name, quantity in (("rssi_dbm", "rssi"), ("throughput", "throughput")):
        t, values = samples(run, quantity)
        _means(found, name, cells_of(t), values)
    probes = find_probes(run)
    if probes is not None:
        where = cells_of(probes.sent_s)
        lost = np.isnan(probes.delay_ms)
        weights = hold_weights(probes, run.span)
        _means(found, "loss", where, lost * 100.0)
        _means(found, "mean", where, np.where(lost, probes.deadline_ms, probes.delay_ms))
        for index, figures in found.items():
            here = where == index
            total = float(weights[here].sum())
            if total > 0:
                figures["outage"] = 100.0 * float(weights[here & lost].sum()) / total
            answered = probes.delay_ms[here & ~lost]
            if len(answered):
                figures["median"], figures["p95"], figures["p99"] = (
                    float(v) for v in np.quantile(answered, (0.5, 0.95, 0.99))
                )
    return [
        Cell(x_m=x0 + (index % width + 0.5) * cell_m, y_m=y0 + (index // width + 0.5) * cell_m, **figures)
        for index, figures in sorted(found.items())
    ]


def _means(found: dict[int, dict[str, float]], name: str, where: NDArray[np.int64], values: Floats) -> None:
    import numpy as np

    kept = where >= 0
    if not kept.any():
        return
    count = np.bincount(where[kept])
    total = np.bincount(where[kept], values[kept])
    for index in np.flatnonzero(count):
        if int(index) in found:
            found[int(index)][name] = float(total[index] / count[index])


def surface(run: Run, quantity: str = "rssi", resolution_m: float = 0.5, margin_m: float = 1.0) -> Surface | None:
    """The quantity over the floor by a Gaussian process (Matern 3/2 plus noise), with its standard error.

    Samples are first averaged along the way to at most 200 points, so that standing still does not count for more.
    `None` where there is no odometry or are fewer than 10 places.
    """
    import warnings

    import numpy as np
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel
    from threadpoolctl import threadpool_limits

    found = along_the_way(run, quantity)
    if found is None:
        return None
    x, y, values = found
    if len(x) < 10:
        return None
    level, scale = float(values.mean()), float(values.std()) or 1.0
    kernel = ConstantKernel(1.0, (0.05, 20)) * Matern(3.0, (0.5, 50), nu=1.5) + WhiteKernel(0.1, (1e-3, 5))
    model = GaussianProcessRegressor(kernel, random_state=0)
    with warnings.catch_warnings(), threadpool_limits(1):  # matrices this small only wait for each other's threads
        warnings.simplefilter("ignore", ConvergenceWarning)  # a bound reached is a bound kept
        model.fit(np.stack([x, y], axis=1), (values - level) / scale)
    xs = np.arange(x.min() - margin_m, x.max() + margin_m + resolution_m, resolution_m)
    ys = np.arange(y.min() - margin_m, y.max() + margin_m + resolution_m, resolution_m)
    grid = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)
    with threadpool_limits(1):
        mean, error = model.predict(grid, return_std=True)
    noise = float(model.kernel_.k2.noise_level)
    smooth = np.sqrt(np.maximum(error**2 - noise, 0.0))  # of the surface, not of a next reading
    shape = (len(ys), len(xs))
    return Surface(
        quantity=quantity,
        unit=QUANTITIES[quantity],
        x_m=xs.tolist(),
        y_m=ys.tolist(),
        mean=(mean * scale + level).reshape(shape).tolist(),
        standard_error=(smooth * scale).reshape(shape).tolist(),
        points=len(x),
        length_scale_m=float(model.kernel_.k1.k2.length_scale),
    )


def along_the_way(run: Run, quantity: str) -> tuple[Floats, Floats, Floats] | None:
    """Places (x, y in m) and mean values of a quantity along the way, at most 200; `None` without odometry."""
    import numpy as np

    t, values = samples(run, quantity)
    if run.pose is None or not len(t):
        return None
    x, y = position_at(run, t)
    known = np.isfinite(x) & np.isfinite(values)
    x, y, values = x[known], y[known], values[known]
    if not len(x):
        return None
    size = 0.25
    while True:
        key = np.round(x / size).astype(np.int64) * 1_000_003 + np.round(y / size).astype(np.int64)
        places, member = np.unique(key, return_inverse=True)
        if len(places) <= MOST_POINTS:
            break
        size *= 1.3
    count = np.bincount(member)
    return np.bincount(member, x) / count, np.bincount(member, y) / count, np.bincount(member, values) / count


def dead_zones(run: Run, cell_m: float = 1.0, rssi_dbm: float = DEAD_RSSI_DBM) -> list[DeadZone]:
    """Connected patches of driven cells that were out for more than half of the time or below the signal limit."""
    bad = {
        (math.floor(c.x_m / cell_m), math.floor(c.y_m / cell_m)): c
        for c in cell_figures(run, cell_m)
        if (c.outage or 0.0) > 50.0 or (c.rssi_dbm is not None and c.rssi_dbm < rssi_dbm)
    }
    zones: list[DeadZone] = []
    left = set(bad)
    while left:
        patch, edge = set[tuple[int, int]](), [left.pop()]
        while edge:
            here = edge.pop()
            patch.add(here)
            near = {(here[0] + i, here[1] + j) for i in (-1, 0, 1) for j in (-1, 0, 1)} & left
            left -= near
            edge += near
        cells = [bad[key] for key in patch]
        seconds = sum(c.seconds for c in cells)
        readings = [c.rssi_dbm for c in cells if c.rssi_dbm is not None]
        probed = [(c.outage, c.seconds) for c in cells if c.outage is not None]
        probed_s = sum(s for _, s in probed)
        zones.append(
            DeadZone(
                x_m=sum(c.x_m * c.seconds for c in cells) / seconds,
                y_m=sum(c.y_m * c.seconds for c in cells) / seconds,
                area_m2=len(cells) * cell_m**2,
                seconds=seconds,
                worst_rssi_dbm=min(readings) if readings else None,
                outage_percent=sum(o * s for o, s in probed) / probed_s if probed_s > 0 else None,
            )
        )
    return sorted(zones, key=lambda z: -z.seconds)


def locate_anchor(run: Run, reach_m: float = 15.0) -> Anchor | None:
    """Position of the fixed end's antenna: the log-distance law fitted over a grid of places.

    `None` without odometry, with fewer than 20 places, or where the best law is none a radio could follow (exponent
    outside 1 to 7, or the place at the edge of the search): then the drive does not tell where the antenna is.
    """
    import numpy as np

    found = along_the_way(run, "rssi")
    if found is None or len(found[0]) < 20:
        return None
    x, y, rssi = found
    centre: tuple[float, float] | None = None
    step, xs, ys = 1.0, np.arange(x.min() - reach_m, x.max() + reach_m), np.arange(y.min() - reach_m, y.max() + reach_m)
    inside_x, inside_y = (float(xs[0]) + 1, float(xs[-1]) - 1), (float(ys[0]) + 1, float(ys[-1]) - 1)
    best: tuple[Floats, Floats, Floats, Floats] | None = None
    for _ in range(2):
        gx, gy = (g.ravel() for g in np.meshgrid(xs, ys))
        law = np.log10(np.maximum(np.hypot(gx[:, None] - x, gy[:, None] - y), 0.5)) * 10
        dl, dr = law - law.mean(axis=1, keepdims=True), rssi - rssi.mean()
        slope = np.minimum((dl * dr).sum(axis=1) / (dl**2).sum(axis=1), 0.0)
        error = ((dr - slope[:, None] * dl) ** 2).sum(axis=1)
        at = int(np.argmin(error))
        centre = float(gx[at]), float(gy[at])
        best = (gx, gy, error, slope)
        if slope[at] == 0:
            return None
        span, step = 3 * step, step / 5
        xs, ys = (
            np.arange(centre[0] - span, centre[0] + span, step),
            np.arange(centre[1] - span, centre[1] + span, step),
        )
    assert best is not None
    assert centre is not None
    gx, gy, error, slope = best
    at = int(np.argmin(error))
    if not 1.0 <= -slope[at] <= 7.0 or not (
        inside_x[0] < centre[0] < inside_x[1] and inside_y[0] < centre[1] < inside_y[1]
    ):
        return None
    variance = float(error[at]) / max(len(x) - 4, 1)
    # neighbouring places share their shadowing: about one independent place every three metres of way
    independent = max(5.0, len(x) * 0.25 / 3.0)
    inside = error <= error[at] + variance * len(x) / independent
    radius = (
        float(np.sqrt(((gx[inside] - centre[0]) ** 2 + (gy[inside] - centre[1]) ** 2).max())) if inside.any() else 0.0
    )
    law_here = np.log10(np.maximum(np.hypot(x - centre[0], y - centre[1]), 0.5)) * 10
    return Anchor(
        x_m=centre[0],
        y_m=centre[1],
        radius_m=max(radius, step),
        rssi_1m_dbm=float(rssi.mean() - slope[at] * law_here.mean()),
        exponent=float(-slope[at]),
        sigma_db=float(np.sqrt(variance)),
    )


def link_budget(run: Run) -> Budget:
    """Sum of what the robot's topics send against the worst ten seconds of the drive's throughput."""
    import numpy as np

    sent: dict[str, float] = {}
    robot = run.robot
    for (topic, direction, *_), table in (robot.traffic if robot is not None else {}).items():
        if robot is None or stays_inside(robot, last_word(table.get("local")), last_word(table.get("remote"))):
            continue
        rates = table["rate_bps"][np.isfinite(table["rate_bps"])]
        if direction == "out" and len(rates):
            sent[topic] = sent.get(topic, 0.0) + float(rates.mean()) / 1e6
    t, rate = samples(run, "throughput")
    worst = None
    if len(t) > 1:
        edges = np.arange(t[0], t[-1] + WORST_WINDOW_S / 2, WORST_WINDOW_S / 2)
        means = [rate[(t >= a) & (t < a + WORST_WINDOW_S)] for a in edges[:-1]]
        known = [float(m.mean()) for m in means if len(m) >= 3]
        worst = min(known) if known else None
    total = sum(sent.values())
    reason = None if sent else "no topic statistics were recorded (run the agent with ROS to have them)"
    return Budget(
        sent=sent, total=total, worst=worst, fits=total <= worst if sent and worst is not None else None, reason=reason
    )


def outage_places(run: Run) -> list[tuple[float, float]]:
    """Where outages began, m."""
    out, _ = outage_window(find_probes(run), run.span)
    x, y = position_at(run, out.begins)
    return [(float(a), float(b)) for a, b in zip(x, y, strict=True) if a == a]
