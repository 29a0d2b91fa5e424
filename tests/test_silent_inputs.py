"""Inputs with units, masks, durations, marks of overload and scenes of their own: each is right or refused.

None compiles a program. tests/tools/test_units.py has all kinds of units; here each place that takes them has one.
"""

import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pint
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.analysis.environment import (
    band_edges,
    envelope,
    resample,
    running_level,
)
from slipperjax.analysis.spectra import power_spectral_density
from slipperjax.fitting.measured import measured_runs
from slipperjax.flow.datasets import result_dataset, run_attributes
from slipperjax.model.parameters import PARAMETERS
from slipperjax.model.scene_files import scene_from_toml
from slipperjax.model.sensors import Rig
from slipperjax.sweeps.grid import Grid
from slipperjax.tools.checks import finite, positive

SCENE = sj.paper_scene()
RIG = Rig.of([sj.model.Sensor("front")])
Q = pint.Quantity
NAN = float("nan")
REFUSED = None
RAMP = np.arange(5.0)
RATE = "125.66370614359172 rad/s"
"""20 Hz."""


def array(values, units):
    return xr.DataArray(values, attrs={"units": units})


def masked(values):
    """Numbers with the second under the mask, which has a number of its own."""
    found = np.ma.array(np.array(values, float), mask=False)
    found[1] = np.ma.masked
    found.data[1] = -9999.0
    return found


def from_toml(table, line):
    return scene_from_toml(f'base = "paper"\n[{table}]\n{line}\n')


def table(text):
    path = Path("table.csv")
    path.write_text(text)
    return path


def sled(**more):
    return sj.model.RocketSled(**dict(time=[0.0, 1.0, 2.0], thrust=[9e4, 9e4, 0.0], mass=300.0) | more)


def load(time):
    return sj.model.TabulatedLoad(np.zeros((3, 3)), time=time).time


def modes(frequency=(10.0, 20.0), damping=(0.01, 0.01), shapes=None):
    return sj.model.Modes(frequency, damping, np.ones((2, 1, 3)) if shapes is None else shapes)


def record(value, time=None):
    times = ("time", np.arange(12) / 1e3, {"units": "s"}) if time is None else time
    return xr.Dataset({"front": value}, {"time": times})


def signal(source):
    return measured_runs(source, RIG)[0].signals[0]


MODES = "frequency [rad/s], damping, a x, a y, a z\n314.1592653589793, 0.01, 1, 1, 1\n"
PLACES = 'places = { values = [[0, 0, 0]], unit = "m" }\n'
RATES = {
    "low of a band": (lambda: band_edges(Q(125.66370614359172, "rad/s"), 2000.0)[0], 20.0),
    "low in a file": (lambda: from_toml("environment", f'{PLACES}low = "{RATE}"').environment["low"], 20.0),
    "modes": (lambda: sj.model.Modes(array([1200.0], "rpm"), [0.01], np.ones((1, 1, 3))).frequency, 20.0),
    "motion": (lambda: sj.Motion(w_x=Q(20.0, "Hz")).w_x, 40 * np.pi),
    "start in a file": (lambda: from_toml("start", 'w_z = "20 Hz"').start.w_z, 40 * np.pi),
    "sensor": (lambda: sj.model.Sensor("front", cutoff=Q(7200.0, "deg/s")).cutoff, 20.0),
    "wavenumber": (lambda: positive("wavenumber", "cycles/m")(Q([2.0], "rad/m")), 1 / np.pi),
    "wavenumber that may be either": (lambda: positive("wavenumber", "cycles/m")(Q([2.0], "1/m")), REFUSED),
    "modes in a file": (lambda: sj.model.load_modes(table(MODES)).frequency, 50.0),
}
"""Frequencies count cycles and angular rates radians."""

