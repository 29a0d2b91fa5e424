"""Pictures of datasets made by hand: dots, values in display units, labels, colours and marks."""

import dataclasses

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_hex

import slipperjax as sj
from slipperjax import plots
from slipperjax.model.quantities import COORDINATES, SECTIONS
from slipperjax.plots.style import COLORS, POINT_COLORS, REGIME_COLORS, axis_label, case_title, png

from .shown import bar_of, check_legend_fits, drawn, labels, legend, marked


def sections(over="clearance", values=(0.5e-3, 1e-3, 1.5e-3, 2e-3), status=(0, 0, 0, 0), shift=0.0):
    """Gives a sweep's sections: crossing c of case k has velocity 10 k + c, and case k has k + 1 crossings."""
    cases, crossings = len(values), len(values)
    velocity = 10.0 * np.arange(cases)[:, None] + np.arange(crossings) + shift
    velocity = np.where(np.arange(crossings) <= np.arange(cases)[:, None], velocity, np.nan)
    data = {name: ((over, "crossing"), velocity) for name in SECTIONS}
    data |= {"status": (over, np.array(status)), "steps_per_period": (over, np.full(cases, 50))}
    return xr.Dataset(data, {over: list(values)})


def followed(status):
    ways = [sections(status=way, shift=s) for way, s in zip(status, (0.25, 0.5), strict=True)]
    return xr.concat(ways, "direction").assign_coords(direction=["up", "down"])


def trajectory(status=0):
    """Gives two periods: y = sin, v_y = cos, in mm and m/s; the force of point k is k kN after time zero."""
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
LINE = {"speed": np.arange(1.0, 7)}
GRID = {"clearance": [1e-3, 2e-3], "speed": [1.0, 2.0, 3.0]}


def measured(over, status=(0,) * 6, exponent=EXPONENTS):
    """Gives a `lyapunov_sweep` of six cases."""
    dims, shape = tuple(over), tuple(map(len, over.values()))
    data = {
        "exponent": ((*dims, "count"), np.reshape(exponent, (*shape, 1))),
        "stderr": ((*dims, "count"), np.full((*shape, 1), 0.01)),
        "regime": (dims, np.reshape(REGIME_NAMES, shape)),
        "status": (dims, np.reshape(status, shape)),
    }
    return xr.Dataset(data, over)


def test_axis_labels_name_quantity_and_display_unit():
    wanted = {
        "speed": "speed $V$ [m/s]",
        "clearance": "clearance $C$ [mm]",
        "stiffness": "stiffness $K$ [N/m$^{1.5}$]",
        "restitution": "restitution $c_r$",
        "roll_amplitude": "roll amplitude $A_R$ [degrees]",
        "gravity": "gravity $g$ [m/s$^{2}$]",
        "start_y": "start $y$ [mm]",
        "start_w_x": r"start $\omega_X$ [rad/s]",
        "y": "$y$ [mm]",
        "roll": "roll [mrad]",
        "w_z": r"$\omega_Z$ [rad/s]",
        "alpha_x": r"$\alpha_X$ [rad/s$^{2}$]",
        "contact_force": "contact force $F$ [kN]",
        "case": "case",
    }
    assert {name: axis_label(name) for name in wanted} == wanted
    path = "contact.hysteresis"  # which has the unit of its values
    ds, measurement = sections(path), measured({path: np.arange(6.0)})
    ds[path].attrs["units"] = measurement[path].attrs["units"] = "s/m"
    assert plots.bifurcation(ds, "w_x").get_xlabel() == plots.exponents(measurement).get_xlabel() == f"{path} [s/m]"
    assert axis_label(path, measurement.drop_vars(path)) == path


@pytest.mark.parametrize(
    ("draw", "ds", "words"),
    [
        (plots.overview, "run", "of one case over time, such as run.to_xarray(), but is str"),
        (plots.contact_forces, sections(), "such as run.to_xarray(), with `period`, but has v_y"),
        (lambda ds: plots.history(ds, "foo"), trajectory(), "with `foo`, but has"),
        (plots.bifurcations, trajectory().drop_vars("v_y"), "of sweep or follow, with `v_y`"),
        (lambda ds: plots.bifurcation(ds, "y"), sections(), "of sweep or follow, with `y`"),
        (plots.exponents, sections(), "of lyapunov_sweep, with `regime`"),
        (plots.regime_map, None, "of lyapunov_sweep, but is NoneType"),
    ],
)
def test_a_dataset_of_another_kind_is_named(draw, ds, words):
    with pytest.raises(ValueError, match="Argument `ds` must be a dataset") as caught:
        draw(ds)
    assert words in str(caught.value)


