from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkrover.analysis import RunSummary, load_run, summarise
from linkrover.analysis.delay import DelayFigures
from linkrover.analysis.effects import METRICS, Effect, factor_effects, holm, paired_effect, permutation_p
from linkrover.analysis.link import SignalFigures, ThroughputFigures
from linkrover.analysis.matching import still_against_moving, still_effects
from linkrover.analysis.needs import next_trial_chance, parse_needs, recommend
from linkrover.analysis.regression import compare_runs, parse_limit
from linkrover.analysis.summary import ClockFigures, EndFigures, InterfaceFigures, PartFigures
from linkrover.errors import ConfigError
from linkrover.report.comparison import effect_words
from tests.analysis.made import record_run
from tests.datasets import FILES, dataset


def summary(case: str, trial: int, throughput: float, delay: float = 20.0, loss: float = 0.0, **factors: str) -> Any:
    figures = InterfaceFigures(
        throughput_mbps=ThroughputFigures(mean=throughput, connected_mean=throughput), rssi_dbm=SignalFigures()
    )
    found = DelayFigures(
        median=delay, p95=2 * delay, p99=3 * delay, censored_mean=delay, time_out_percent=loss, loss_percent=loss
    )
    end = EndFigures(interfaces={"wlan0": figures}, primary="wlan0")
    part = PartFigures(delay_ms=found, ends={"robot": end})
    return RunSummary(
        method="linkrover", run=f"{case}-{trial}", case=case, trial=trial, factors=factors, duration_s=300.0,
        delay_ms=found, ends={"robot": end}, static=part, moving=part, clock=ClockFigures(method="none"),
    )  # fmt: skip


def campaign(ratio: float, trials: int = 4, noise: float = 0.05, seed: int = 1) -> list[RunSummary]:
    """Two bands, the access point here or there, with a true ratio of throughput."""
    generator = random.Random(seed)
    return [
        summary(
            f"{ap}-{band}", n, base * (ratio if ap == "station" else 1) * generator.gauss(1, noise), ap=ap, band=band
        )
        for band, base in (("2.4 GHz", 15.0), ("5 GHz", 60.0))
        for ap in ("robot", "station")
        for n in range(1, trials + 1)
    ]


def effect_of(effects: list[Effect], factor: str, metric: str = "throughput") -> Effect:
    return next(e for e in effects if e.factor == factor and e.metric == metric)


def test_a_true_effect_is_found_with_its_size() -> None:
    found = effect_of(factor_effects(campaign(1.5)), "ap")
    assert found.estimate == pytest.approx(1.5, rel=0.05)
    assert found.interval is not None
    assert found.interval[0] < 1.5 < found.interval[1]
    assert found.supported
    assert (found.low, found.high, found.trials, found.strata) == ("robot", "station", 16, 2)


def test_no_effect_is_not_supported_and_says_what_would_settle_it() -> None:
    effects = factor_effects(campaign(1.0, trials=2, noise=0.3, seed=2))
    found = effect_of(effects, "ap")
    assert not found.supported
    assert found.interval is not None
    assert found.interval[0] < 1 < found.interval[1]
    assert found.visible is not None
    assert found.visible > 1.2
    words = effect_words(effects)
    assert any("Not supported: access point" in w and "cannot be seen" in w for w in words)


def test_false_alarms_stay_rare_when_nothing_differs() -> None:
    alarms = sum(
        effect_of(factor_effects(campaign(1.0, trials=3, noise=0.2, seed=s)), "ap").supported for s in range(40)
    )
    assert alarms <= 3


def test_one_trial_a_set_up_cannot_be_judged() -> None:
    pair = [summary("a", 1, 10, ap="robot"), summary("b", 1, 20, ap="station")]
    found = effect_of(factor_effects(pair), "ap")
    assert found.estimate == pytest.approx(2.0)
    assert found.interval is None
    assert "one trial" in (found.reason or "")


def test_levels_are_compared_only_where_everything_else_is_the_same() -> None:
    mixed = [summary("a", 1, 10, ap="robot", band="5 GHz"), summary("b", 1, 20, ap="station", band="2.4 GHz")]
    found = effect_of(factor_effects(mixed), "ap")
    assert found.estimate is None
    assert any("No comparison possible" in w for w in effect_words([found]))


def test_permutation_is_exact_for_few_trials() -> None:
    import numpy as np

    y = np.array([1.0, 2.0, 11.0, 12.0])
    levels = np.array([0.0, 0.0, 1.0, 1.0])
    assert permutation_p(y, levels, np.zeros(4, int)) == pytest.approx(2 / 6)


def test_holm_is_a_step_down_correction() -> None:
    base = factor_effects(campaign(1.0))[0]
    import msgspec

    three = [msgspec.structs.replace(base, p_value=p) for p in (0.01, 0.04, 0.03)]
    assert [e.p_adjusted for e in holm(three)] == pytest.approx([0.03, 0.06, 0.06])


def test_standing_still_is_credited_only_at_the_same_distance() -> None:
    runs = [load_run(dataset(name)) for name in FILES]
    raw, matched = still_effects(runs)
    assert raw.estimate is not None
    assert matched.estimate is not None
    assert raw.estimate > 5
    assert matched.interval is not None
    assert matched.interval[0] < 0 < matched.interval[1]
    assert matched.estimate < raw.estimate / 4
    assert not matched.supported