BEAM = dict(mass=1.0, length=4.0, stiffness=1e5)
UNDER_MASKS = {
    "survey, lateral": lambda: sj.model.SampledTrack(RAMP, masked(1e-4 * RAMP), 0.0),
    "load, time": lambda: sj.model.TabulatedLoad(np.zeros((5, 3)), time=masked(RAMP)),
    "speeds over time": lambda: sj.SpeedProgramme.over_time(RAMP, masked(RAMP + 100)),
    "mass": lambda: sled(mass=np.ma.masked),
    "grid": lambda: Grid(SCENE, {"speed": masked(RAMP + 100)}),
    "speed": lambda: sj.paper_scene(speed=np.ma.array(900.0, mask=True)),
    "modes, frequency": lambda: modes(frequency=masked([10.0, 20.0])),
    "damping of a beam": lambda: sj.model.Modes.beam([1.0], **BEAM, damping=masked([0.01] * 3)),
    "section, play": lambda: sj.Section(points=SCENE.section.points, play=masked([1e-3] * 5)),
    "list": lambda: finite("x", "m")([masked(RAMP), masked(RAMP)]),
    "quantity": lambda: finite("x", "m")(Q(masked(RAMP), "mm")),
    "array": lambda: finite("x", "m")(array(masked(RAMP), "mm")),
    "whole numbers of pandas": lambda: finite("x", "m")(pd.array([1, None], dtype="Int64")),
    "density of a record": lambda: power_spectral_density(masked(np.arange(16.0)), 100.0),
    "time of samples": lambda: resample(masked(np.arange(16.0)), np.arange(16.0), 1.0),
    "waves": lambda: sj.model.FourierTrack(masked([1.0, 2.0]), [1e-3, 1e-3], [0.0, 0.0]),
}
MASKS = {name: (call, REFUSED) for name, call in UNDER_MASKS.items()} | {
    # where numbers may be missing
    "envelope": (lambda: envelope(masked([[1.0], [5.0], [2.0]]))[1], NAN),
    "level": (lambda: running_level(masked(np.ones(16)), 100.0)[1][0], NAN),
    "record": (lambda: len(signal(record(("time", masked(np.ones(12)), {"units": "g"}))).value), 11),
}
"""What is under a mask is missing."""

STEPS = np.arange(1, 4).astype("timedelta64[m]")
SECONDS = np.array([60.0, 120.0, 180.0])
MILLISECONDS = np.arange(12).astype("timedelta64[ms]")
TWELVE = ("time", np.ones(12), {"units": "g"})
DURATIONS = {
    "times of speeds": (
        lambda: sj.SpeedProgramme.over_time(STEPS - STEPS[0], [36.0] * 3).distance,
        36 * (SECONDS - 60),
    ),
    "times of loads": (lambda: load(STEPS), SECONDS),
    "delay": (lambda: sj.model.Sensor("front", delay=STEPS[0]).delay, 60.0),
    "a list": (lambda: load(list(pd.to_timedelta([60, 120, 180], unit="s"))), SECONDS),
    "dates": (lambda: load(np.datetime64("2026-01-01") + STEPS), REFUSED),
    "no time": (lambda: load(np.array([1, "NaT", 3], "timedelta64[s]")), REFUSED),
    "a length": (lambda: sled(length=np.timedelta64(5, "s")), REFUSED),
    "a record": (lambda: signal(record(TWELVE, ("time", MILLISECONDS))).time[-1], 0.011),
    "dates of a record": (
        lambda: measured_runs(record(TWELVE, ("time", np.datetime64("2026-01-01") + MILLISECONDS)), RIG),
        REFUSED,
    ),
    "a record of durations": (lambda: measured_runs(record(("time", MILLISECONDS)), RIG), REFUSED),
}
"""Durations count in seconds, and dates have no beginning."""


def swept(speeds, clearance=1e-3, units="m/s", **more):
    """A result over speeds, as of a sweep."""
    scene = sj.paper_scene(clearance=clearance).replace(**more)
    attrs = run_attributes(scene, sj.Motion(), {"function": "sweep"}, ["speed"])
    coords = {"speed": ("speed", speeds, {"units": units})}
    return result_dataset({"status": ("speed", [0] * len(speeds))}, coords, attrs)