# diagrams


@pytest.mark.parametrize(
    ("over", "values", "shown"),
    [
        ("clearance", [1e-3, 4e-3], [1.0, 4.0]),
        ("roll_amplitude", np.radians([0.1, 0.3]), [0.1, 0.3]),
        ("start_y", [-1e-3, 1e-3], [-1.0, 1.0]),
        ("case", [0, 1], [0, 1]),
    ],
)
def test_any_parameter_is_drawn_in_its_display_unit(over, values, shown):
    ax = plots.bifurcation(sections(over, values, (0, 0)), "w_x")
    assert drawn(marked(ax, ".")[0])[:, 0] == pytest.approx([shown[0], shown[1], shown[1]])
    assert labels(ax) == (axis_label(over), r"$\omega_X$ [rad/s]")
    left, right = ax.get_xlim()
    width = shown[1] - shown[0]
    assert shown[0] - left == pytest.approx(right - shown[1])
    assert 0.01 * width < right - shown[1] < 0.1 * width  # not under the frame


def test_there_is_one_dot_for_each_finite_crossing():
    ax = plots.bifurcation(sections(), "v_y")
    (line,) = marked(ax, ".")
    assert drawn(line)[:, 0] == pytest.approx([0.5] + [1.0] * 2 + [1.5] * 3 + [2.0] * 4)
    assert drawn(line)[:, 1] == pytest.approx([0, 10, 11, 20, 21, 22, 30, 31, 32, 33])
    assert (marked(ax, "x"), legend(ax)) == ([], [])
    _, ax = plt.subplots()
    plots.bifurcation(sections(), "v_y", ax, color="#ff0000", ms=5)
    (line,) = marked(ax, ".")
    assert (to_hex(line.get_color()), line.get_markersize()) == ("#ff0000", 5)
    with pytest.raises(ValueError, match=r"`ds` must be swept over 1 parameter"):
        plots.bifurcation(sections().expand_dims(speed=[1.0, 2.0]), "v_y", ax)


def test_flagged_cases_have_a_cross_and_no_dots():
    ax = plots.bifurcation(sections(status=(0, 1, 0, 3)), "v_y")
    assert drawn(marked(ax, ".")[0])[:, 1] == pytest.approx([0, 20, 21, 22])
    (marks,) = marked(ax, "x")
    assert drawn(marks)[:, 0] == pytest.approx([1.0, 2.0])
    assert np.all(drawn(marks)[:, 1] < 0.1)  # of the height of the axes
    assert to_hex(marks.get_color()) == COLORS["grey"]
    assert legend(ax) == ["status not 0"]
    assert ax.get_ylim()[1] < 30  # what is left out does not stretch the axis


def test_five_diagrams_show_five_sections():
    axes = plots.bifurcations(sections())
    assert [ax.get_ylabel() for ax in axes] == [axis_label(name) for name in SECTIONS]
    assert [ax.get_xlabel() for ax in axes] == [""] * 3 + ["clearance $C$ [mm]"] * 2  # at the foot of each column
    assert len(axes[0].figure.axes) == 5
    assert [len(drawn(marked(ax, ".")[0])) for ax in axes] == [10] * 5
    assert legend(axes[0]) == []


def test_followed_motions_and_flagged_cases_are_in_the_legend():
    way = [(0, 0, 0, 1), (0, 0, 0, 0)]
    axes = plots.bifurcations(sections(status=(2, 0, 0, 0)), followed=followed(way))
    assert legend(axes[0]) == ["followed up", "status not 0", "followed down", "from one start"]
    for ax in axes:
        up, down, start = marked(ax, ".")
        assert [len(drawn(line)) for line in (up, down, start)] == [6, 10, 9]
        assert (drawn(up)[0, 1], drawn(down)[0, 1]) == (0.25, 0.5)
        up_cross, start_cross = marked(ax, "x")
        assert drawn(up_cross)[:, 0] == pytest.approx([2.0])
        assert drawn(start_cross)[:, 0] == pytest.approx([0.5])
        assert up.get_color() != down.get_color() != start.get_color()
    axes = plots.bifurcations(sections(), followed=followed([(0,) * 4] * 2).sel(direction=["down"]))
    assert legend(axes[0]) == ["followed down", "from one start"]


# exponents


