"""Pictures of designs of a bowl, whose optimum is known."""

import numpy as np
import pytest

import slipperjax as sj
from slipperjax import plots
from slipperjax.design.optimise import optimise_design
from slipperjax.design.problem import Problem

from ..design.bowl import evaluate
from .shown import drawn, labels, legend, marked

NAN = float("nan")
BOX = {"clearance": (0.2e-3, 3e-3), "length": (0.12, 0.5), "section.points.D.1": (0.01, 0.05)}
SMOOTH = "soft peak force [kN]"


@pytest.fixture
def design(monkeypatch):
    """Makes the dataset of a search over some variables and speeds, of which the last is chaotic."""
    monkeypatch.setattr(Problem, "evaluate", evaluate)

    def make(*variables, speeds=(1000.0, 1200.0, 1600.0), **options):
        box = {name: BOX[name] for name in variables or ("clearance", "length")}
        over = {"speed": list(speeds)} if speeds else None
        options = dict(over=over, starts=2, max_trials=5, steps_per_period=50) | options
        return optimise_design(sj.paper_scene(), "peak_force", box, **options).ds

    return make


def surroundings(ds):
    """A design with a grid of the same bowl around it, with a column of designs without a motion."""
    axes = {name: np.linspace(*BOX[name], 9) for name in ds["variable"].values.tolist()}
    mesh = np.meshgrid(*[np.linspace(0, 1, 9)] * len(axes), indexing="ij")
    total = 16e3 * (1 + sum((m - middle) ** 2 for m, middle in zip(mesh, (2 / 7, 0.5, 0.5), strict=False)))
    total[-1] = NAN
    units = dict(zip(ds["variable"].values.tolist(), ds["variable_unit"].values.tolist(), strict=True))
    axes = {name: (name, values, {"units": units[name]}) for name, values in axes.items()}
    return ds.assign(around_total=(tuple(axes), total)).assign_coords(axes)


def panel(number, *arguments, **options):
    """One of the page's panels: cases, trials, progress, sensitivities, surroundings, margins."""
    return np.ravel(plots.design_overview(*arguments, **options))[number]


def dots(ax, marker):
    """The positions of lines' markers."""
    return np.concatenate([np.zeros((0, 2)), *map(drawn, marked(ax, marker))])


def test_cases_are_drawn_over_their_parameter_by_regime(design):
    ds = design()
    ax = panel(0, ds)
    assert labels(ax) == ("speed $V$ [m/s]", r"peak force $F_{\mathrm{max}}$ [kN]")
    assert set(legend(ax)) == {"best design", "first design", "worst", "periodic", "irregular"}
    np.testing.assert_allclose(dots(ax, "D")[:, 0], [1600, 1600])
    best = np.stack([ds["speed"], ds["objective"] / 1e3], axis=1)
    np.testing.assert_allclose(dots(ax, "o")[2:], best[:2])
    (bar,) = [c for c in ax.collections if len(c.get_segments())]
    np.testing.assert_allclose(np.diff(bar.get_segments()[0][:, 1]), 0.2)  # twice 100 N
    # without motion a cross at the bottom
    ds["trial_objective"][0, 0] = NAN
    np.testing.assert_allclose(dots(panel(0, ds), "x"), [[1000, 0.04]])
    assert panel(0, design(speeds=())).get_xlabel() == "case"


def test_trials_lie_in_the_plane_of_the_first_two_variables(design):
    ds = design(*BOX)
    ds["trial_violation"][-1] = 0.1
    ax = panel(1, ds)
    assert labels(ax) == ("clearance $C$ [mm]", "length $L$ [m]")
    assert {"best", "start", "trial", "constraint violated", "bound"} == set(legend(ax))
    assert len(dots(ax, "s")) == 2
    np.testing.assert_allclose(dots(ax, "*"), [[1e3 * float(ds["design"][0]), float(ds["design"][1])]])
    violated, kept = ax.collections
    assert (len(violated.get_offsets()), len(kept.get_offsets())) == (1, ds.sizes["trial"] - 1)


