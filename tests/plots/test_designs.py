"""Pictures of designs, from datasets made by hand."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import LogNorm

from slipperjax import plots
from slipperjax.plots.style import color_norm

from .shown import drawn, labels, legend, marked

NAN, INF = float("nan"), float("inf")
FORCE = {"units": "N", "quantity": "peak_force", "symbol": r"F_{\max}", "shown_unit": "kN"}
BOUNDS = {
    "mass": (10.0, 20.0, "kg"),
    "clearance": (0.2e-3, 3e-3, "m"),
    "length": (0.12, 0.5, "m"),
    "section.play.2": (1e-4, 1e-3, "m"),
}


def design(
    variables=("clearance", "length"),
    regimes=("period 1", "period 2", "irregular", "period 1"),
    errors=(0.0, 0.0, 600.0, 0.0),
    over="speed",
    robust="worst",
    spoilt=None,
):
    """Gives three starts of six trials each; the objective is a bowl over the variables, and grows with speed."""
    cases, trials = len(regimes), 18
    low, high = np.array([BOUNDS[name][:2] for name in variables]).T
    start = np.tile(np.arange(3), 6)
    begin = np.array([0.9, 0.2, 0.55])[start]
    way = np.repeat(np.arange(6) / 5, 3)
    path = np.stack([begin + (0.3 - begin) * way**0.5, 1 - begin + (begin - 0.5) * way], axis=1)
    unit = np.hstack([path, 0.5 * np.ones((trials, 1))])[:, : len(variables)]
    rise = 1 + 0.3 * np.arange(cases) / cases
    smooth = 9e3 * (1 + 4 * np.sum((unit - [0.3, 0.5, 0.5][: len(variables)]) ** 2, axis=1))
    accepted = np.arange(trials) % 4 != 3
    violation = np.where(np.arange(trials) % 7 == 2, 0.1, 0.0)
    objective = 1.2 * smooth[:, None] * rise
    if spoilt is not None:
        smooth[spoilt], objective[spoilt, 0] = INF, NAN
    kinds = np.tile(np.array(regimes), (trials, 1))
    best = low + unit[-1] * (high - low)
    along = lambda values, **attrs: (("case", "variable"), np.broadcast_to(values, (cases, len(variables))), attrs)
    data = {
        "design": ("variable", best),
        "low": ("variable", low),
        "high": ("variable", high),
        "objective": ("case", 1e4 * rise, FORCE),
        "objective_stderr": ("case", np.array(errors)),
        "smooth": ("case", 9e3 * rise, FORCE | {"quantity": "soft_peak_force", "symbol": r"\|F\|"}),
        "regime": ("case", np.array(regimes)),
        "gradient": along(rise[:, None] * [[2e6, -1.5e4, 1e5][: len(variables)]][0]),
        "gradient_stderr": along(np.array(errors)[:, None] * [[200.0, 2.0, 100.0][: len(variables)]][0]),
        "trial_start": ("trial", start),
        "trial_design": (("trial", "variable"), low + unit * (high - low)),
        "trial_smooth": ("trial", smooth, FORCE | {"quantity": "soft_peak_force", "symbol": r"\|F\|"}),
        "trial_violation": ("trial", violation),
        "trial_taken": ("trial", accepted),
        "trial_objective": (("trial", "case"), objective, FORCE),
        "trial_regime": (("trial", "case"), kinds),
        "trial_simulated": ("trial", 900.0 * (1 + np.arange(trials) // 3)),
    }
    coords = {"variable": list(variables), "variable_unit": ("variable", [BOUNDS[name][2] for name in variables])}
    if over:
        coords[over] = "case", np.linspace(1000, 1600, cases)
    summary = dict(robust=robust, objective=float(1e4 * rise.max()), smooth=9e3 * rise.max(), status="converged")
    attrs = {"varied": json.dumps([over] if over else []), "mass [kg]": 14.0, "restitution": 0.9} | summary
    return xr.Dataset(data, coords, attrs)


def surroundings(ds, size=9, names=None, robust="worst"):
    """Gives a grid of the same bowl."""
    name = "soft_peak_force"
    names = [str(name) for name in ds["variable"].values] if names is None else names
    axes = {name: np.linspace(*BOUNDS[name][:2], size) for name in names}
    mesh = np.meshgrid(*(np.linspace(0, 1, size) for _ in names), np.arange(2), indexing="ij")
    bowl = sum((m - middle) ** 2 for m, middle in zip(mesh[:-1], (0.3, 0.5, 0.5), strict=False))
    values = 1e4 * (1 + 4 * bowl) * (1 + 0.1 * mesh[-1])
    period = np.ones(values.shape, int)
    period[:3, ..., 1], period[6:, ..., 0] = 4, 0
    values[-1:, ..., 0] = NAN
    dims = (*names, "case")
    grid = xr.Dataset({name: (dims, values), "period": (dims, period)}, axes)
    reduced = grid[name].mean("case", skipna=False) if robust == "mean" else grid[name].max("case", skipna=False)
    return grid.assign(total=reduced)


def panel(number, *arguments, **options):
    """Gives one of the page's panels: cases, trials, progress, sensitivities, surroundings."""
    return np.ravel(plots.design_overview(*arguments, **options))[number]


