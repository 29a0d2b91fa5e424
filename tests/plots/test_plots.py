"""Pictures of datasets made by hand: dots, values in display units, labels, colours and marks."""

import dataclasses

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_hex

import slipperjax as sj
from slipperjax import plots
from slipperjax.analysis.kinds import REGIMES
from slipperjax.model.quantities import COORDINATES, SECTIONS
from slipperjax.plots.style import COLORS, MOTION_COLORS, POINT_COLORS, axis_label, case_title, png, quantity_of
from slipperjax.plots.trajectories import most_loaded

from ..common import among
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


# diagrams


@pytest.mark.parametrize("over", ["clearance", "roll_amplitude", "start_y", "case"])
def test_any_parameter_is_drawn_in_its_display_unit(over):
    """With one dot for each crossing, and a cross instead where a case is flagged."""
    ax = plots.bifurcation(sections(over, status=(0, 1, 0, 3)), "w_x", color="#ff0000")
    (line,), (marks,) = marked(ax, "."), marked(ax, "x")
    shown = quantity_of(over).shown(np.array([0.5e-3, 1e-3, 1.5e-3, 2e-3]))
    assert drawn(line)[:, 0] == pytest.approx(shown[[0, 2, 2, 2]])
    assert drawn(line)[:, 1] == pytest.approx([0, 20, 21, 22])
    assert to_hex(line.get_color()) == "#ff0000"
    assert labels(ax) == (axis_label(over), r"$\omega_X$ [rad/s]")
    assert drawn(marks)[:, 0] == pytest.approx(shown[[1, 3]])
    assert np.all(drawn(marks)[:, 1] < 0.1)  # of the height of the axes
    assert legend(ax) == ["status not 0"]
    assert ax.get_ylim()[1] < 30  # what is left out does not stretch the axis


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
    assert len({line.get_marker() for line in lines}) == 4
    for name, line in zip(REGIMES, lines, strict=False):
        at = np.flatnonzero(np.array(REGIME_NAMES) == name)
        assert to_hex(line.get_color()) == MOTION_COLORS[name]
        assert drawn(line) == pytest.approx(np.stack([at + 1, EXPONENTS[at]], axis=1))
    chaotic = ax.containers[2].lines[2][0].get_segments()
    assert chaotic[0][:, 1] == pytest.approx([0.3 - 0.03, 0.3 + 0.03])


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
    """White at zero only; grey and with a cross where a case is flagged."""
    grid = {"clearance": [1e-3, 2e-3], "roll_amplitude": np.radians([0.1, 0.2, 0.3])}
    ax = plots.regime_map(measured(grid, [0, 0, 0, 0, 0, 1]))
    assert labels(ax) == ("roll amplitude $A_R$ [degrees]", "clearance $C$ [mm]")
    (mesh,) = ax.collections
    assert mesh.get_array().filled(9).ravel() == pytest.approx([*EXPONENTS[:5], 9])
    edges = np.asarray(mesh.get_coordinates())
    assert edges[0, :, 0] == pytest.approx([0.05, 0.15, 0.25, 0.35])
    assert edges[:, 0, 1] == pytest.approx([0.5, 1.5, 2.5])
    assert drawn(marked(ax, "x")[0]) == pytest.approx(np.array([[0.1, 2.0], [0.3, 2.0]]))
    assert legend(ax) == ["unresolved: estimates\ndisagree or are not sure", "status not 0"]
    assert bar_of(ax).get_ylabel() == "largest exponent [1/period]"
    numbers = np.array([-0.2, -0.05, 0.0, 0.075, 0.3])
    assert np.asarray(mesh.norm(numbers)) == pytest.approx([0.0, 0.25, 0.5, 0.75, 1.0])
    assert np.asarray(mesh.norm.inverse(mesh.norm(numbers))) == pytest.approx(numbers)
    mesh.update_scalarmappable()
    colors = mesh.get_facecolors()
    assert colors[0][2] > colors[0][0]  # blue below zero
    assert colors[2][0] > colors[2][2]  # red above
    assert np.ptp(colors[1][:3]) < 0.02
    assert to_hex(colors[5]) == COLORS["grey"]
    assert len(drawn(marked(plots.regime_map(measured(GRID, [1] * 6)), "x")[0])) == 6


# trajectories


