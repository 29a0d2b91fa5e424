"""What is drawn: dots, values in display units, labels, colours and marks, from datasets made by hand."""

import matplotlib
import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_hex

from slipperjax import plots
from slipperjax.model import COORDINATES, SECTIONS

matplotlib.use("Agg")
import matplotlib.pyplot as plt


@pytest.fixture(autouse=True)
def _closed():
    yield
    plt.close("all")


def sections(over="clearance", values=(0.5e-3, 1e-3, 1.5e-3, 2e-3), status=(0, 0, 0, 0), shift=0.0):
    """A sweep's sections: crossing c of case k has velocity 10 k + c, and case k has k + 1 crossings."""
    cases, crossings = len(values), len(values)
    found = 10.0 * np.arange(cases)[:, None] + np.arange(crossings) + shift
    found = np.where(np.arange(crossings) <= np.arange(cases)[:, None], found, np.nan)
    data = {name: ((over, "crossing"), found) for name in SECTIONS}
    data |= {"status": (over, np.array(status)), "steps_per_period": (over, np.full(cases, 50))}
    return xr.Dataset(data, {over: list(values)})


def followed(status):
    ways = [sections(status=way, shift=s) for way, s in zip(status, (0.25, 0.5), strict=True)]
    return xr.concat(ways, "direction").assign_coords(direction=["up", "down"])


def trajectory(status=0):
    """Two periods: y = sin, v_y = cos, in mm and m/s; the force of point k is k kN after time zero."""
    period = np.linspace(0, 2, 401)
    angle = 2 * np.pi * period
    data = {name: ("time", np.full(401, float(k))) for k, name in enumerate(COORDINATES)}
    data |= {"y": ("time", 1e-3 * np.sin(angle)), "v_y": ("time", 2 * np.cos(angle))}
    data["roll"] = ("time", 5e-3 * np.sin(angle))
    data |= {"a_y": ("time", angle), "drive_force": ("time", 10 * angle)}
    force = np.zeros((401, 2, 3))
    force[200] = 1e3 * np.arange(6).reshape(2, 3)
    data["contact_force"] = (("time", "end", "point"), force)
    coords = {"period": ("time", period), "end": ["front", "rear"], "point": ["A", "B", "C"]}
    return xr.Dataset(data, coords, {"status": status, "steps_per_period": 200})


REGIME_NAMES = ["periodic", "regular", "chaotic", "unresolved", "chaotic", "periodic"]
EXPONENTS = np.array([-0.2, 0.0, 0.3, 0.1, 0.2, -0.1])


def measured(over, shape, status=None, exponent=EXPONENTS):
    """A `lyapunov_sweep` of six cases."""
    dims, status = tuple(over), np.zeros(6, int) if status is None else np.array(status)
    data = {
        "exponent": ((*dims, "count"), np.reshape(exponent, (*shape, 1))),
        "stderr": ((*dims, "count"), np.full((*shape, 1), 0.01)),
        "regime": (dims, np.reshape(REGIME_NAMES, shape)),
        "status": (dims, np.reshape(status, shape)),
    }
    return xr.Dataset(data, over)


def drawn(line):
    return np.array(line.get_xydata())


def dots(ax):
    return [line for line in ax.lines if line.get_marker() == "."]


def crosses(ax):
    return [line for line in ax.lines if line.get_marker() == "x"]


def legend_texts(ax):
    return [] if ax.get_legend() is None else [text.get_text() for text in ax.get_legend().get_texts()]


@pytest.mark.parametrize(
    ("name", "label"),
    [
        ("speed", "speed $V$ [m/s]"),
        ("clearance", "clearance $C$ [mm]"),
        ("length", "length $L$ [m]"),
        ("mass", "mass $m$ [kg]"),
        ("stiffness", "stiffness $K$ [N/m$^{1.5}$]"),
        ("restitution", "restitution $c_r$"),
        ("amplitude", "amplitude $A$ [mm]"),
        ("roll_amplitude", "roll amplitude $A_R$ [degrees]"),
        ("gravity", "gravity $g$ [m/s$^{2}$]"),
        ("start_y", "start $y$ [mm]"),
        ("start_v_y", "start $V_Y$ [m/s]"),
        ("start_w_x", r"start $\omega_X$ [rad/s]"),
        ("y", "$y$ [mm]"),
        ("roll", "roll [mrad]"),
        ("w_z", r"$\omega_Z$ [rad/s]"),
        ("alpha_x", r"$\alpha_X$ [rad/s$^{2}$]"),
        ("contact_force", "contact force $F$ [kN]"),
        ("drive_force", "drive force $F_X$ [N]"),
        ("case", "case"),
    ],
)
def test_axis_labels_name_quantity_and_display_unit(name, label):
    assert plots.axis_label(name) == label


