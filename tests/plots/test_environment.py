"""The page, table and words of environments, of noise and sines made by hand."""

import numpy as np
import pandas as pd
import pytest

import slipperjax as sj
from slipperjax import plots
from slipperjax.analysis.environment import vibration_environment
from slipperjax.sweeps.environment import _dataset
from slipperjax.tools.units import STANDARD_GRAVITY as G

from .shown import drawn, labels, legend

PLACES = np.array([(0.5, 0.0, 0.4), (0.0, 0.0, 0.0)])
RATE = 40e3


@pytest.fixture(scope="module")
def report():
    """Gives 2 s of noise of 1, 2 and 3 (m/s^2)^2/Hz times the rail's number, none along x at the second place."""
    noise = np.random.default_rng(1).normal(size=(3, 2, 3, int(2 * RATE))) * np.sqrt(RATE / 2)
    power = np.arange(1, 4)[:, None, None] * np.array([[1.0, 2.0, 3.0], [0.0, 1.0, 1.0]])
    return _dataset(vibration_environment(noise * np.sqrt(power)[..., None], RATE), PLACES)


def lines(ax):
    return [drawn(line)[:, 1] for line in ax.lines]


@pytest.mark.full
def test_a_page_has_the_lines_of_its_report_in_g(report):
    axes = plots.vibration(report, 0)
    at = report.isel(place=0)
    for ax, direction in zip(axes[0], "xyz", strict=True):
        *rails, most, mean, limit = lines(ax)
        np.testing.assert_allclose(rails, at["density"].sel(direction=direction) / G**2)
        envelope = at["density_envelope"].sel(direction=direction, summary=["maximum", "mean", "limit"])
        np.testing.assert_allclose([most, mean, limit], envelope.transpose("summary", ...) / G**2)
    assert labels(axes[0, 0]) == ("frequency [Hz], along x", "power spectral density [g$^2$/Hz]")
    np.testing.assert_allclose(lines(axes[1, 0])[::2], at["shock_envelope"].sel(summary="maximum") / G)
    # the strongest rail
    np.testing.assert_allclose(lines(axes[1, 1]), at["level"].isel(rail=2) / G)
    cells = {at: cell.get_text().get_text() for at, cell in axes[1, 2].tables[0].get_celld().items()}
    rms = at["rms"].isel(rail=2) / G
    assert [float(cells[1, k]) for k in range(3)] == pytest.approx(rms.values, rel=5e-3)  # three digits
    # nothing moves along x at the second place
    assert not np.any(lines(plots.vibration(report, 1)[0, 0])[0])


def test_shaded_is_what_is_within_6_db():
    """A sine of 1 g for half of the time, of a tenth for the rest."""
    t = np.arange(int(2 * RATE)) / RATE
    sine = G * np.where(t < 1.0, 1.0, 0.1) * np.sin(2 * np.pi * 440.0 * t)
    axes = plots.vibration(
        _dataset(vibration_environment(np.broadcast_to(sine, (1, 1, 3, t.size)), RATE), PLACES[:1])
    )
    for area in axes[1, 1].collections:
        # the window of 0.1 s is within 6 dB until a quarter of its power remains: measured 1.023
        assert area.get_paths()[0].vertices[:, 0].max() == pytest.approx(1.023, abs=0.013)
    assert (len(axes[0, 0].lines), legend(axes[0, 0])) == (1, [])


def test_tables_and_words_have_the_numbers_of_a_report(report, tmp_path):
    result = sj.Result(report.assign_attrs(call='{"function": "environment"}'))
    result.write(tmp_path / "payload.csv")
    table = pd.read_csv(tmp_path / "payload.csv")
    assert table.columns.tolist() == result.tables()["bands"].columns.tolist()
    first = table[: report.sizes["frequency"]]
    assert len(table) == 2 * len(first)
    assert set(first["x [m]"]) == {0.5}
    limit = report["density_envelope"].sel(summary="limit", direction="z").isel(place=0) / G**2
    np.testing.assert_allclose(first["density z limit [g^2/Hz]"], limit, rtol=1e-8)
    shock = report["shock_envelope"].sel(summary="mean", direction="y").isel(place=0) / G
    np.testing.assert_allclose(first["shock response y mean [g]"], shock[1:], rtol=1e-8)
    strongest = float(report["rms"].isel(place=0).sel(direction="z").max()) / G
    words, shocks, *_ = result.summary()
    assert f" z {strongest:.3g}; of 20 to 2000 Hz x " in words
    assert shocks.startswith("highest shock response ")
    for ending in ("pdf", "xlsx"):
        assert result.write(tmp_path / f"payload.{ending}", units=["ft"]).startswith("wrote ")


def test_wrong_reports_are_one_line(report):
    with pytest.raises(ValueError, match="`place` must be below 2, the number of places, but is 2"):
        plots.vibration(report, 2)
    with pytest.raises(ValueError, match=r"`report` must be a dataset of slipperjax.env"):
        plots.vibration(report.drop_vars("shock_response"))
