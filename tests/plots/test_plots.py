"""Diagrams, maps of exponents, trajectories and rails: numbers in display units, labels, colours and marks."""

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
from slipperjax.plots.style import COLORS, MOTION_COLORS, POINT_COLORS, case_title, label, shown

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
    data |= {"roll": ("time", 5e-3 * np.sin(angle)), "drive_force": ("time", 10 * angle)}
    force = np.zeros((401, 2, 3))
    force[200] = 1e3 * np.arange(6).reshape(2, 3)
    data["contact_force"] = (("time", "end", "point"), force)
    coords = {"period": ("time", period), "end": ["front", "rear"], "point": ["A", "B", "C"]}
    return xr.Dataset(data, coords, {"status": status, "steps_per_period": 200})


REGIME_NAMES = ["periodic", "regular", "chaotic", "unresolved", "chaotic", "periodic"]
EXPONENTS = np.array([-0.2, 0.0, 0.3, 0.1, 0.2, -0.1])
LINE = {"speed": np.arange(1.0, 7)}


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


def test_axes_are_labelled_with_quantity_and_display_unit_also_by_xarray():
    wanted = {
        "speed": "speed $V$ [m/s]",
        "roll_amplitude": "roll amplitude $A_R$ [degrees]",
        "start_y": "start $y$ [mm]",
        "alpha_x": r"$\alpha_X$ [rad/s$^{2}$]",
        "contact_force": "contact force $F$ [kN]",
        "case": "case",
    }
    ds = xr.Dataset({name: ("case", [1.0, 2.0]) for name in wanted})
    assert {name: label(shown(ds, name)) for name in wanted} == wanted
    (line,) = shown(ds, "start_y").plot()
    assert (line.axes.get_ylabel(), line.get_ydata()[1]) == ("start $y$ [mm]", 2e3)
    path = "contact.hysteresis"  # which has the unit of its values
    ds = sections(path)
    ds[path].attrs["units"] = "s/m"
    assert plots.bifurcation(ds, "w_x").get_xlabel() == f"{path} [s/m]"


@pytest.mark.parametrize(("over", "per"), [("clearance", 1e-3), ("roll_amplitude", np.pi / 180), ("case", 1.0)])
def test_any_parameter_is_drawn_in_its_display_unit(over, per):
    """With one dot for each crossing, and a cross instead where a case is flagged."""
    ax = plots.bifurcation(sections(over, status=(0, 1, 0, 3)), "w_x")
    (line,), (marks,) = marked(ax, "."), marked(ax, "x")
    x = np.array([0.5e-3, 1e-3, 1.5e-3, 2e-3]) / per
    assert drawn(line)[:, 0] == pytest.approx(x[[0, 2, 2, 2]])
    assert drawn(line)[:, 1] == pytest.approx([0, 20, 21, 22])
    assert ax.get_ylabel() == r"$\omega_X$ [rad/s]"
    assert drawn(marks)[:, 0] == pytest.approx(x[[1, 3]])
    assert legend(ax) == ["not trusted"]
    assert ax.get_ylim()[1] < 30  # what is left out does not stretch the axis


def test_followed_motions_and_flagged_cases_are_in_the_legend():
    way = [(0, 0, 0, 1), (0, 0, 0, 0)]
    axes = plots.bifurcations(sections(status=(2, 0, 0, 0)), followed=followed(way))
    assert legend(axes[0]) == ["followed up", "not trusted", "followed down", "from one start"]
    for ax in axes:
        up, down, start = marked(ax, ".")
        assert [len(drawn(line)) for line in (up, down, start)] == [6, 10, 9]
        assert (drawn(up)[0, 1], drawn(down)[0, 1]) == (0.25, 0.5)
        assert [drawn(line)[:, 0] for line in marked(ax, "x")] == [pytest.approx([2.0]), pytest.approx([0.5])]


def test_exponents_are_coloured_by_regime_with_three_standard_errors():
    ax = plots.exponents(measured({"clearance": np.arange(1, 7) * 1e-3}))
    assert labels(ax) == ("clearance $C$ [mm]", "largest exponent [1/period]")
    assert legend(ax) == ["periodic", "regular", "chaotic", "unresolved"]
    for name, line in zip(REGIMES, marked(ax, "oDs^v"), strict=False):
        at = np.flatnonzero(np.array(REGIME_NAMES) == name)
        assert to_hex(line.get_color()) == MOTION_COLORS[name]
        assert drawn(line) == pytest.approx(np.stack([at + 1, EXPONENTS[at]], axis=1))
    chaotic = ax.containers[2].lines[2][0].get_segments()
    assert chaotic[0][:, 1] == pytest.approx([0.3 - 0.03, 0.3 + 0.03])


