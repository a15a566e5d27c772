import json

import pytest

from linkrover.cli.model import fit, predict
from linkrover.emulator import virtual
from linkrover.emulator.presets import find
from linkrover.errors import ConfigError, LinkRoverError


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run") / "internal"
    virtual.run(find("6"), 1, 3, 120.0, folder)
    return folder


def test_a_simulated_run_is_fitted_and_predicted_from(run, tmp_path, capsys):
    assert fit(run, access_point=(-1.0, -0.8), json=True) == 0
    text = capsys.readouterr().out
    (result,) = json.loads(text)["fits"]
    figures = result["figures"]
    assert {"exponent", "sigma_db", "nakagami_m", "alpha_b_hz", "cap_bps", "access_point_x_m"} <= set(figures)
    assert figures["exponent"]["low"] < figures["exponent"]["value"] < figures["exponent"]["high"]
    file = tmp_path / "fit.json"
    file.write_text(text)
    assert predict(fit=file, distance=(2.0, 8.0), json=True) == 0
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert rows[0]["rssi_dbm"] > rows[1]["rssi_dbm"]


def test_the_tables_name_every_figure_with_its_interval(run, capsys):
    assert fit(run) == 0
    out = capsys.readouterr().out
    for word in ("path-loss exponent", "decorrelation distance", "95 % interval", "alpha_T * B", "region of"):
        assert word in out


def test_a_preset_predicts_and_tells_how_far_a_throughput_reaches(capsys):
    assert predict(preset="internal-5", throughput_mbps=10.0) == 0
    out = capsys.readouterr().out
    assert "10 Mbit/s needs" in out


def test_what_is_missing_or_wrong_is_named(tmp_path):
    with pytest.raises(ConfigError, match="--alpha-b-mhz"):
        predict(rss_1m_dbm=-40.0, exponent=3.0)
    with pytest.raises(ConfigError, match="internal-5"):
        predict(preset="nothing")
    with pytest.raises(ConfigError, match="--fit"):
        predict(fit=tmp_path / "none.json")
    with pytest.raises(ConfigError, match="distance_m"):
        predict(preset="internal-5", distance=(0.0,))
    with pytest.raises(ConfigError, match="give one of them"):
        predict(preset="internal-5", fit=tmp_path / "x")
    with pytest.raises(ConfigError, match="at least one run"):
        fit()
    with pytest.raises(LinkRoverError, match="no such run"):
        fit(tmp_path / "absent")
    with pytest.raises(ConfigError, match="robot or station"):
        fit(tmp_path, end="moon")