@pytest.mark.parametrize(
    ("over", "values", "shown"),
    [
        ("clearance", [1e-3, 4e-3], [1.0, 4.0]),
        ("speed", [900.0, 2300.0], [900.0, 2300.0]),
        ("roll_amplitude", np.radians([0.1, 0.3]), [0.1, 0.3]),
        ("stiffness", [1e7, 1e8], [1e7, 1e8]),
        ("restitution", [0.5, 1.0], [0.5, 1.0]),
        ("start_y", [-1e-3, 1e-3], [-1.0, 1.0]),
        ("start_v_y", [-0.5, 0.5], [-0.5, 0.5]),
        ("case", [0, 1], [0, 1]),
    ],
)
def test_any_parameter_is_drawn_in_its_display_unit(over, values, shown):
    ax = plots.bifurcation(sections(over, values, (0, 0)), "w_x")
    assert drawn(dots(ax)[0])[:, 0] == pytest.approx([shown[0], shown[1], shown[1]])
    assert ax.get_xlabel() == plots.axis_label(over)
    assert ax.get_xlim() == pytest.approx(shown)
    assert ax.get_ylabel() == r"$\omega_X$ [rad/s]"


def test_there_is_one_dot_for_each_finite_crossing():
    ds = sections()
    ax = plots.bifurcation(ds, "v_y")
    (line,) = dots(ax)
    assert len(drawn(line)) == np.isfinite(ds["v_y"]).sum() == 10
    assert drawn(line)[:, 0] == pytest.approx([0.5] + [1.0] * 2 + [1.5] * 3 + [2.0] * 4)
    assert drawn(line)[:, 1] == pytest.approx([0, 10, 11, 20, 21, 22, 30, 31, 32, 33])
    assert crosses(ax) == []
    assert legend_texts(ax) == []


@pytest.mark.parametrize("code", [1, 2, 3])
def test_flagged_cases_have_a_cross_and_no_dots(code):
    ds = sections(status=(0, code, 0, code))
    ax = plots.bifurcation(ds, "v_y")
    assert drawn(dots(ax)[0])[:, 1] == pytest.approx([0, 20, 21, 22])
    (marks,) = crosses(ax)
    assert drawn(marks)[:, 0] == pytest.approx([1.0, 2.0])
    assert np.all(drawn(marks)[:, 1] < 0.1)  # of the height of the axes
    assert to_hex(marks.get_color()) == plots.COLORS["grey"]
    assert legend_texts(ax) == ["status not 0"]
    assert ax.get_xlim() == pytest.approx((0.5, 2.0))
    assert ax.get_ylim()[1] < 30  # what is left out does not stretch the axis


def test_a_bifurcation_diagram_draws_into_the_axes_it_is_given():
    _, ax = plt.subplots()
    assert plots.bifurcation(sections(), "v_y", ax, color="#ff0000", ms=5) is ax
    assert to_hex(dots(ax)[0].get_color()) == "#ff0000"
    assert dots(ax)[0].get_markersize() == 5
    with pytest.raises(ValueError, match=r"`ds` must be swept over 1 parameter"):
        plots.bifurcation(sections().expand_dims(speed=[1.0, 2.0]), "v_y", ax)


def test_five_diagrams_show_five_sections():
    axes = plots.bifurcations(sections())
    assert [ax.get_ylabel() for ax in axes] == [plots.axis_label(name) for name in SECTIONS]
    assert [ax.get_xlabel() for ax in axes] == [""] * 4 + ["clearance $C$ [mm]"]
    assert [ax.texts[0].get_text() for ax in axes] == ["(a)", "(b)", "(c)", "(d)", "(e)"]
    assert [len(drawn(dots(ax)[0])) for ax in axes] == [10] * 5
    assert legend_texts(axes[0]) == []


def test_followed_motions_and_flagged_cases_are_in_the_legend():
    way = [(0, 0, 0, 1), (0, 0, 0, 0)]
    axes = plots.bifurcations(sections(status=(2, 0, 0, 0)), followed=followed(way))
    assert legend_texts(axes[0]) == ["followed up", "followed down", "from one start", "status not 0"]
    for ax in axes:
        up, down, start = dots(ax)
        assert [len(drawn(line)) for line in (up, down, start)] == [6, 10, 9]
        assert drawn(up)[0, 1] == 0.25
        assert drawn(down)[0, 1] == 0.5
        up_cross, start_cross = crosses(ax)
        assert drawn(up_cross)[:, 0] == pytest.approx([2.0])
        assert drawn(start_cross)[:, 0] == pytest.approx([0.5])
        assert up_cross.get_color() == up.get_color() != start_cross.get_color()
        assert up.get_color() != down.get_color() != start.get_color()