def dots(ax, marker):
    """Gives the positions of lines' markers."""
    return np.concatenate([np.zeros((0, 2)), *map(drawn, marked(ax, marker))])


# the objective in each case


def test_cases_are_drawn_over_their_parameter_by_regime():
    ax = panel(0, design())
    assert labels(ax) == ("speed $V$ [m/s]", r"peak force $F_{\max}$ [kN]")
    assert set(legend(ax)) == {"best design", "first design", "worst", "periodic", "irregular"}
    np.testing.assert_allclose(dots(ax, "D")[:, 0], [1400, 1400])
    assert [10 * (1 + 0.3 / 4), 1200] in dots(ax, "o")[:, ::-1].round(9).tolist()
    (bar,) = [c for c in ax.collections if len(c.get_segments())]
    np.testing.assert_allclose(np.diff(bar.get_segments()[0][:, 1]), 1.2)  # twice 600 N
    # without motion a cross at the bottom
    ax = panel(0, design(spoilt=0, regimes=("period 1",) * 4, errors=(0,) * 4))
    assert "no motion" in legend(ax)
    np.testing.assert_allclose(dots(ax, "x"), [[1000, 0.04]])
    ax = panel(0, design(regimes=("period 1",), errors=(0,), over=None))
    assert ax.get_xlabel() == "case"
    assert "worst" not in legend(ax)
    ds = design().assign_coords(mass=("case", [1.0, 2, 3, 4])).assign_attrs(varied=json.dumps(["speed", "mass"]))
    assert panel(0, ds).get_xlabel() == "case, over speed and mass"


# trials


def test_trials_lie_in_the_plane_of_the_first_two_variables():
    ds = design(("clearance", "length", "section.play.2"))
    ax = panel(1, ds)
    assert labels(ax) == ("clearance $C$ [mm]", "length $L$ [m]")
    assert {"best", "start", "trial", "constraint violated", "bound"} == set(legend(ax))
    assert sorted(line.get_xdata()[0] for line in ax.lines if line.get_linestyle() == ":")[-2:] == [0.2, 3.0]
    assert len(dots(ax, "s")) == 3
    np.testing.assert_allclose(dots(ax, "*"), [[1e3 * float(ds["design"][0]), float(ds["design"][1])]])
    assert "soft peak force $\\|F\\|$ [kN]\nworst of 4 cases" in [other.get_ylabel() for other in ax.figure.axes[4:]]
    violated, kept = panel(1, ds).collections
    assert len(violated.get_offsets()) == np.sum(ds["trial_violation"].values > 0)
    assert len(kept.get_offsets()) == np.sum(ds["trial_violation"].values == 0)


# progress


def test_progress_is_the_lowest_that_violates_nothing():
    ds = design(spoilt=0)
    ax = panel(2, ds)
    x, y = drawn(ax.lines[0]).T
    good = np.where(ds["trial_violation"].values == 0, ds["trial_smooth"].values, INF)
    assert y[-1] == pytest.approx(good.min() / 1e3)
    assert np.isnan(y[0])
    assert np.all(np.diff(y[1:]) <= 0)
    assert (x[0], x[-1]) == (900, 5400)
    assert legend(ax) == ["lowest", "constraint violated", "trial", "no motion"]
    ds["trial_smooth"][:] = INF  # without any motion
    assert len(dots(panel(2, ds), "x")) == 18


# sensitivities and surroundings