def test_exponents_are_coloured_by_regime_with_three_standard_errors():
    ax = plots.exponents(measured({"clearance": np.arange(1, 7) * 1e-3}))
    assert labels(ax) == ("clearance $C$ [mm]", "largest exponent [1/period]")
    assert legend(ax) == ["periodic", "regular", "chaotic", "unresolved"]
    lines = [line for line in ax.lines if line.get_marker() in "oDs^v"]
    markers = {to_hex(line.get_color()): drawn(line) for line in lines}
    assert len({line.get_marker() for line in lines}) == 4
    assert list(markers) == list(REGIME_COLORS.values())[:4]  # a regime that is rare is drawn where it occurs
    assert len(set(markers)) == 4
    for name, color in list(REGIME_COLORS.items())[:4]:
        at = [k for k, regime in enumerate(REGIME_NAMES) if regime == name]
        assert markers[color][:, 0] == pytest.approx(np.array(at) + 1)
        assert markers[color][:, 1] == pytest.approx(EXPONENTS[at])
    chaotic = ax.containers[2].lines[2][0].get_segments()
    assert chaotic[0][:, 1] == pytest.approx([0.3 - 0.03, 0.3 + 0.03])


def test_chaos_stands_with_its_least_mean_life_in_legends():
    life = np.where(np.array(REGIME_NAMES) == "chaotic", 3365.1, np.nan)
    line, grid = (
        ds.assign(
            least_mean_life=(ds["regime"].dims, life.reshape(ds["regime"].shape)),
            kind=(ds["regime"].dims, np.full(ds["regime"].shape, "unresolved")),
            period=(ds["regime"].dims, np.ones(ds["regime"].shape, int)),
        )
        for ds in (measured(LINE), measured(GRID))
    )
    for ax in (plots.exponents(line), plots.attractor_map(grid)):
        assert "chaotic (mean life 3365 periods or more)" in legend(ax)
        assert "chaotic" not in legend(ax)
        check_legend_fits(ax)


def test_flagged_exponents_are_unresolved():
    exponent = np.where(np.arange(6) == 4, np.nan, EXPONENTS)
    ax = plots.exponents(measured(LINE, [0, 0, 1, 0, 1, 0], exponent))
    speeds = [drawn(line)[:, 0].tolist() for line in ax.lines if line.get_marker() in "oDs^v"]
    assert speeds == [[1, 6], [2], [3, 4]]  # periodic, regular, unresolved
    (marks,) = marked(ax, "x")
    assert drawn(marks)[:, 0].tolist() == [5]
    assert "no exponent" in legend(ax)
    connected = next(line for line in ax.lines if len(drawn(line)) == 6)
    assert np.isnan(drawn(connected)[:, 1]).tolist() == [False, False, True, False, True, False]


def test_a_regime_map_has_display_units_and_colours_by_sign():
    grid = {"clearance": [1e-3, 2e-3], "roll_amplitude": np.radians([0.1, 0.2, 0.3])}
    ax = plots.regime_map(measured(grid))
    assert labels(ax) == ("roll amplitude $A_R$ [degrees]", "clearance $C$ [mm]")
    (mesh,) = ax.collections
    assert mesh.get_clim() == pytest.approx((-0.2, 0.3))
    assert np.asarray(mesh.get_array()).ravel() == pytest.approx(EXPONENTS)
    edges = np.asarray(mesh.get_coordinates())
    assert edges[0, :, 0] == pytest.approx([0.05, 0.15, 0.25, 0.35])
    assert edges[:, 0, 1] == pytest.approx([0.5, 1.5, 2.5])
    (marks,) = marked(ax, "x")
    assert drawn(marks) == pytest.approx(np.array([[0.1, 2.0]]))
    assert legend(ax) == ["unresolved: estimates\ndisagree or are not sure"]
    assert bar_of(ax).get_ylabel() == "largest exponent [1/period]"
    mesh.update_scalarmappable()
    red, _, blue, _ = mesh.get_facecolors()[2]
    assert red > blue  # chaotic


def test_the_colours_of_a_regime_map_separate_zero_from_small_exponents():
    exponent = np.array([-0.1, -5e-3, 0.0, 5e-3, 0.6, -0.01])
    (mesh,) = plots.regime_map(measured(GRID, exponent=exponent)).collections
    mesh.update_scalarmappable()
    most, small, zero, little, top, less = mesh.get_facecolors()[:, :3]
    assert np.ptp(zero) < 0.02  # white
    assert small[2] - small[0] > 0.1  # blue
    assert little[0] - little[2] > 0.02  # red
    assert most[2] - most[0] > less[2] - less[0] - 0.05
    assert top[0] - top[2] > 0.25
    assert [float(mesh.norm(x)) for x in (-0.1, -0.025, 0.15)] == pytest.approx([0.0, 0.25, 0.75])
    assert np.asarray(mesh.norm.inverse(mesh.norm(exponent))) == pytest.approx(exponent)