FIVE = np.full(5, 0.5)
UNITS = {
    "speed": (lambda: sj.paper_scene(speed=array(900.0, "km/h")).speed, 250.0),
    "speeds of a grid": (lambda: Grid(SCENE, {"speed": array([900.0], "mph")}).axes["speed"], [402.336]),
    "survey": (lambda: sj.model.SampledTrack(RAMP, array(FIVE, "in"), 0.0).lateral, 0.0127 * np.ones(5)),
    "play": (lambda: sj.Section(points=SCENE.section.points, play=array([1.0] * 5, "um")).play, [1e-6] * 5),
    "a number in percent": (lambda: sled(friction=array(0.25, "percent")).friction, 0.0025),
    "speed in kg": (lambda: sj.paper_scene(speed=array(900.0, "kg")), REFUSED),
    "a unit of nobody": (lambda: sj.paper_scene(speed=array(900.0, "furz")), REFUSED),
    "a result in km/h": (lambda: sj.load(swept([900.0, 1080.0], units="km/h")).sel(speed=900.0).scene, REFUSED),
}
"""What has a unit is converted, and another kind of unit refused."""


def clearance(ds, **more):
    return float(PARAMETERS["clearance"].of(sj.load(ds).sel(**more).scene))


ONE, SAME, OTHER = swept([1e3, 1.1e3]), swept([1.2e3, 1.3e3]), swept([1.4e3, 1.5e3], 2e-3)
BESIDE = xr.concat([ONE, swept([1e3, 1.1e3], 2e-3)], "play")
TWO = xr.concat([ONE, OTHER], "speed")
JOINED = {
    "of one scene": (lambda: clearance(xr.concat([ONE, SAME], "speed"), speed=1.2e3), 1e-3),
    "of two plays": (lambda: clearance(TWO, speed=1.4e3), REFUSED),
    "one case of two plays": (lambda: clearance(TWO.isel(speed=3)), REFUSED),
    "the first of two plays": (lambda: clearance(TWO.isel(speed=0)), 1e-3),
    "beside each other": (lambda: clearance(BESIDE, speed=1e3), REFUSED),
    "its start": (lambda: sj.load(TWO).sel(speed=1.4e3).start, REFUSED),
    # of the part that is chosen the scene is known
    "merged": (
        lambda: clearance(xr.combine_by_coords([OTHER, ONE], combine_attrs="override"), speed=1e3),
        1e-3,
    ),
    "filled up": (lambda: clearance(ONE.reindex(speed=[1e3, 1.1e3, 1.2e3]), speed=1e3), 1e-3),
}
"""A result that was joined from several scenes has none."""

OVERLOADED = {"9.9E37": 2.0, "-9.9E+37": 2.0, "1E38": 2.0, "OVL": 2.0, "inf": 2.0, "-1.#INF": 2.0}
ROWS = "".join(f"{k},{1 + k % 2}\n" for k in range(12))
OVERLOADS = {
    f"a record with {cell}": (
        lambda cell=cell: signal(table(f"time [ms], front [m/s^2]\n{ROWS}12,{cell}\n")).value.max(),
        right,
    )
    for cell, right in OVERLOADED.items()
}
OVERLOADS |= {
    "a survey": (lambda: sj.load_rail(table("distance [m], lateral [mm]\n0,0\n1,9.9E37\n2,0\n3,0\n")), REFUSED),
    "speeds": (lambda: sj.model.load_speed(table("time [s], speed [m/s]\n0,100\n1,OVL\n2,120\n")), REFUSED),
    "thrust": (
        lambda: sj.model.RocketSled.from_file(table("time [s], thrust [N]\n0,9e4\n1,9.9E37\n2,0\n"), mass=300.0),
        REFUSED,
    ),
}
"""Marks of overload are missing in records, with a word, and refused elsewhere."""

KINDS = dict(rates=RATES, masks=MASKS, durations=DURATIONS, units=UNITS, joined=JOINED, overloads=OVERLOADS)
INPUTS = [
    pytest.param(kind, *row, id=f"{kind}: {name}") for kind, rows in KINDS.items() for name, row in rows.items()
]


@pytest.mark.parametrize(("kind", "call", "exact"), INPUTS)
def test_no_input_gives_a_wrong_number_in_silence(kind, call, exact, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        if exact is REFUSED:
            with pytest.raises(ValueError, match=r"\A[^\n]{1,400}(\n[^\n]*){0,2}\Z"):
                call()
            return
        found = call()
    np.testing.assert_allclose(np.asarray(found, float), exact, rtol=1e-12)
    if kind == "overloads":
        assert any("overload" in str(one.message) for one in said)
