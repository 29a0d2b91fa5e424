"""What the model leaves out, by its effect on the peak force: tables and picture of docs/lab/applicability.md.

    pytest -m slow -s tests/studies/test_applicability.py

Peak forces are the highest contact forces over 400 m of rail, of many starts on the paper's sine, or on many random
rails. An effect compares the medians of two such ensembles; its error is by the bootstrap over their members, so that
chaos, which gives each member another value, is no effect.
"""

import contextlib
import dataclasses
import functools
import io
import re
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
import xarray as xr
from scipy import stats

import slipperjax as sj
from slipperjax.plots.style import COLORS, png, styled
from slipperjax.sweeps.grid import Grid
from slipperjax.tools.files import table_lines

from ..common import MOTION

PAGE = Path(__file__).parents[2] / "docs" / "lab" / "applicability.md"
MEMBERS = 256
CHUNK = 64
"""Members in a call, so that each kind of scene is compiled once."""
PERIODS, PERIOD = 50, 8.0
"""Forcing periods in which the highest force is looked for, and their length [m]."""
G = 9.81
SLED_RAIL = sj.RandomTrack.sled(length=900.0)


@dataclasses.dataclass(frozen=True)
class Ensemble:
    """A scene, and how many motions of it are made."""

    scene: sj.Scene
    transient: int  # forcing periods before the highest force is looked for

    def grid(self, scene, count):
        if isinstance(scene.track, sj.RandomTrack):
            return {"track.seed": np.arange(count)}
        return sj.sweeps.sample_box(MOTION, count)

    def sweep(self, scene, count, **options):
        options = (
            dict(transient=self.transient, periods=PERIODS, record=["peak_force", "penetration"], chunk=CHUNK)
            | options
        )
        return sj.sweep(scene, self.grid(scene, count), product=False, **options)

    def peaks(self, change=lambda scene: scene, count=MEMBERS, **options):
        """The highest force of each member [N]."""
        return highest(self.sweep(change(self.scene), count, **options))

    def accelerated(self, acceleration, count=MEMBERS):
        """The same where the sled passes its speed in the middle of the way at an acceleration [m/s^2]."""
        before, way = PERIOD * self.transient, PERIOD * PERIODS
        first = np.sqrt(float(self.scene.speed) ** 2 - acceleration * way)
        speed = sj.SpeedProgramme.stages(
            [sj.Stage(0.0, length=before), sj.Stage(acceleration, length=way)], start=first
        )
        options = dict(length=before + way, window=PERIOD, record=["peak_force"], product=False, chunk=CHUNK)
        # as the sweeps that it stands beside
        options["start"] = sj.table_2_start()
        ds = sj.run(self.scene, self.grid(self.scene, count), speed=speed, **options)
        return highest(ds.isel(distance=slice(self.transient, None)))


def highest(ds):
    """The highest force of each member [N], infinite where the slipper is lost."""
    force = ds["peak_force"].max([name for name in ds["peak_force"].dims if name != "case"])
    return np.where(ds["status"].isin([1, 2]), np.inf, force)


def on_sled_rail(speed):
    return Ensemble(dataclasses.replace(sj.paper_scene(speed), track=SLED_RAIL), 5)


ENSEMBLES = {
    "sine, 1250 m/s": Ensemble(sj.paper_scene(1250.0), 100),
    "sine, 1750 m/s": Ensemble(sj.paper_scene(1750.0), 100),
    "sine, 2300 m/s": Ensemble(sj.paper_scene(2300.0), 100),
    "sled rail, 1000 m/s": on_sled_rail(1000.0),
    "sled rail, 2000 m/s": on_sled_rail(2000.0),
}


class Straight(sj.model.Flores):
    """A force in proportion to the penetration, equal to Hertz's at 4 mm."""

    def force(self, gap, rate, rate_ratio):
        return super().force(gap, rate, rate_ratio) * np.sqrt(4e-3) / (abs(gap) + 1e-12) ** 0.5


