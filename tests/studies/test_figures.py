"""The paper's figures from made data: what each panel shows, and what becomes of flagged cases."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr

from slipperjax.plots.style import COLORS
from slipperjax.studies.dang2024 import figures
from slipperjax.studies.dang2024.claims import DUAL_LINES
from slipperjax.studies.dang2024.figures import write_figures
from slipperjax.studies.dang2024.runs import Finished

from . import made


@pytest.fixture(autouse=True)
def _closed():
    plt.close("all")
    yield
    assert not plt.get_fignums()


@pytest.fixture
def drawn():
    """Draws a figure, and closes it at the end."""
    made_figures = []

    def draw(name, data):
        made_figures.append(figures._DRAW[name](data))
        return made_figures[-1]

    yield draw
    for figure in made_figures:
        plt.close(figure)


def texts(ax):
    return [text.get_text() for text in ax.texts]


def test_figures_and_data_are_written(tmp_path):
    ds = made.two_waves()
    done = Finished("dual frequency", ("13",), {"dual": ds}, {}, 1.0)
    write_figures(done, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"dual.nc", "fig13.png"}
    with xr.open_dataset(tmp_path / "dual.nc", engine="h5netcdf") as stored:
        np.testing.assert_array_equal(stored["a_z"].values, ds["a_z"].values)
    assert plt.imread(tmp_path / "fig13.png").shape == (1080, 700, 4)


def test_single_cases_show_their_lines_and_their_highest_forces(drawn):
    history, sections = made.singles()
    figure = drawn("4", {"histories": history, "sections": sections})
    titles = [ax.get_title("left") for ax in figure.axes[::3]]
    assert titles == [f"{speed} m/s, 1 mm, 0.2 m" for speed in (900, 1500, 2300)]
    x, y = figure.axes[4].lines[0].get_data()  # the spectrum at 1500 m/s has its lines at f, 2f and 3f
    highest = [x[np.where(np.abs(x - k) < 0.5, y, -np.inf).argmax()] for k in (1, 2, 3)]
    np.testing.assert_allclose(highest, [1, 2, 3], atol=5e-3)
    assert len(drawn("7", {"histories": history}).axes) == 6
    history["peak_force"] = 1.05 * history["peak_force"]  # what is saved misses them
    twelve = drawn("12", {"histories": history}).axes
    labels = [text.get_text() for ax in twelve for text in ax.get_legend().get_texts()]
    peaks = 1.05 * np.array([1977, 8807, 5447])
    assert labels[:3] == [f"{p}2: peak {peak:.0f} N" for p, peak in zip("ACJ", peaks, strict=True)]
    dashed = [line for line in twelve[0].lines if line.get_linestyle() == "--"]
    assert [line.get_ydata()[0] for line in dashed] == pytest.approx(peaks / 1e3)


def test_flagged_cases_are_named_in_their_panels(drawn):
    history, sections = made.singles()
    for k in (2, 3, 6):
        history["status"][k] = 1
        history["alpha_x"][k] = np.nan
    data = {"histories": history, "sections": sections}
    four, seven, twelve = (drawn(name, data).axes for name in ("4", "7", "12"))
    lost = ["flagged: NOT_FINITE"]
    assert [texts(ax) == lost for ax in four] == [False] * 6 + [True] * 3
    assert [texts(ax) == lost for ax in seven] == [True] * 3 + [False] * 3
    assert [texts(ax) == lost for ax in twelve] == [False, True]
    assert four[6].get_title("left").startswith("2300 m/s")
    dual = made.two_waves()
    dual["status"][0] = 2
    assert [texts(ax) for ax in drawn("13", {"dual": dual}).axes] == [["flagged: DERAILED"]] * 3


def test_other_figures_name_their_lines_and_are_over_their_parameter(drawn):
    assert all(texts(ax) == list(DUAL_LINES) for ax in drawn("13", {"dual": made.two_waves()}).axes)
    clearances = drawn("8", {"clearance": made.clearances_as_claimed()})
    assert len(clearances.axes) == 5
    assert not clearances.legends  # no branches
    found = made.exponents("length", np.linspace(0.1, 0.5, 9), np.arange(9) < 2)
    found["regime"] = ("length", np.where(np.arange(9) < 2, "chaotic", "periodic"))
    ax = drawn("11", {"length_exponents": found}).axes[0]
    assert "length" in ax.get_xlabel()
    np.testing.assert_allclose(ax.get_xlim(), (0.1, 0.5), atol=0.03)


def test_branches_are_drawn_over_the_dots_with_one_legend(drawn):
    data = {"speed": made.speeds_as_claimed()}
    data |= {f"speed_branch_{one.period}": one.ds for one in made.speed_branches()}
    first, spare, *others = drawn("5", data).axes
    assert len(others) == 4
    assert not any(ax.get_legend() for ax in (first, *others))
    entries = {text.get_text() for text in spare.get_legend().get_texts()}
    assert entries >= {"period 1, stable", "period 2, unstable", "LP fold", "PD flip", "GR grazing"}
    assert {line.get_color() for line in first.lines if line.get_linestyle() == "-"} == {
        COLORS["blue"],
        COLORS["red"],
    }