def test_histories_portraits_and_spectra_have_their_units():
    (line,) = plots.history(trajectory(), "roll").lines
    assert drawn(line)[:, 1].max() == pytest.approx(5.0)  # mrad
    assert labels(line.axes) == ("time [forcing periods]", "roll [mrad]")
    ax = plots.phase_portrait(trajectory().isel(time=slice(10, None)), "y", "v_y")
    orbit, section = ax.lines
    assert drawn(orbit).max(axis=0) == pytest.approx([1.0, 2.0], rel=1e-3)
    # upward zero crossings
    assert drawn(section) == pytest.approx(np.array([[0.0, 2.0]] * len(drawn(section))), abs=1e-3)
    assert labels(ax) == ("$y$ [mm]", "$V_Y$ [m/s]")
    frequency = np.arange(0.0, 101.0)
    ax = plots.spectrum(frequency, 10.0**-frequency, unit="(rad/s^2)^2/Hz", highest=40.0)
    assert drawn(ax.lines[0]) == pytest.approx(
        np.stack([frequency, 10.0**-frequency], axis=1)[1:41]
    )  # without its mean
    assert ax.get_yscale() == "log"
    assert labels(ax) == ("frequency [Hz]", "PSD [(rad/s$^{2}$)$^{2}$/Hz]")


def test_contact_forces_are_those_of_the_highest_peaks():
    ax = plots.contact_forces(trajectory(), most=4)
    assert legend(ax) == [f"{p}, peak {f} kN at 1" for p, f in (("C2", 5), ("B2", 4), ("A2", 3), ("C1", 2))]
    curves = [line for line in ax.lines if len(drawn(line)) > 1]
    assert [drawn(line)[:, 1].max() for line in curves] == pytest.approx([5.0, 4.0, 3.0, 2.0])
    rear, _, _, front = curves
    assert rear.get_color() == front.get_color() == POINT_COLORS[2]
    assert (rear.get_linestyle(), front.get_linestyle()) == ("--", "-")
    marks = [drawn(line) for line in ax.lines if len(drawn(line)) == 1]
    assert np.concatenate(marks) == pytest.approx(np.array([[1, f] for f in (5, 4, 3, 2)]))
    ax = plots.contact_forces(trajectory(), last=0.5)
    assert [len(line.get_xdata()) for line in ax.lines] == [101] * 4  # the peak lies before, and has no dot
    # peaks of all steps, and without their instants
    ds = trajectory()
    ds["peak_force"] = 1.1 * ds["contact_force"].max("time")
    part = plots.contact_forces(ds.isel(time=slice(300, None)), most=1)
    assert legend(part) == ["C2, peak 5.5 kN in the whole run"]
    ds["peak_period"] = 0 * ds["peak_force"] + 1.001
    ax = plots.contact_forces(ds, most=1)
    assert legend(ax) == ["C2, peak 5.5 kN at 1.001"]
    assert drawn(ax.lines[1]) == pytest.approx(np.array([[1.001, 5.5]]))


def test_datasets_in_chunks_are_drawn():
    ds = trajectory()
    whole = most_loaded(ds, 2)
    parts = most_loaded(ds.chunk(time=2), 2)
    assert [line.name for line in parts] == [line.name for line in whole]


def test_rails_without_waves_are_drawn_over_distance_and_lost_motions_without_numbers():
    ds = trajectory().assign_attrs({"wavelength [m]": np.array([8.0])})
    (line,) = plots.history(ds, "roll").lines
    assert labels(line.axes) == ("distance [m]", "roll [mrad]")
    assert drawn(line)[[0, -1], 0].tolist() == [0.0, 16.0]
    ax = plots.contact_forces(ds, most=1)
    assert (ax.get_xlabel(), legend(ax)) == ("distance [m]", ["C2, peak 5 kN at 8.00 m"])
    assert drawn(ax.lines[1]).tolist() == [[8.0, 5.0]]
    far = ds.assign_coords(period=ds["period"] + 16221.6)
    assert legend(plots.contact_forces(far, most=1)) == ["C2, peak 5 kN at 129780.80 m"]
    for status in (sj.Status.NOT_FINITE, sj.Status.DERAILED, sj.Status.PRESSED_IN, sj.Status.TOO_FEW_STEPS):
        assert legend(plots.contact_forces(trajectory(status=int(status)), most=2)) == ["C2", "B2"]
    assert "peak" in legend(plots.contact_forces(trajectory(status=int(sj.Status.INACCURATE)), most=1))[0]


@pytest.mark.parametrize("steps", among({"saved": 1.0, "over all steps": 1.1}, "over all steps"))
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