def with_part(**parts):
    return lambda scene: dataclasses.replace(scene, **parts)


def with_number(**numbers):
    return lambda scene: scene.replace(**{name.replace("__", "."): value for name, value in numbers.items()})


def with_other_memory(restitution):
    """The damping's memory that rails have for sines, and that sines have for rails."""
    of_rails = lambda scene: isinstance(scene.contact_memory, sj.model.PeakRateLatch)
    memory = lambda scene: sj.model.EventLatch() if of_rails(scene) else sj.model.PeakRateLatch()
    return lambda scene: dataclasses.replace(scene, memory=memory(scene)).replace(restitution=restitution)


def with_law(law, **options):
    return lambda scene: dataclasses.replace(scene, contact=law(1e8, 0.9, **options))


def with_more_points(scene):
    """Four points on each face in place of two, each half as stiff."""
    points, faces, play = {}, [], []
    for face, gap in zip(scene.section.faces, scene.section.play, strict=True):
        first, last = (scene.section.points[scene.section.names.index(corner)] for corner in face)
        for part, shares in enumerate(((0, 1 / 3), (2 / 3, 1))):
            pair = tuple(f"{''.join(face)}{2 * part + k}" for k in range(2))
            points |= {name: first + share * (last - first) for name, share in zip(pair, shares, strict=True)}
            faces.append(pair)
            play.append(gap)
    section = sj.Section(np.array(list(points.values())), np.array(play), tuple(points), tuple(faces))
    return dataclasses.replace(scene, section=section).replace(stiffness=scene.contact.stiffness / 2)


def quarter_wave(scene):
    """The sine with its vertical displacement a quarter of a wave behind the lateral one."""
    track = scene.track
    size, roll = track.amplitude[None], track.roll_amplitude[None]
    phase = np.array([-np.pi / 2])
    return dataclasses.replace(scene, track=sj.model.FourierTrack((PERIOD,), size, size, roll, vertical_phase=phase))


def random_rail(scene):
    """A random rail with the sine's root mean square in place of it."""
    rms = float(scene.track.amplitude) / np.sqrt(2)
    rail = dataclasses.replace(SLED_RAIL, length=2000.0)
    return dataclasses.replace(scene, track=dataclasses.replace(rail, roughness=rms / float(rail.rms().vertical)))


def of_sine(change):
    return lambda scene: change(scene) if isinstance(scene.track, sj.HarmonicTrack) else None


SLED = dict(mass=100.0, stiffness=[2e6, 8e6], damping=[2e3, 8e3])
CHANGES = {
    "loads and travel": {
        "none: as many other members": None,
        "gravity": with_number(gravity=G),
        "1 kN down on the slipper, with gravity": with_part(
            gravity=G, load=sj.model.AppliedLoad(force=[0.0, 0.0, -1e3])
        ),
        "100 kg of sled on springs, with gravity": with_part(gravity=G, payload=sj.model.Payload(**SLED)),
        "friction 0.1": with_part(friction=sj.model.Coulomb(0.1)),
        "friction 0.3": with_part(friction=sj.model.Coulomb(0.3)),
        "friction 0.3 that fades from 100 kW on": with_part(friction=sj.model.FadingFriction(0.3, 1e5, 0.5)),
        "accelerated by 1 g": 1.0,
        "accelerated by 10 g": 10.0,
        "accelerated by 100 g": 100.0,
    },
    "stiffness": {
        "stiffness 3e8": with_number(stiffness=3e8),
        "stiffness 1e9": with_number(stiffness=1e9),
        "stiffness 1e10": with_number(stiffness=1e10),
        "stiffness 5e10, steel": with_number(stiffness=5e10),
        "exponent 1, equal at 4 mm": with_law(Straight),
    },
    "points, restitution, damping": {
        "four points on each face, half as stiff; of one": with_more_points,
        "restitution 0.95": with_number(restitution=0.95),
        "restitution 0.8": with_number(restitution=0.8),
        "restitution 0.5": with_number(restitution=0.5),
        "restitution 0.3": with_number(restitution=0.3),
        "restitution 0.3, four times the steps": (with_number(restitution=0.3), 4),
        "the other memory": with_other_memory(0.9),
        "the other memory, restitution 0.5": with_other_memory(0.5),
        "the other memory, restitution 0.3": with_other_memory(0.3),
        "Hunt and Crossley": with_law(sj.model.HuntCrossley),
        "contacts that may pull": with_law(sj.model.Flores, clamp=False),
    },
    "play, rail and steps": {
        "play worn from 1 to 1.1 mm": with_number(clearance=1.1e-3),
        "play worn to 1.5 mm": with_number(clearance=1.5e-3),
        "play worn to 2 mm": with_number(clearance=2e-3),
        "rail without roll": of_sine(with_number(roll_amplitude=0.0)),
        "vertical a quarter wave behind lateral": of_sine(quarter_wave),
        "sled rail of the same RMS": of_sine(random_rail),
        "four times the steps": (with_part(), 4),
    },
}
"""What is changed, one at a time: a function of the scene, with a multiple of the steps, or an acceleration [g]."""