def test_flagged_exponents_are_unresolved():
    exponent = np.where(np.arange(6) == 4, np.nan, EXPONENTS)
    ax = plots.exponents(measured(LINE, [0, 0, 1, 0, 1, 0], exponent))
    speeds = [drawn(line)[:, 0].tolist() for line in marked(ax, "oDs^v")]
    assert speeds == [[1, 6], [2], [3, 4]]  # periodic, regular, unresolved
    assert drawn(marked(ax, "x")[0])[:, 0].tolist() == [5]
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
    assert ax.dataLim.extents == pytest.approx([0.05, 0.5, 0.35, 2.5])
    assert drawn(marked(ax, "x")[0]) == pytest.approx(np.array([[0.1, 2.0], [0.3, 2.0]]))
    assert bar_of(ax).get_ylabel() == "largest exponent [1/period]"
    mesh.update_scalarmappable()
    colors = mesh.get_facecolors()
    assert colors[0][2] > colors[0][0]  # blue below zero
    assert colors[2][0] > colors[2][2]  # red above
    assert np.ptp(colors[1][:3]) < 0.02
    assert to_hex(colors[5]) == COLORS["grey"]


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
    # without its mean
    assert drawn(ax.lines[0])[:, 1] == pytest.approx(10.0 ** -frequency[1:41])
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


def test_rails_without_waves_are_drawn_over_distance_and_lost_motions_without_numbers():
    ds = trajectory().assign_attrs({"wavelength [m]": np.array([8.0])})
    ax = plots.contact_forces(ds.chunk(time=2), most=1)
    assert (ax.get_xlabel(), legend(ax)) == ("distance [m]", ["C2, peak 5 kN at 8.00 m"])
    assert drawn(ax.lines[1]).tolist() == [[8.0, 5.0]]
    assert legend(plots.contact_forces(trajectory(status=int(sj.Status.DERAILED)), most=2)) == ["C2", "B2"]
    assert "peak" in legend(plots.contact_forces(trajectory(status=int(sj.Status.INACCURATE)), most=1))[0]


@pytest.mark.parametrize(
    ("part", "words"),
    [
        (slice(0, 150), "C2, peak 0 kN"),
        (slice(150, 250), "C2, peak 5.5 kN at 1.001"),
        (slice(250, None), "C2, peak 0 kN"),
    ],
)
def test_peaks_of_a_part_of_a_run_are_those_of_the_part(part, words):
    """Of all steps, of which the saved one has less."""
    ds = trajectory()
    ds["peak_force"] = 1.1 * ds["contact_force"].max("time")
    ds["peak_period"] = 0 * ds["peak_force"] + 1.001
    ds = ds.isel(time=part)
    for ax in (plots.contact_forces(ds, last=None, most=1), plots.overview(ds)[5, 1]):
        assert legend(ax)[0] == words


def test_an_overview_shows_everything_and_names_a_bad_status():
    axes = plots.overview(trajectory())
    assert len({ax.get_ylabel() for ax in axes.flat}) == 12  # all coordinates, contact and drive force
    check_legend_fits(axes[5, 0])
    derailed = plots.overview(trajectory(status=2))[0, 0].figure._suptitle
    assert derailed.get_text().startswith("status: derailed")
    assert to_hex(derailed.get_color()) == COLORS["red"]


def test_titles_state_the_fixed_parameters_in_display_units():
    ds = xr.Dataset(attrs={"speed [m/s]": 1250.0, "clearance [m]": 1e-3, "length [m]": 0.2, "restitution": 0.9})
    assert case_title(ds) == "speed 1250 m/s, clearance 1 mm, length 0.2 m"
    more = {"roll_amplitude [rad]": np.radians(0.2), "wavelengths [m]": [10.0, 12.0]}
    _, second = case_title(ds.assign_attrs(more), full=True).splitlines()
    assert second == "restitution 0.9, roll amplitude 0.2°, wavelength 10 and 12 m"
    varied = xr.Dataset(coords={"speed": [1.0, 2.0]}, attrs={"clearance [m]": 2e-3})
    assert case_title(varied) == "clearance 2 mm"
    for one in (varied.isel(speed=1), varied.isel(speed=[1])):  # a grid of one value has a dimension
        assert case_title(one) == "speed 2 m/s, clearance 2 mm"


@pytest.mark.parametrize(
    ("draw", "ds"),
    [
        (lambda ds, ax: plots.bifurcation(ds, "w_x", ax), sections(status=(0, 1, 0, 0))),
        (plots.exponents, measured(LINE)),
        (plots.regime_map, measured({"clearance": [1e-3, 2e-3], "speed": [1.0, 2.0, 3.0]})),
        (plots.contact_forces, trajectory()),
    ],
)
def test_pictures_go_into_given_axes_or_new_ones_with_a_title(draw, ds):
    _, ax = plt.subplots()
    ds = ds.assign_attrs({"length [m]": 0.2})
    assert draw(ds, ax) is ax
    assert ax.figure.get_suptitle() == ""
    new = draw(ds, None).figure
    assert new.get_suptitle() == "length 0.2 m"
    new.canvas.draw()  # labels can be typeset