def test_flagged_cases_of_a_regime_map_have_a_cross_and_no_colour():
    ax = plots.regime_map(measured(GRID, [0, 0, 1, 0, 0, 0]))
    (mesh,) = ax.collections
    assert np.ma.getmaskarray(mesh.get_array()).ravel().tolist() == [False, False, True, False, False, False]
    assert mesh.get_clim() == pytest.approx((-0.2, 0.2))  # without the flagged case
    assert drawn(marked(ax, "x")[0]) == pytest.approx(np.array([[3.0, 1.0], [1.0, 2.0]]))
    mesh.update_scalarmappable()
    assert to_hex(mesh.get_facecolors()[2]) == COLORS["grey"]  # as the crosses of other pictures
    assert legend(ax)[1] == "status not 0"
    with pytest.raises(ValueError, match=r"`ds` must be swept over 2 parameter"):
        plots.regime_map(measured(LINE))
    assert len(drawn(marked(plots.regime_map(measured(GRID, [1] * 6)), "x")[0])) == 6


# trajectories


@pytest.mark.parametrize(("name", "highest"), [("y", 1.0), ("roll", 5.0), ("a_y", 4 * np.pi)])
def test_a_history_is_drawn_in_display_units(name, highest):
    ax = plots.history(trajectory(), name)
    (line,) = ax.lines
    assert drawn(line)[:, 1].max() == pytest.approx(highest)
    assert drawn(line)[:, 0] == pytest.approx(np.linspace(0, 2, 401))
    assert labels(ax) == ("time [forcing periods]", axis_label(name))


def test_contact_forces_are_those_of_the_highest_peaks():
    ax = plots.contact_forces(trajectory(), most=4)
    assert legend(ax) == [f"{p}, peak {f} kN at 1" for p, f in (("C2", 5), ("B2", 4), ("A2", 3), ("C1", 2))]
    curves = [line for line in ax.lines if len(drawn(line)) > 1]
    assert [drawn(line)[:, 1].max() for line in curves] == pytest.approx([5.0, 4.0, 3.0, 2.0])
    assert ax.get_ylabel() == "contact force $F$ [kN]"
    rear, _, _, front = curves
    assert rear.get_color() == front.get_color() == POINT_COLORS[2]
    assert (rear.get_linestyle(), front.get_linestyle()) == ("--", "-")
    marks = [drawn(line) for line in ax.lines if len(drawn(line)) == 1]
    assert np.concatenate(marks) == pytest.approx(np.array([[1, f] for f in (5, 4, 3, 2)]))
    ax = plots.contact_forces(trajectory(), last=0.5)
    assert [len(line.get_xdata()) for line in ax.lines] == [101] * 4  # the peak lies before, and has no dot
    assert legend(ax)[0] == "C2, peak 5 kN at 1"
    assert len(plots.contact_forces(trajectory(), last=None).lines[0].get_xdata()) == 401


def test_peaks_between_the_saved_states_are_drawn_where_they_are_known():
    ds = trajectory()
    ds["peak_force"] = 1.1 * ds["contact_force"].max("time")
    ds["peak_period"] = 0 * ds["peak_force"] + 1.001
    ax = plots.contact_forces(ds, most=1)
    assert legend(ax) == ["C2, peak 5.5 kN at 1.001"]
    assert drawn(ax.lines[1]) == pytest.approx(np.array([[1.001, 5.5]]))


@pytest.mark.parametrize("steps", [1.0, 1.1], ids=["saved", "over all steps"])
@pytest.mark.parametrize("part", [slice(0, 150), slice(150, 250), slice(250, None)], ids=["before", "with", "behind"])
def test_peaks_of_a_part_of_a_run_are_those_of_the_part(part, steps):
    """Of the whole run the peak is at 1, whose saved force is 1 / `steps` of it."""
    ds = trajectory()
    if steps > 1:
        ds["peak_force"] = steps * ds["contact_force"].max("time")
        ds["peak_period"] = 0 * ds["peak_force"] + 1.001
    ds = ds.isel(time=part)
    highest = ds["contact_force"].max("time").sel(end="rear", point="C").item()
    wanted = 5.0 * steps if part == slice(150, 250) else highest / 1e3
    for ax in (plots.contact_forces(ds, last=None, most=1), plots.overview(ds)[5, 1]):
        name, text = legend(ax)[0].split(", peak ")
        assert name == "C2"
        assert text == (f"{wanted:.3g} kN" if wanted == 0 else f"{wanted:.3g} kN at {instant(ds, steps):.4g}")