def test_every_picture_goes_into_given_axes_or_new_ones_with_a_title():
    for draw, ds in (
        (lambda ds, ax: plots.bifurcation(ds, "w_x", ax), sections(status=(0, 1, 0, 0))),
        (plots.exponents, measured(LINE)),
        (plots.regime_map, measured(GRID)),
        (plots.contact_forces, trajectory()),
    ):
        _, ax = plt.subplots()
        ds = ds.assign_attrs({"length [m]": 0.2})
        assert draw(ds, ax) is ax
        assert ax.figure.get_suptitle() == ""
        new = draw(ds, None).figure
        assert new.get_suptitle() == "$L$ = 0.2 m"
        new.canvas.draw()  # labels can be typeset


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
    upper, below, spectrum = plots.rail(dataclasses.replace(sj.paper_scene(), track=track))
    x, y = upper.lines[0].get_data()
    inside = x < 129_837.0
    x, y = x[inside], y[inside]
    assert upper.get_xlim()[0] == 129_773.0
    assert (upper.get_xlabel(), below.get_xlabel()) == ("", "distance [m]")
    assert legend(spectrum) == ["lateral", "vertical"]
    np.testing.assert_allclose(y, np.sin(x - 129_773.0), atol=5e-3)  # the spline is natural at the ends


def test_both_rails_of_a_track_are_drawn():
    left, right = sj.HarmonicTrack((8.0,), 1e-3), sj.HarmonicTrack((8.0,), 2e-3)
    mounts = [sj.Mount(0.0, y, 0.0, rail=rail) for y, rail in ((0.6, "left"), (-0.6, "right"))]
    sled = sj.Sled(mass=28.0, inertia=(10.0, 5.0, 15.0), mounts=mounts)
    track = sj.TwoRails(left, right)
    upper, below, spectrum = plots.rail(dataclasses.replace(sj.paper_scene(), slipper=sled, track=track))
    for ax, name in ((upper, "lateral"), (below, "vertical")):
        # 25 wavelengths in 4096 places come close to the crests
        np.testing.assert_allclose([line.get_ydata().max() for line in ax.lines], [1.0, 2.0], rtol=1e-3)
        assert [line.get_label() for line in ax.lines] == [f"left {name}", f"right {name}"]
        assert len({line.get_color() for line in ax.lines}) == 2
    assert legend(spectrum) == ["left lateral", "right lateral", "left vertical", "right vertical"]
    # densities go by the square of the amplitude
    densities = [line.get_ydata().max() for line in spectrum.lines]
    np.testing.assert_allclose(np.divide(densities[1::2], densities[::2]), 4.0, rtol=1e-9)


class InFeet(sj.SampledTrack):
    """A rail whose survey has its distances in feet."""

    distance_unit = "ft"


@pytest.mark.full
def test_surveys_are_drawn_over_their_own_unit_of_distance():
    scene = dataclasses.replace(sj.paper_scene(), track=InFeet(np.arange(0.0, 400.0), 0.0, 0.0))
    upper, below, _ = plots.rail(scene)
    assert upper.get_xlim() == pytest.approx((0.0, 200 / 0.3048))
    assert below.get_xlabel() == "distance [ft]"


WRONG = [
    (
        lambda ds: plots.contact_forces(sections()),
        "`ds` must be .* with `period`, but has v_y",
    ),
    (lambda ds: plots.bifurcations(ds.drop_vars("v_y")), "`ds` must be a dataset of sweep or follow, with `v_y`"),
    (lambda ds: plots.bifurcation(sections().expand_dims(mass=2), "v_y"), "`ds` must be swept over 1 parameter"),
    (lambda ds: plots.exponents(sections()), "`ds` must be a dataset of lyapunov_sweep, with `regime`"),
    (lambda ds: plots.regime_map(measured(LINE)), "`ds` must be swept over 2 parameter"),
    (lambda ds: plots.spectrum([1.0, 2.0], [1.0]), "`density` must be of the shape"),
    (lambda ds: axis_label(ds), "`name` must be the name of a quantity"),
    (lambda ds: case_title(3), "`ds` must be a dataset of a run"),
    (lambda ds: png(3, 100), "`figure` must be a figure of matplotlib"),
]


@pytest.fixture(scope="module")
def run():
    return sj.simulate(sj.paper_scene(), 3, steps_per_period=50).to_xarray()


@pytest.mark.full
@pytest.mark.parametrize(("call", "words"), WRONG, ids=[row[1] for row in WRONG])
def test_wrong_inputs_of_pictures_are_one_line(run, call, words):
    with pytest.raises(ValueError, match=f"^Argument {words}"):
        call(run)