def test_rails_are_drawn_from_where_they_begin():
    places = np.linspace(0.0, 64.0, 257)
    track = sj.model.SampledTrack(129_773.0 + places, 1e-3 * np.sin(places), 0.0, ramp=0.0)
    upper, below, _ = plots.rail(dataclasses.replace(sj.paper_scene(), track=track))
    x, y = upper.lines[0].get_data()
    inside = x < 129_837.0
    assert upper.get_xlim()[0] == 129_773.0
    assert below.get_xlabel() == "distance [m]"
    # the spline is natural at the ends
    np.testing.assert_allclose(y[inside], np.sin(x[inside] - 129_773.0), atol=5e-3)


@pytest.mark.full
def test_the_spectrum_of_a_survey_in_feet_is_in_its_units(tmp_path):
    feet = np.arange(0.0, 660.0, 2.0)
    rows = np.column_stack([feet, 0.0 * feet, np.sin(2 * np.pi * feet / 20.0)])
    np.savetxt(tmp_path / "survey.csv", rows, "%.9f", ",", header="chainage [ft], lateral [in], vertical [in]")
    *_, spectrum = plots.rail(dataclasses.replace(sj.paper_scene(), track=sj.load_rail(tmp_path / "survey.csv")))
    wavenumber, density = spectrum.lines[1].get_data()
    assert (spectrum.get_xlabel(), spectrum.get_ylabel()) == ("wavenumber [cycles/ft]", "density [in$^{2}$ ft]")
    assert wavenumber[density.argmax()] == pytest.approx(1 / 20.0, rel=0.02)  # a bin is 0.0015 cycles/ft
    # a sine of 1 in has a mean square of 1/2 in^2
    assert density.sum() * np.diff(wavenumber)[0] == pytest.approx(0.5, rel=0.05)


def test_the_forces_of_a_run_are_drawn_at_their_places_below_its_rail():
    # a forcing period of 4 m, half a wave
    scene = dataclasses.replace(sj.paper_scene(), window=4.0)
    *above, forces, spectrum = plots.rail(scene, trajectory())
    assert [ax.get_xlim() for ax in (*above, forces)] == [(0.0, 8.0)] * 3
    for ax, name in zip(above, ("lateral", "vertical"), strict=True):
        assert (ax.get_xlabel(), ax.get_ylabel()) == ("", f"{name}\n[mm]")
        x, y = ax.lines[0].get_data()
        # measured: 2e-15
        np.testing.assert_allclose(y, np.sin(2 * np.pi * x / 8.0), rtol=0, atol=1e-12)
    assert (forces.get_xlabel(), forces.get_ylabel()) == ("distance [m]", "contact force $F$ [kN]")
    # the three highest points, which touch after one period
    assert legend(forces) == ["C2", "B2", "A2"]
    for line, force in zip(forces.lines, (5.0, 4.0, 3.0), strict=True):
        x, y = line.get_data()
        assert x[y > 0].tolist() == [4.0]
        assert y.max() == force
    # the only wave has one cycle in 8 m
    wavenumber, density = spectrum.lines[0].get_data()
    assert wavenumber[density.argmax()] == 1 / 8


def test_both_rails_of_a_track_are_drawn():
    left, right = sj.HarmonicTrack((8.0,), 1e-3), sj.HarmonicTrack((8.0,), 2e-3)
    mounts = [sj.Mount(0.0, y, 0.0, rail=rail) for y, rail in ((0.6, "left"), (-0.6, "right"))]
    sled = sj.Sled(mass=28.0, inertia=(10.0, 5.0, 15.0), mounts=mounts)
    scene = dataclasses.replace(sj.paper_scene(), slipper=sled, track=sj.model.TwoRails(left, right))
    upper, _, spectrum = plots.rail(scene)
    # 25 wavelengths in 4096 places come close to the crests
    np.testing.assert_allclose([line.get_ydata().max() for line in upper.lines], [1.0, 2.0], rtol=1e-3)
    assert legend(spectrum) == ["left lateral", "right lateral", "left vertical", "right vertical"]
    # densities go by the square of the amplitude
    densities = [line.get_ydata().max() for line in spectrum.lines]
    np.testing.assert_allclose(np.divide(densities[1::2], densities[::2]), 4.0, rtol=1e-9)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: plots.contact_forces(sections()), "`ds` must be .* with `period`, but has v_y"),
        (lambda: plots.history(trajectory(), ["y"]), "`name` must be the name of a variable"),
        (lambda: plots.bifurcation(sections().expand_dims(mass=2), "v_y"), "`ds` must be swept over 1 parameter"),
        (lambda: plots.regime_map(measured(LINE)), "`ds` must be swept over 2 parameter"),
        (lambda: plots.spectrum([1.0, 2.0], [1.0]), "`density` must be of the shape"),
    ],
)
def test_wrong_inputs_of_pictures_are_one_line(call, words):
    with pytest.raises(ValueError, match=f"^Argument {words}"):
        call()