def instant(ds, steps):
    """When the rear force of C is highest in a dataset."""
    period = ds["period"].values
    if steps > 1 and period[0] < 1 < period[-1]:
        return 1.001
    return period[np.argmax(ds["contact_force"].sel(end="rear", point="C").values)]


def test_a_peak_at_an_unknown_instant_is_that_of_the_whole_run():
    ds = trajectory()
    ds["peak_force"] = 1.1 * ds["contact_force"].max("time")
    ax = plots.contact_forces(ds.isel(time=slice(300, None)), most=1)
    assert legend(ax) == ["C2, peak 5.5 kN in the whole run"]


def test_an_overview_shows_everything_and_names_a_bad_status():
    axes = plots.overview(trajectory())
    names = ["y", "v_y", "z", "v_z", "roll", "w_x", "pitch", "w_y", "yaw", "w_z", *["contact_force"] * 2]
    wanted = [axis_label(name) for name in [*names, "drive_force", "drive_force"]]
    assert [ax.get_ylabel() for ax in axes.flat] == wanted
    assert axes[0, 0].figure.get_suptitle() == ""
    for ax in axes[5]:
        check_legend_fits(ax)
    named = trajectory(status=2).assign_attrs({"speed [m/s]": 1250.0})
    derailed = plots.overview(named)[0, 0].figure._suptitle
    assert derailed.get_text().startswith("$V$ = 1250 m/s\nstatus: derailed")
    assert to_hex(derailed.get_color()) == COLORS["red"]


def test_a_phase_portrait_marks_upward_zero_crossings():
    ax = plots.phase_portrait(trajectory().isel(time=slice(10, None)), "y", "v_y")
    orbit, section = ax.lines
    assert drawn(orbit).max(axis=0) == pytest.approx([1.0, 2.0], rel=1e-3)
    assert drawn(section) == pytest.approx(np.array([[0.0, 2.0]] * len(drawn(section))), abs=1e-3)
    assert 1 <= len(drawn(section)) <= 2
    assert labels(ax) == ("$y$ [mm]", "$V_Y$ [m/s]")


def test_a_spectrum_is_logarithmic_and_without_its_mean():
    frequency = np.arange(0.0, 101.0)
    ax = plots.spectrum(frequency, 10.0**-frequency, unit="(rad/s^2)^2/Hz", highest=40.0)
    (line,) = ax.lines
    assert drawn(line)[:, 0].tolist() == list(range(1, 41))
    assert drawn(line)[:, 1] == pytest.approx(10.0 ** -np.arange(1.0, 41))
    assert ax.get_yscale() == "log"
    assert labels(ax) == ("frequency [Hz]", "PSD [(rad/s$^{2}$)$^{2}$/Hz]")
    assert len(drawn(plots.spectrum(frequency, 1 + frequency).lines[0])) == 100


# titles, axes and style


def test_titles_state_the_fixed_parameters_in_display_units():
    ds = xr.Dataset(attrs={"speed [m/s]": 1250.0, "clearance [m]": 1e-3, "length [m]": 0.2, "restitution": 0.9})
    assert case_title(ds) == "$V$ = 1250 m/s, $C$ = 1 mm, $L$ = 0.2 m"
    more = {"stiffness [N/m^1.5]": 2.5e9, "roll_amplitude [rad]": np.radians(0.2), "wavelengths [m]": [10.0, 12.0]}
    first, second = case_title(ds.assign_attrs(more), full=True).splitlines()
    assert first == case_title(ds)
    assert second == r"$K$ = 2.5e+09 N/m$^{1.5}$, $c_r$ = 0.9, $A_R$ = 0.2°, $L_X$ = 10 and 12 m"
    assert case_title(xr.Dataset()) == case_title(xr.Dataset(), full=True) == ""
    varied = xr.Dataset(coords={"speed": [1.0, 2.0]}, attrs={"clearance [m]": 2e-3})
    assert case_title(varied) == "$C$ = 2 mm"
    for one in (varied.isel(speed=1), varied.isel(speed=[1])):  # a grid of one value has a dimension
        assert case_title(one) == "$V$ = 2 m/s, $C$ = 2 mm"


