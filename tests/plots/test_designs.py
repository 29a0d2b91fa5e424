"""Pictures of designs of a bowl, whose optimum is known."""

import numpy as np
import pytest

import slipperjax as sj
from slipperjax import plots
from slipperjax.design.optimise import optimise_design
from slipperjax.design.problem import Problem

from ..design.bowl import evaluate
from .shown import drawn, labels, legend, marked

BOX = {"clearance": (0.2e-3, 3e-3), "length": (0.12, 0.5), "section.points.D.1": (0.01, 0.05)}


@pytest.fixture
def design(monkeypatch):
    """Makes the dataset of a search over some variables and speeds, of which the last is chaotic."""
    monkeypatch.setattr(Problem, "evaluate", evaluate)

    def make(*variables, speeds=(1000.0, 1200.0, 1600.0)):
        box = {name: BOX[name] for name in variables or ("clearance", "length")}
        over = {"speed": list(speeds)} if speeds else None
        options = dict(over=over, starts=2, max_trials=5, steps_per_period=50)
        return optimise_design(sj.paper_scene(), "peak_force", box, **options).ds

    return make


def surroundings(ds):
    """A design with a grid of the same bowl around it, with a column of designs without a motion."""
    axes = {name: np.linspace(*BOX[name], 9) for name in ds["variable"].values.tolist()}
    mesh = np.meshgrid(*[np.linspace(0, 1, 9)] * len(axes), indexing="ij")
    total = 16e3 * (1 + sum((m - middle) ** 2 for m, middle in zip(mesh, (2 / 7, 0.5, 0.5), strict=False)))
    total[-1] = np.nan
    units = dict(zip(ds["variable"].values.tolist(), ds["variable_unit"].values.tolist(), strict=True))
    axes = {name: (name, values, {"units": units[name]}) for name, values in axes.items()}
    return ds.assign(around_total=(tuple(axes), total)).assign_coords(axes)


def dots(ax, marker):
    """The positions of lines' markers."""
    return np.concatenate([np.zeros((0, 2)), *map(drawn, marked(ax, marker))])


def test_a_page_has_cases_trials_progress_and_relative_sensitivities(design):
    ds = design(*BOX)
    ds["trial_violation"][-1] = 0.1
    ds["trial_smooth"][0] = np.inf
    cases, trials, progress, slopes = plots.design_overview(ds)
    assert labels(cases) == ("speed $V$ [m/s]", r"peak force $F_{\mathrm{max}}$ [kN]")
    assert set(legend(cases)) == {"best design", "first design", "worst", "periodic", "irregular"}
    np.testing.assert_allclose(dots(cases, "D")[:, 0], [1600, 1600])
    best = np.stack([ds["speed"], ds["objective"] / 1e3], axis=1)
    np.testing.assert_allclose(dots(cases, "o")[2:], best[:2])
    (bar,) = [c for c in cases.collections if len(c.get_segments())]
    np.testing.assert_allclose(np.diff(bar.get_segments()[0][:, 1]), 0.2)  # twice 100 N
    # trials in the plane of the first two variables
    assert labels(trials) == ("clearance $C$ [mm]", "length $L$ [m]")
    assert {"best", "start", "trial", "constraint violated", "bound"} == set(legend(trials))
    assert len(dots(trials, "s")) == 2
    np.testing.assert_allclose(dots(trials, "*"), [[1e3 * float(ds["design"][0]), float(ds["design"][1])]])
    violated, kept = trials.collections
    assert (len(violated.get_offsets()), len(kept.get_offsets())) == (1, ds.sizes["trial"] - 1)
    # progress is the lowest that violates nothing
    x, y = drawn(progress.lines[0]).T
    finite = ds["trial_smooth"].where((ds["trial_violation"] == 0) & np.isfinite(ds["trial_smooth"]))
    assert y[-1] == pytest.approx(float(finite.min()) / 1e3)
    assert np.isnan(y[0])
    assert np.all(np.diff(y[1:]) <= 0)
    assert x[-1] == ds["trial_simulated"][-1]
    assert legend(slopes)[:2] == ["clearance $C$", "length $L$"]
    line = next(line for line in slopes.lines if line.get_marker() == "o")
    np.testing.assert_allclose(line.get_ydata(), ds["gradient"][:, 0] * ds["design"][0] / ds["smooth"])
    # without motion a cross at the bottom
    ds["trial_objective"][0, 0] = np.nan
    np.testing.assert_allclose(dots(plots.design_overview(ds)[0], "x"), [[1000, 0.04]])
    assert plots.design_overview(design(speeds=()))[0].get_xlabel() == "case"


def test_surroundings_are_a_map_near_the_best_design(design):
    ax = plots.design_overview(surroundings(design()))[4]
    (mesh,) = ax.collections
    assert np.ma.count_masked(mesh.get_array()) == 9
    assert legend(ax) == ["best"]
    assert float(mesh.get_array()[4, 2]) == pytest.approx(16, rel=0.01)  # kN
    assert labels(ax) == ("clearance $C$ [mm]", "length $L$ [m]")
    # of more variables the others are near the best
    assert plots.design_overview(surroundings(design(*BOX)))[4].collections[0].get_array().shape == (9, 9)
    # one variable has the objective upwards, and no colour bar
    _, trials, _, _, near = plots.design_overview(surroundings(design("section.points.D.1")))
    for ax in (trials, near):
        assert labels(ax) == ("section.points.D.1 [m]", "soft peak force [kN]\nworst of 3 cases")
        assert "best" in legend(ax)
    assert len(trials.figure.axes) == 5


def test_margins_to_events_are_bars_with_markers_and_values(design):
    """On both sides of two parameters of two cases; one side of one has none."""
    margins = {
        "case": [2, 2, 2, 2, 0, 0],
        "parameter": ["clearance", "clearance", "length", "length", "clearance", "clearance"],
        "label": ["GR", "", "LP", "PD", "NS", "GR"],
        "value": [0.9e-3, 1.2e-3, 0.19, 0.22, 0.95e-3, 1.01e-3],
        "relative": [-0.10, 0.20, -0.05, 0.10, -0.05, 0.01],
    }
    ds = design()
    with pytest.raises(ValueError, match="with `margin_label`"):
        plots.design_margins(ds)
    ds = surroundings(ds).assign({f"margin_{name}": ("margin", values) for name, values in margins.items()})
    axes = plots.design_overview(ds)
    assert axes[0].figure.get_suptitle().endswith("kN, worst of 3 cases")
    bars = sorted(float(line.get_xdata()[1]) for line in axes[5].lines if line.get_linewidth() == 3.5)
    assert bars == pytest.approx([-10.0, -5.0, -5.0, 1.0, 10.0, 20.0], abs=1e-12)
    assert [len(dots(axes[5], marker)) for marker in ("|", "D", "^", "o")] == [2, 1, 1, 1]
    *values, _ = (text.get_text().strip() for text in axes[5].texts)
    assert sorted(values) == ["0.19", "0.22", "0.9", "0.95", "1.01", "no event"]
    with pytest.raises(ValueError, match="with `trial_design`, but has"):
        plots.design_overview(ds.drop_vars("trial_design"))