def test_sensitivities_are_relative():
    ds = design()
    ax = panel(3, ds)
    assert ax.get_ylabel() == "change of soft peak force\nby 1 % of a variable [%]"
    assert legend(ax) == ["clearance $C$", "length $L$"]
    line = next(line for line in ax.lines if line.get_marker() == "o")
    np.testing.assert_allclose(line.get_ydata(), 2e6 * float(ds["design"][0]) / 9e3)


def test_surroundings_are_a_map_near_the_best_design():
    ds = design()
    ax = panel(4, ds, surroundings(ds))
    (mesh,) = ax.collections
    assert np.ma.count_masked(mesh.get_array()) == 9
    assert legend(ax) == ["best"]
    assert float(mesh.get_array()[4, 2]) == pytest.approx(11, rel=0.02)  # kN, the worst case
    assert labels(ax) == ("clearance $C$ [mm]", "length $L$ [m]")
    ds = design(("clearance", "length", "section.play.2"))
    assert panel(4, ds, surroundings(ds, 5)).collections[0].get_array().shape == (5, 5)


def test_one_variable_has_the_objective_upwards():
    ds = design(("section.play.2",), spoilt=3)
    _, trials, _, _, near = plots.design_overview(ds, surroundings(ds))
    for ax in (trials, near):
        assert labels(ax) == ("section.play.2 [m]", "soft peak force $\\|F\\|$ [kN]\nworst of 4 cases")
        assert "best" in legend(ax)
    assert len(trials.figure.axes) == 5  # no colour bar


# the page


def test_a_page_has_all_panels():
    ds = design()
    axes = plots.design_overview(SimpleNamespace(to_xarray=lambda: ds), surroundings(ds), margins=margins())
    assert len(axes) == 6
    title = axes[0].figure.get_suptitle()
    assert title.startswith("$m$ = 14 kg\n$c_r$ = 0.9\nconverged: clearance")
    assert title.endswith("kN, worst of 4 cases")
    assert axes[5].get_xlabel() == "change of the parameter [%]"
    assert len(plots.design_overview(ds)) == 4
    assert len(plots.design_overview(ds, margins=margins())) == 5


@pytest.mark.parametrize(
    ("draw", "words"),
    [
        (lambda: plots.design_overview("run"), "`ds` must be a dataset of optimise_design, but is str"),
        (lambda: plots.design_overview(surroundings(design())), "with `trial_design`, but has"),
        (lambda: panel(4, design(), design()), "`surroundings` must be .*, with `total`, but has"),
        (lambda: plots.design_margins(design(), design()), "event_margins"),
        (
            lambda: panel(4, design(), surroundings(design(), names=["mass"])),
            "over some of clearance, length, but is over mass",
        ),
    ],
)
def test_what_cannot_be_drawn_is_named(draw, words):
    with pytest.raises(ValueError, match=words):
        draw()


def test_wide_values_have_a_logarithmic_scale():
    for values, wide in (([1.0, 9.0, NAN], True), ([1.0, 5.0], False), ([-1.0, 9.0], False)):
        assert isinstance(color_norm(np.array(values)), LogNorm) == wide
    ds = design()
    ds["trial_smooth"][0] *= 30
    assert panel(2, ds).get_yscale() == "log"


def margins():
    """Gives events on both sides of two parameters of two cases; one side of one has none."""
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
    return xr.Dataset({name: ("margin", list(column)) for name, column in columns})


def test_margins_are_bars_to_the_events():
    ax = plots.design_margins(design(), margins())
    assert [text.get_text() for text in ax.get_yticklabels()] == ["clearance [mm]", "length [m]"]
    bars = sorted(float(line.get_xdata()[1]) for line in ax.lines if line.get_linewidth() == 3.5)
    assert bars == pytest.approx([-10.0, -5.0, -5.0, 1.0, 10.0, 20.0], abs=1e-12)
    # an event has a marker and its value; the side without one has neither
    assert [len(dots(ax, marker)) for marker in ("|", "D", "^", "o")] == [2, 1, 1, 1]
    assert sorted(text.get_text().strip() for text in ax.texts) == ["0.19", "0.22", "0.9", "0.95", "1.01"]
    words = legend(ax)
    assert sum("m/s" in word for word in words) == 2
    assert sum(word.startswith("GR") for word in words) == 1