def test_one_direction_alone_can_be_followed():
    axes = plots.bifurcations(sections(), followed=followed([(0,) * 4] * 2).sel(direction=["down"]))
    assert legend_texts(axes[0]) == ["followed down", "from one start"]


def test_exponents_are_coloured_by_regime_with_three_standard_errors():
    ax = plots.exponents(measured({"clearance": np.arange(1, 7) * 1e-3}, (6,)))
    assert ax.get_xlabel() == "clearance $C$ [mm]"
    assert ax.get_ylabel() == "largest exponent [1/period]"
    assert legend_texts(ax) == ["periodic", "regular", "chaotic", "unresolved"]
    found = {to_hex(line.get_color()): drawn(line) for line in dots(ax)}
    assert list(found) == list(plots.REGIME_COLORS.values())[:4]  # a regime that is rare is drawn where it occurs
    assert len(set(found)) == 4
    for name, color in list(plots.REGIME_COLORS.items())[:4]:
        at = [k for k, regime in enumerate(REGIME_NAMES) if regime == name]
        assert found[color][:, 0] == pytest.approx(np.array(at) + 1)
        assert found[color][:, 1] == pytest.approx(EXPONENTS[at])
    chaotic = ax.containers[2].lines[2][0].get_segments()
    assert chaotic[0][:, 1] == pytest.approx([0.3 - 0.03, 0.3 + 0.03])


def test_flagged_exponents_are_unresolved():
    exponent = np.where(np.arange(6) == 4, np.nan, EXPONENTS)
    ax = plots.exponents(measured({"speed": np.arange(1.0, 7)}, (6,), [0, 0, 1, 0, 1, 0], exponent))
    periodic, regular, chaotic, unresolved = (drawn(line)[:, 0].tolist() for line in dots(ax))
    assert (periodic, regular, chaotic, unresolved) == ([1, 6], [2], [], [3, 4])
    (marks,) = crosses(ax)
    assert drawn(marks)[:, 0].tolist() == [5]
    assert legend_texts(ax)[-1] == "no exponent"
    connected = next(line for line in ax.lines if len(drawn(line)) == 6)
    assert np.isnan(drawn(connected)[:, 1]).tolist() == [False, False, True, False, True, False]


def test_a_regime_map_has_display_units_and_symmetric_colours():
    grid = {"clearance": [1e-3, 2e-3], "roll_amplitude": np.radians([0.1, 0.2, 0.3])}
    ax = plots.regime_map(measured(grid, (2, 3)))
    assert ax.get_xlabel() == "roll amplitude $A_R$ [degrees]"
    assert ax.get_ylabel() == "clearance $C$ [mm]"
    (mesh,) = ax.collections
    assert mesh.get_clim() == pytest.approx((-0.3, 0.3))
    assert np.asarray(mesh.get_array()).ravel() == pytest.approx(EXPONENTS)
    edges = np.asarray(mesh.get_coordinates())
    assert edges[0, :, 0] == pytest.approx([0.05, 0.15, 0.25, 0.35])
    assert edges[:, 0, 1] == pytest.approx([0.5, 1.5, 2.5])
    (marks,) = crosses(ax)
    assert drawn(marks) == pytest.approx(np.array([[0.1, 2.0]]))
    assert legend_texts(ax) == ["unresolved"]
    bar = next(other for other in ax.figure.axes if other is not ax)
    assert bar.get_ylabel() == "largest exponent [1/period]"
    mesh.update_scalarmappable()
    red, _, blue, _ = mesh.get_facecolors()[2]
    assert red > blue  # chaotic


def test_flagged_cases_of_a_regime_map_have_a_cross_and_no_colour():
    grid = {"clearance": [1e-3, 2e-3], "speed": [1.0, 2.0, 3.0]}
    ax = plots.regime_map(measured(grid, (2, 3), [0, 0, 1, 0, 0, 0]))
    (mesh,) = ax.collections
    assert np.ma.getmaskarray(mesh.get_array()).ravel().tolist() == [False, False, True, False, False, False]
    assert mesh.get_clim() == pytest.approx((-0.2, 0.2))  # without the flagged case
    assert drawn(crosses(ax)[0]) == pytest.approx(np.array([[3.0, 1.0], [1.0, 2.0]]))
    mesh.update_scalarmappable()
    assert to_hex(mesh.get_facecolors()[2]) == "#d0d0d0"
    with pytest.raises(ValueError, match=r"`ds` must be swept over 2 parameter"):
        plots.regime_map(measured({"speed": np.arange(6.0)}, (6,)))