def test_a_run_that_never_stood_still_has_no_such_difference(tmp_path: Path) -> None:
    run = load_run(record_run(tmp_path / "run", seconds=12, out=(99, 99)))
    assert still_against_moving(run).matched is None
    assert paired_effect(effect_of(factor_effects(campaign(1.0)), "ap"), []).reason == "no trial has both"


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Any]:
    folder = tmp_path_factory.mktemp("runs")

    def make(name: str, **values: Any) -> Any:
        if not (folder / name).exists():
            record_run(folder / name, seconds=60, out=(99, 99), **values)
        return load_run(folder / name)

    return make


def test_a_limit_is_broken_only_beyond_noise(runs: Callable[..., Any]) -> None:
    base, slow, same = runs("base"), runs("slow", rtt_ms=20.0), runs("same", rtt_ms=10.2)
    limit = [parse_limit("delay.p95 > +20%")]
    broken = compare_runs(base, slow, limit)[0]
    assert broken.broken
    assert broken.change_percent == pytest.approx(100 * 10 / 12, rel=0.01)
    assert not compare_runs(base, same, limit)[0].broken
    assert not compare_runs(slow, base, limit)[0].broken
    assert compare_runs(base, slow, [parse_limit("delay.mean > 15")])[0].broken
    assert compare_runs(base, slow, [parse_limit("delay.median > +5 ms")])[0].broken


def test_a_fall_of_throughput_is_a_limit_too(runs: Callable[..., Any]) -> None:
    verdict = compare_runs(runs("base"), runs("weak", rate_mbps=4.0), [parse_limit("throughput < -10%")])[0]
    assert verdict.broken
    assert verdict.base == pytest.approx(8.4, rel=0.01)


def test_a_limit_that_cannot_be_checked_says_so(runs: Callable[..., Any]) -> None:
    verdict = compare_runs(runs("base"), runs("mute", probe=False), [parse_limit("delay.p95 > +20%")])[0]
    assert verdict.interval is None
    assert "no samples" in (verdict.reason or "")
    zero = compare_runs(runs("base"), runs("slow", rtt_ms=20.0), [parse_limit("loss > +50%")])[0]
    assert "zero" in (zero.reason or "")


@pytest.mark.parametrize("text", ["", "delay", "delay.p95 >", "nonsense > 5", "delay.p95 > 20%", "delay.p95 ? 3"])
def test_a_limit_that_is_not_understood_says_what_is(text: str) -> None:
    with pytest.raises(ConfigError):
        parse_limit(text)


@settings(max_examples=60, deadline=None)
@given(st.text(max_size=30))
def test_any_text_as_limit_or_need_is_understood_or_refused(text: str) -> None:
    for parse in (parse_limit, lambda t: parse_needs([t])):
        try:
            parse(text)
        except ConfigError:
            continue


def test_needs_are_read_as_people_write_them() -> None:
    camera, commands = parse_needs(["camera: 30 Mbit/s, commands: p99 below 100 ms, loss below 1 %"])
    assert (camera.name, [(c.figure, c.limit) for c in camera.conditions]) == ("camera", [("throughput", 30.0)])
    assert [(c.figure, c.limit) for c in commands.conditions] == [("p99", 100.0), ("loss", 1.0)]
    assert parse_needs(["x: throughput >= 30"])[0].conditions[0].at_least


@pytest.mark.parametrize("text", ["camera: fast", "camera:", "throughput <= 5", "p99 above 3 ms", "loss < 3 ms"])
def test_a_need_that_makes_no_sense_is_refused(text: str) -> None:
    with pytest.raises(ConfigError):
        parse_needs([text])


def test_the_set_up_that_meets_a_need_comes_first_with_its_certainty() -> None:
    summaries = [summary("slow", n, 10 + n) for n in (1, 2, 3)] + [summary("fast", n, 60 + n) for n in (1, 2, 3)]
    fits = recommend(summaries, parse_needs(["camera: 30 Mbit/s"]))
    assert [f.case for f in fits] == ["fast", "slow"]
    assert [f.verdict for f in fits] == ["met", "not met"]
    assert fits[0].certainty is not None
    assert fits[0].certainty > 0.99


def test_one_trial_gives_no_certainty() -> None:
    condition = parse_needs(["30 Mbit/s"])[0].conditions[0]
    assert next_trial_chance([60.0], condition) is None
    assert next_trial_chance([30.0, 30.0], condition) == 1.0
    fit = recommend([summary("fast", 1, 60)], parse_needs(["camera: 30 Mbit/s"]))[0]
    assert "one trial" in fit.verdict


def test_a_need_on_an_unknown_figure_cannot_be_judged(tmp_path: Path) -> None:
    found = summarise(load_run(record_run(tmp_path / "run", probe=False, seconds=20)))
    fit = recommend([found], parse_needs(["commands: p99 below 100 ms"]))[0]
    assert fit.verdict.startswith("cannot be judged")


def test_every_metric_has_a_value_where_it_was_measured() -> None:
    from linkrover.analysis.effects import metric_value

    assert all(metric_value(summary("a", 1, 10.0), metric) is not None for metric in METRICS)
