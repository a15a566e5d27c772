from __future__ import annotations

from pathlib import Path

import pytest

from linkrover.report.figures import write_figures
from linkrover.report.html import write_page
from tests.browser import Browser, chromium

from .views import run_view

needs_chromium = pytest.mark.skipif(chromium() is None, reason="Chromium is not installed")
ARTIFACTS = Path(__file__).parents[2] / "artifacts"


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_page([run_view()], path)
    return path


def test_text_from_a_recording_cannot_become_markup(page):
    text = page.read_text()
    assert "<script>alert(1)" not in text
    assert "no beacon <b>" not in text


@pytest.mark.browser
@needs_chromium
def test_the_page_works_in_a_browser_without_network_and_hovering_links_series_and_map(page):
    with Browser() as browser:
        browser.open(page)
        browser.run("Promise.all(all.map(draw)).then(() => true)")
        assert browser.run("document.querySelectorAll('.figure .main-svg').length") >= 3
        assert [url for url in browser.requests if not url.startswith(("file:", "data:", "blob:"))] == []

        browser.run("document.getElementById('run0-series').scrollIntoView()")
        box = browser.run(
            "(() => { const r = document.querySelector('#run0-series .nsewdrag').getBoundingClientRect();"
            " return [r.x, r.y, r.width, r.height]; })()"
        )
        browser.move_mouse(box[0] + box[2] / 2 - 5, box[1] + box[3] / 2)
        browser.move_mouse(box[0] + box[2] / 2, box[1] + box[3] / 2)
        browser.wait_for("document.getElementById('run0-map').data.at(-1).x.length === 1")
        assert abs(float(browser.run("document.getElementById('run0-map').dataset.cursor")) - 150) < 10

        browser.run("document.getElementById('run0-map').scrollIntoView()")
        place = browser.run(
            "(() => { const m = document.getElementById('run0-map'); const t = m.data[1];"
            " const r = m.querySelector('.nsewdrag').getBoundingClientRect();"
            " const i = Math.floor(t.x.length / 2);"
            " return [r.x + m._fullLayout.xaxis.d2p(t.x[i]), r.y + m._fullLayout.yaxis.d2p(t.y[i])]; })()"
        )
        browser.move_mouse(place[0] - 2, place[1])
        browser.move_mouse(place[0], place[1])
        browser.wait_for("document.getElementById('run0-series').dataset.cursor !== undefined")
        browser.screenshot(ARTIFACTS / "report.png")
        assert browser.complaints == []


@pytest.mark.browser
@needs_chromium
def test_on_a_phone_the_page_is_not_wider_than_the_screen(page):
    with Browser(width=390, height=800) as browser:
        browser.open(page)
        browser.run("Promise.all(all.map(draw)).then(() => true)")
        assert browser.run("document.documentElement.scrollWidth") <= 390
        browser.screenshot(ARTIFACTS / "report-phone.png")
        assert browser.complaints == []


def test_every_figure_is_written_in_every_format_and_several_runs_are_compared(tmp_path):
    views = [run_view(f"case {c} trial {t}", str(c), t) for c in (1, 2) for t in (1, 2)]
    written = write_figures(views, tmp_path, ["png", "svg", "pdf"])
    names = {path.name for path in written}
    assert {"case-1-trial-1-path.svg", "cases-rssi.pdf", "cases-compared.png"} <= names
    assert all(path.stat().st_size > 1000 for path in written)


def test_an_unknown_figure_format_is_refused_with_the_allowed_ones(tmp_path):
    with pytest.raises(ValueError, match="'gif' is not one of png, svg, pdf"):
        write_figures([run_view()], tmp_path, ["gif"])


def test_a_run_without_path_delay_or_lines_still_gives_a_page(tmp_path):
    from dataclasses import replace

    bare = replace(run_view(), lines=(), path=None, outages=(), summary={})
    write_page([bare], tmp_path / "bare.html")
    assert "The run lasted 300 s." in (tmp_path / "bare.html").read_text()


def test_several_runs_are_laid_side_by_side_on_one_scale():
    from linkrover.report.floor import side_by_side

    views = [run_view(f"case {c}", str(c), 1) for c in (1, 2)]
    figure = side_by_side(views, "throughput")
    assert figure is not None
    assert {trace["marker"]["coloraxis"] for trace in figure["data"]} == {"coloraxis"}
    assert "sent" not in figure["data"][0]["text"][0]
    assert side_by_side(views[:1], "throughput") is None


def test_an_estimated_map_stands_beside_its_error_with_antenna_dead_zones_and_walls():
    from linkrover.analysis.space import Anchor, DeadZone, Surface
    from linkrover.report.floor import estimated_maps

    surface = Surface(
        quantity="rssi", unit="dBm", x_m=[0.0, 1.0], y_m=[0.0, 1.0], mean=[[-50.0, -51.0], [-52.0, -53.0]],
        standard_error=[[1.0, 1.0], [2.0, 2.0]], points=12, length_scale_m=2.0,
    )  # fmt: skip
    anchor = Anchor(x_m=0.5, y_m=0.5, radius_m=1.0, rssi_1m_dbm=-40.0, exponent=2.5, sigma_db=3.0)
    zone = DeadZone(x_m=1.0, y_m=1.0, area_m2=2.0, seconds=5.0)
    figure = estimated_maps([surface], anchor, [zone], walls=[(0.0, 0.0, 1.0, 1.0)])
    assert figure is not None
    heat = [trace for trace in figure["data"] if trace["type"] == "heatmap"]
    assert [h["z"] for h in heat] == [surface.mean, surface.standard_error]
    assert len(figure["layout"]["shapes"]) == 2
    assert sum(trace["type"] == "scatter" for trace in figure["data"]) == 4


def test_a_problem_of_many_runs_is_said_once(tmp_path):
    from dataclasses import replace

    missing = "robot: no wireless link was recorded"
    views = [replace(run_view(f"case {c}", str(c), 1), problems=(missing,)) for c in (1, 2, 3)]
    write_page(views, tmp_path / "report.html")
    assert (tmp_path / "report.html").read_text().count(missing) == 1
    assert "(3 of 3 runs: case 1, case 2, ...)" in (tmp_path / "report.html").read_text()