def test_a_regime_map_without_any_good_case_can_be_drawn():
    ax = plots.regime_map(measured({"clearance": [1e-3, 2e-3], "speed": [1.0, 2.0, 3.0]}, (2, 3), [1] * 6))
    assert len(drawn(crosses(ax)[0])) == 6


@pytest.mark.parametrize(
    ("name", "highest"), [("y", 1.0), ("roll", 5.0), ("v_y", 2.0), ("a_y", 4 * np.pi), ("drive_force", 40 * np.pi)]
)
def test_a_history_is_drawn_in_display_units(name, highest):
    ax = plots.history(trajectory(), name)
    (line,) = ax.lines
    assert drawn(line)[:, 1].max() == pytest.approx(highest)
    assert drawn(line)[:, 0] == pytest.approx(np.linspace(0, 2, 401))
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("time [forcing periods]", plots.axis_label(name))


def test_contact_forces_are_those_of_the_highest_peaks():
    ax = plots.contact_forces(trajectory(), most=3)
    assert legend_texts(ax) == ["C2", "B2", "A2"]
    assert [drawn(line)[:, 1].max() for line in ax.lines] == pytest.approx([5.0, 4.0, 3.0])
    assert ax.get_ylabel() == "contact force $F$ [kN]"


def test_an_overview_shows_everything_and_names_a_bad_status():
    axes = plots.overview(trajectory())
    names = ("y", "v_y", "z", "v_z", "roll", "w_x", "pitch", "w_y", "yaw", "w_z", "contact_force", "drive_force")
    assert [ax.get_ylabel() for ax in axes.flat] == [plots.axis_label(name) for name in names]
    assert axes[0, 0].figure.get_suptitle() == ""
    derailed = plots.overview(trajectory(status=2))
    assert derailed[0, 0].figure.get_suptitle().startswith("status: derailed")


def test_a_phase_portrait_marks_upward_zero_crossings():
    ax = plots.phase_portrait(trajectory().isel(time=slice(10, None)), "y", "v_y")
    orbit, section = ax.lines
    assert drawn(orbit).max(axis=0) == pytest.approx([1.0, 2.0], rel=1e-3)
    assert drawn(section) == pytest.approx(np.array([[0.0, 2.0]] * len(drawn(section))), abs=1e-3)
    assert 1 <= len(drawn(section)) <= 2
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("$y$ [mm]", "$V_Y$ [m/s]")


def test_a_spectrum_is_logarithmic_and_without_its_mean():
    frequency = np.arange(0.0, 101.0)
    ax = plots.spectrum(frequency, 10.0**-frequency, unit="(rad/s^2)^2/Hz", highest=40.0)
    (line,) = ax.lines
    assert drawn(line)[:, 0].tolist() == list(range(1, 41))
    assert drawn(line)[:, 1] == pytest.approx(10.0 ** -np.arange(1.0, 41))
    assert ax.get_yscale() == "log"
    assert ax.get_xlabel() == "frequency [Hz]"
    assert ax.get_ylabel() == "PSD [(rad/s$^{2}$)$^{2}$/Hz]"
    assert len(drawn(plots.spectrum(frequency, 1 + frequency).lines[0])) == 100


@pytest.mark.parametrize(
    "draw",
    [
        lambda ax: plots.bifurcation(sections(status=(0, 1, 0, 0)), "w_x", ax),
        lambda ax: plots.exponents(measured({"speed": np.arange(6.0)}, (6,)), ax),
        lambda ax: plots.regime_map(measured({"clearance": [1e-3, 2e-3], "speed": [1.0, 2.0, 3.0]}, (2, 3)), ax),
        lambda ax: plots.history(trajectory(), "y", ax),
        lambda ax: plots.contact_forces(trajectory(), ax),
        lambda ax: plots.phase_portrait(trajectory(), "roll", "w_x", ax),
        lambda ax: plots.spectrum(np.arange(5.0), np.ones(5), ax),
    ],
)
def test_every_picture_goes_into_given_axes_or_new_ones(draw):
    _, ax = plt.subplots()
    assert draw(ax) is ax
    new = draw(None)
    assert new is not ax
    assert new.figure is not ax.figure
    new.figure.canvas.draw()  # labels can be typeset