def test_progress_is_the_lowest_that_violates_nothing_and_sensitivities_are_relative(design):
    ds = design()
    ds["trial_smooth"][0] = np.inf
    ds["trial_violation"][int(np.argmin(ds["trial_smooth"].values))] = 0.1
    ax = panel(2, ds)
    x, y = drawn(ax.lines[0]).T
    assert y[-1] == pytest.approx(float(ds["trial_smooth"].where(ds["trial_violation"] == 0).min()) / 1e3)
    assert np.isnan(y[0])
    assert np.all(np.diff(y[1:]) <= 0)
    assert x[-1] == ds["trial_simulated"][-1]
    ax = panel(3, ds)
    assert legend(ax) == ["clearance $C$", "length $L$"]
    line = next(line for line in ax.lines if line.get_marker() == "o")
    np.testing.assert_allclose(line.get_ydata(), ds["gradient"][:, 0] * ds["design"][0] / ds["smooth"])


def test_surroundings_are_a_map_near_the_best_design(design):
    ds = design()
    ax = panel(4, surroundings(ds))
    (mesh,) = ax.collections
    assert np.ma.count_masked(mesh.get_array()) == 9
    assert legend(ax) == ["best"]
    assert float(mesh.get_array()[4, 2]) == pytest.approx(16, rel=0.01)  # kN
    assert labels(ax) == ("clearance $C$ [mm]", "length $L$ [m]")
    ds = design(*BOX)
    assert panel(4, surroundings(ds)).collections[0].get_array().shape == (9, 9)


def test_one_variable_has_the_objective_upwards(design):
    ds = design("section.points.D.1")
    _, trials, _, _, near = plots.design_overview(surroundings(ds))
    for ax in (trials, near):
        assert labels(ax) == ("section.points.D.1 [m]", f"{SMOOTH}\nworst of 3 cases")
        assert "best" in legend(ax)
    assert len(trials.figure.axes) == 5  # no colour bar


def margins():
    """Variables of events on both sides of two parameters of two cases; one side of one has none."""
    rows = [
        (2, "clearance", -1, "GR", 0.9e-3, -0.10),
        (2, "clearance", 1, "", 1.2e-3, 0.20),
        (2, "length", -1, "LP", 0.19, -0.05),
        (2, "length", 1, "PD", 0.22, 0.10),
        (0, "clearance", -1, "NS", 0.95e-3, -0.05),
        (0, "clearance", 1, "GR", 1.01e-3, 0.01),
    ]
    names = ("case", "parameter", "direction", "label", "value", "relative")
    columns = zip(names, zip(*rows, strict=True), strict=True)
    return {f"margin_{name}": ("margin", list(column)) for name, column in columns}


def test_a_page_has_margins_to_events_and_a_title(design):
    ds = design()
    axes = plots.design_overview(surroundings(ds).assign(margins()))
    assert axes[0].figure.get_suptitle().endswith("kN, worst of 3 cases")
    ax = axes[5]
    bars = sorted(float(line.get_xdata()[1]) for line in ax.lines if line.get_linewidth() == 3.5)
    assert bars == pytest.approx([-10.0, -5.0, -5.0, 1.0, 10.0, 20.0], abs=1e-12)
    # an event has a marker and its value; the side without one has neither
    assert [len(dots(ax, marker)) for marker in ("|", "D", "^", "o")] == [2, 1, 1, 1]
    *values, _ = (text.get_text().strip() for text in ax.texts)
    assert sorted(values) == ["0.19", "0.22", "0.9", "0.95", "1.01"]


def test_what_cannot_be_drawn_is_named(design):
    ds = design()
    for draw, words in (
        (lambda: plots.design_overview(ds.drop_vars("trial_design")), "with `trial_design`, but has"),
        (lambda: plots.design_margins(ds), "with `margin_label`"),
    ):
        with pytest.raises(ValueError, match=words):
            draw()