def changed(ensemble, change, count=MEMBERS):
    """The highest forces after a change [N]; None where it does not apply."""
    if change is None:
        return ensemble.peaks(count=2 * count)[count:]
    if isinstance(change, float):
        return ensemble.accelerated(change * G, count)
    if isinstance(change, tuple):
        change, times = change
        steps = times * sj.model.default_steps_per_period(change(ensemble.scene))
        return ensemble.peaks(change, count, steps_per_period=steps)
    return None if change(ensemble.scene) is None else ensemble.peaks(change, count)


def effect(before, after, share=0.5):
    """The relative change of a quantile, and twice its standard error."""
    ratio = lambda a, b, axis: np.quantile(a, share, axis=axis) / np.quantile(b, share, axis=axis) - 1
    found = stats.bootstrap((after, before), ratio, n_resamples=400, method="percentile", rng=0)
    return ratio(after, before, -1), 2 * found.standard_error


def percent(before, after, share=0.5):
    if after is None:
        return ""
    value, error = effect(before, after, share)
    return f"{100 * value:+.0f} ± {100 * error:.0f}"


def test_effects_have_errors():
    """Of two samples of one distribution, and of one with a known shift; twice the error is passed once in twenty."""
    rng = np.random.default_rng(0)
    pairs = [effect(*rng.lognormal(0.0, 0.3, (2, 128))) for _ in range(40)]
    assert np.mean([abs(value) > error for value, error in pairs]) <= 0.15  # measured 0.075
    value, error = effect(rng.lognormal(0.0, 0.3, 512), rng.lognormal(np.log(1.5), 0.3, 512))
    assert abs(value - 0.5) < error < 0.15
    assert percent(np.full(8, 2.0), np.full(8, 2.5)) == "+25 ± 0"


def test_the_page_shows_every_row():
    rows = set(re.findall(r"^\| (.*?) \|", PAGE.read_text(), re.M))
    assert {*ENSEMBLES, *(label for group in CHANGES.values() for label in group)} <= rows


@functools.cache
def reference(name):
    """The highest forces of an ensemble, and the greatest penetration of the member with the highest of all [m]."""
    ds = ENSEMBLES[name].sweep(ENSEMBLES[name].scene, MEMBERS)
    peaks = highest(ds)
    return peaks, float(ds["penetration"].max(("end", "point"))[np.argmax(peaks)])