TITLE = {"length [m]": 0.2}


@pytest.mark.parametrize(
    ("draw", "ds"),
    [
        (lambda ds, ax: plots.bifurcation(ds, "w_x", ax), sections(status=(0, 1, 0, 0))),
        (plots.exponents, measured(LINE)),
        (plots.regime_map, measured(GRID)),
        (lambda ds, ax: plots.history(ds, "y", ax), trajectory()),
        (plots.contact_forces, trajectory()),
        (lambda ds, ax: plots.phase_portrait(ds, "roll", "w_x", ax), trajectory()),
        (lambda ds, ax: plots.spectrum(np.arange(5.0), np.ones(5), ax), None),
    ],
)
def test_every_picture_goes_into_given_axes_or_new_ones_with_a_title(draw, ds):
    _, ax = plt.subplots()
    ds = None if ds is None else ds.assign_attrs(TITLE)
    assert draw(ds, ax) is ax
    assert ax.figure.get_suptitle() == ""
    new = draw(ds, None)
    assert new.figure is not ax.figure
    assert ds is None or new.figure.get_suptitle() == "$L$ = 0.2 m"
    new.figure.canvas.draw()  # labels can be typeset


def test_no_legend_is_wider_than_its_axes():
    for ax in (
        plots.bifurcations(sections(status=(2, 0, 0, 0)), followed=followed([(0, 0, 0, 1), (0,) * 4]))[0],
        plots.exponents(measured(LINE, exponent=np.where(np.arange(6) == 4, np.nan, 1))),
        plots.regime_map(measured(GRID, [0, 0, 1, 0, 0, 0])),
        plots.contact_forces(trajectory()),
    ):
        check_legend_fits(ax)
        assert ax.get_legend().get_window_extent().y0 >= ax.get_window_extent().y1 - 1  # above, not upon the dots


def test_the_style_leaves_all_other_settings_as_they_are():
    before = dict(plt.rcParams)
    with plots.styled():
        assert plt.rcParams["font.size"] == 8
        plt.rcParams["interactive"] = not before["interactive"]  # as the first figure of a session may do
    after = dict(plt.rcParams)
    plt.rcParams["interactive"] = before["interactive"]
    assert after.pop("interactive") is not before.pop("interactive")
    assert after == before


def test_rails_are_drawn_from_where_they_begin():
    places = np.linspace(0.0, 64.0, 257)
    track = sj.SampledTrack(129_773.0 + places, 1e-3 * np.sin(places), 0.0, ramp=0.0)
    upper, _ = plots.rail(dataclasses.replace(sj.paper_scene(), track=track))
    x, y = upper.lines[0].get_data()
    inside = x < 129_837.0
    x, y = x[inside], y[inside]
    assert upper.get_xlim()[0] == 129_773.0
    np.testing.assert_allclose(y, np.sin(x - 129_773.0), atol=5e-3)  # the spline is natural at the ends


WRONG = [
    (lambda ds: plots.history(ds, "y", 3), "`ax` must be Axes of matplotlib"),
    (lambda ds: plots.history(ds, ["y"]), "`name` must be the name of a variable"),
    (lambda ds: plots.phase_portrait(ds, {}, "v_y"), "`name` must be the name of a variable"),
    (lambda ds: plots.contact_forces(ds, most="all"), "`most` must be a whole number"),
    (lambda ds: plots.contact_forces(ds, last=()), "`last` must be one number"),
    (lambda ds: plots.instant(ds, at="end"), "`at` must be finite"),
    (lambda ds: plots.instant(ds, last="all"), "`last` must be positive"),
    (lambda ds: plots.spectrum("text", [1.0]), "`frequency` must be real numbers"),
    (lambda ds: plots.spectrum([1.0, 2.0], [1.0]), "`density` must be of the shape"),
    (lambda ds: axis_label(ds), "`name` must be the name of a quantity"),
    (lambda ds: case_title(3), "`ds` must be a dataset of a run"),
    (lambda ds: png(3, 100), "`figure` must be a figure of matplotlib"),
    (lambda ds: png(plt.figure(), "fine"), "`dpi` must be positive"),
]


@pytest.mark.parametrize(("call", "words"), WRONG, ids=[row[1] for row in WRONG])
def test_wrong_inputs_of_pictures_are_one_line(call, words):
    ds = sj.simulate(sj.paper_scene(), 3, steps_per_period=50).to_xarray()
    with pytest.raises(ValueError, match=f"^Argument {words}"):
        call(ds)