@pytest.mark.slow
def test_the_reference():
    rows = []
    for name in ENSEMBLES:
        peaks, depth = reference(name)
        median, tail, most = (f"{np.quantile(peaks, share) / 1e3:.1f}" for share in (0.5, 0.95, 1.0))
        rows.append({"ensemble": name, "median [kN]": median, "95 % [kN]": tail, "highest [kN]": most})
        rows[-1]["its penetration [mm]"] = f"{1e3 * depth:.1f}"
    print("\n" + "\n".join(table_lines(rows)))
    assert reference("sine, 1250 m/s")[0].min() > 1e8 * 1e-3**1.5  # deeper than the play


@pytest.mark.slow
@pytest.mark.parametrize("group", CHANGES)
def test_effects_of_what_is_left_out(group):
    """Other members of the same ensemble are no effect; stiffness is one."""
    tail, rows = "sled rail, 1000 m/s", []
    for label, change in CHANGES[group].items():
        after = {name: changed(ensemble, change) for name, ensemble in ENSEMBLES.items()}
        cells = {name: percent(reference(name)[0], after[name]) for name in ENSEMBLES}
        of_tail = percent(reference(tail)[0], after[tail], 0.95)
        rows.append({"change": label, **cells, f"95 % of {tail}": of_tail})
        print("\n".join(table_lines(rows)[0 if len(rows) == 1 else -1 :]), flush=True)
        value, error = effect(reference(tail)[0], after[tail]) if after[tail] is not None else (0.0, 0.0)
        assert not label.startswith("none") or abs(value) <= 2 * error
        assert not label.startswith("stiffness 1e10") or value > 2 * error


@pytest.mark.slow
def test_speeds_that_pass_the_jumps():
    """The second table: the highest force between 1600 and 2400 m/s, at constant speeds and accelerated."""
    count, scene, speeds = 64, sj.paper_scene(1600.0), np.arange(1600.0, 2401.0, 10.0)
    starts = sj.sweeps.sample_box(MOTION, count)
    ensemble, rows = Ensemble(scene, 100), []

    def row(label, forces, places):
        low, middle, high = (f"{np.quantile(forces, q) / 1e3:.0f}" for q in (0.05, 0.5, 0.95))
        rows.append({"speed": label, "median [kN]": middle, "5 to 95 % [kN]": f"{low} to {high}"})
        rows[-1]["at, median [m/s]"] = f"{np.median(places):.0f}"

    grid = {name: np.tile(values, len(speeds)) for name, values in starts.items()} | {
        "speed": np.repeat(speeds, count)
    }
    options = dict(product=False, transient=100, periods=PERIODS, record=["peak_force", "penetration"], chunk=CHUNK)
    peaks = highest(sj.sweep(ensemble.scene, grid, **options)).reshape(len(speeds), count)
    row("constant, 81 speeds of 400 m each", peaks.max(axis=0), speeds[peaks.argmax(axis=0)])
    for acceleration in (1.0, 10.0, 100.0):
        way = (speeds[-1] ** 2 - speeds[0] ** 2) / (2 * acceleration * G)
        stages = [sj.Stage(0.0, length=800.0), sj.Stage(acceleration * G, speed=speeds[-1])]
        speed = sj.SpeedProgramme.stages(stages, start=speeds[0])
        options = dict(window=PERIOD, record=["peak_force"], start=sj.table_2_start(), product=False, chunk=CHUNK)
        ds = sj.run(scene, starts, length=PERIOD * (100 + int(way / PERIOD)), speed=speed, **options)
        force = ds["peak_force"].isel(distance=slice(100, None)).max(("end", "point")).transpose("case", "distance")
        passed = np.sqrt(speeds[0] ** 2 + 2 * acceleration * G * (force["distance"].values - 800.0))
        row(
            f"rising by {acceleration:g} g, over {way / 1e3:.2g} km",
            force.values.max(1),
            passed[force.values.argmax(1)],
        )
    print("\n" + "\n".join(table_lines(rows)))
    assert len(rows) == 4


def test_estimates_of_what_is_not_computed():
    """The third table: closed forms for the rail, the contacts and the slipper as elastic bodies of steel."""
    young, poisson, density = 210e9, 0.3, 7850.0
    rows = []

    def row(what, formula, value, unit):
        rows.append({"what": what, "how": formula, "estimate": f"{value:.2g} {unit}"})
        return value

    modulus = row("modulus E' of two bodies of steel", "E / 2 (1 - nu^2)", young / (1 - poisson**2) / 2 / 1e9, "GPa")
    for radius in (0.01, 0.1, 1.0):
        stiff = row(
            f"their stiffness, radius {radius:g} m", "4/3 E' R^(1/2)", 4e9 / 3 * modulus * radius**0.5, "N/m^1.5"
        )
        assert 1e10 < stiff < 2e11
    row("E' that makes the paper's 1e8, radius 0.1 m", "3/4 K R^(-1/2)", 0.75 * 1e8 / 0.1**0.5 / 1e9, "GPa")
    # crane rail of 171 lb/yd: second moment of area [m^4], mass [kg/m]; supports [m] on fasteners [N/m]
    inertia, mass, span, fastener = 3.06e-5, 85.0, 1.32, 1.5e9
    bending, bed = young * inertia, fastener / span
    between = row("stiffness of the rail between two supports", "192 E I / l^3", 192 * bending / span**3, "N/m")
    row("the same on a continuous bed k", "2 k (4 E I / k)^(1/4)", 2 * bed * (4 * bending / bed) ** 0.25, "N/m")
    scene, force = sj.paper_scene(1250.0), 3e4
    for stiffness in (1e8, 5e10):
        of, depth = f"stiffness {stiffness:g}", (force / stiffness) ** (2 / 3)
        row(f"penetration at 100 kN, {of}", "(F / K)^(2/3)", 1e3 * (1e5 / stiffness) ** (2 / 3), "mm")
        row(f"penetration at 30 kN, {of}", "(F / K)^(2/3)", 1e3 * depth, "mm")
        tangent = row(f"tangent stiffness there, {of}", "3/2 K d^(1/2)", 1.5 * stiffness * depth**0.5, "N/m")
        row(
            f"typical impact, {of}",
            "`contact_duration`",
            1e3 * float(sj.model.contact_duration(scene.replace(stiffness=stiffness))),
            "ms",
        )
    # the rail gives more than contacts of steel
    assert tangent > between
    outrun = (4 * bed * bending / mass**2) ** 0.25
    row("speed at which a load outruns the rail's waves", "(4 k E I / m^2)^(1/4)", outrun, "m/s")
    assert 1000 < outrun < 2000
    wave = 22.4 / (2 * np.pi * 0.2**2) * 0.03 * np.sqrt(young / density / 12)
    row("first bending of a shoe, 0.2 m long and 30 mm thick", "3.56 (E I / rho A)^(1/2) / L^2", wave / 1e3, "kHz")
    row("heat of friction, 0.1 at 10 kN and 1250 m/s", "mu N V", 0.1 * 1e4 * 1250 / 1e6, "MW")
    print("\n" + "\n".join(table_lines(rows)))


def recipe(draws):
    """The page's code about uncertain inputs, with so many draws."""
    pages = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S)
    return next(code for code in pages if "sobol_indices" in code).replace("draws = 16", f"draws = {draws}")


def test_the_recipe_finds_which_input_matters(monkeypatch, tmp_path):
    """With forces of a known share from each input in place of a sweep."""
    made = []

    def made_up(scene, grid, *, product, transient, periods, record, chunk):
        Grid(scene, grid, product=product)  # whose names and values are allowed
        share = np.log(grid["stiffness"] / 1e8) / np.log(10)
        made.append((len(share), transient, periods, record))
        little = sum(0.1 * grid[name] / of.mean() for name, of in names["box"].items())
        force = np.exp(2 * share + grid["restitution"] / 0.25 + little)
        return xr.Dataset({"peak_force": (("case", "end", "point"), force[:, None, None])})

    monkeypatch.setattr(sj, "sweep", made_up)
    names = {}
    with contextlib.redirect_stdout(io.StringIO()) as text:
        exec(recipe(256), names)
    assert {count for count, *_ in made} == {256, 512, 256 * len(names["box"])}
    exact = np.array([0.8 if n == "stiffness" else 0.2 if n == "restitution" else 0.0 for n in names["box"]])
    for found in (names["found"].first_order, names["found"].total_order):
        assert np.allclose(found, exact, atol=0.03)  # measured 0.024, of 256 draws and of the other inputs
    assert names["forces"].shape == (512,)
    assert "stiffness" in text.getvalue()
    report_uncertain(names, tmp_path / "uncertain.png")
    assert (tmp_path / "uncertain.png").stat().st_size > 10_000


@pytest.mark.slow
def test_uncertain_inputs(tmp_path):
    """The last table, and the picture."""
    names = {}
    exec(recipe(1024), names)
    path = tmp_path / "uncertain.png"
    found = report_uncertain(names, path)
    print(path)
    assert found["stiffness"] == max(found.values())


def report_uncertain(names, path):
    """Prints the forces and indices that the recipe's names hold, and draws them; gives the total indices."""
    forces, found, box = names["forces"], names["found"], list(names["box"])
    kilo = forces / 1e3
    tail = [f"{share:g} %: {np.quantile(kilo, share / 100):.1f}" for share in (5, 50, 95, 99)]
    print(
        f"\n{len(forces)} cases, peak force [kN]: mean {kilo.mean():.1f}, {', '.join(tail)}, highest {kilo.max():.1f}"
    )
    ranges = found.bootstrap()
    indices = {"first": (found.first_order, ranges.first_order), "total": (found.total_order, ranges.total_order)}
    rows = []
    for k, name in enumerate(box):
        cells = {}
        for which, (value, drawn) in indices.items():
            low, high = drawn.confidence_interval.low[k], drawn.confidence_interval.high[k]
            cells[f"{which}-order index"] = f"{value[k]:.2f} ({low:.2f} to {high:.2f})"
        rows.append({"input": name, **cells})
    print("\n" + "\n".join(table_lines(rows)))
    with styled():
        figure, (left, right) = plt.subplots(1, 2, figsize=(7.2, 2.8), layout="constrained")
        left.hist(kilo, np.geomspace(kilo.min(), kilo.max(), 60), color=COLORS["blue"])
        for share, color in ((50, "green"), (95, "orange"), (99, "red")):
            at = np.quantile(kilo, share / 100)
            left.axvline(at, color=COLORS[color], label=f"{share} %: {at:.0f} kN")
        left.set(xscale="log", xlabel="highest contact force over 400 m [kN]", ylabel=f"cases of {len(kilo)}")
        left.xaxis.set_minor_formatter("")
        ticks = [tick for tick in (1, 2, 5, 10, 20, 50, 100, 200, 500) if kilo.min() < tick < kilo.max()]
        left.set_xticks(ticks, [str(tick) for tick in ticks])
        left.legend(fontsize=7)
        for k, (which, (value, drawn)) in enumerate(indices.items()):
            ends = drawn.confidence_interval
            error = np.abs([value - ends.low, ends.high - value])
            color = COLORS["grey" if which == "total" else "blue"]
            right.barh(
                np.arange(len(box)) + 0.4 * k - 0.2,
                value,
                0.36,
                xerr=error,
                color=color,
                label=f"{which} order",
                ecolor="black",
            )
        right.set_yticks(range(len(box)), box)
        right.invert_yaxis()
        right.set(xlabel="share of the variance of the force's logarithm")
        right.legend(fontsize=7)
    path.write_bytes(png(figure, 150))
    return dict(zip(box, found.total_order, strict=True))
