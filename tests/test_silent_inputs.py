"""Inputs with units, masks, durations, marks of overload and scales of their own: each is right or refused.

None compiles a program. `python tests/test_silent_inputs.py` counts those that are wrong.
"""

import datetime
import math
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pint
import pytest
import scipy.signal
import xarray as xr

import slipperjax as sj
from slipperjax.analysis.environment import (
    band_edges,
    envelope,
    oscillator_response,
    resample,
    running_level,
    shock_response_spectrum,
    window_densities,
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
RIG = Rig.of([sj.Sensor("front")])
Q = pint.Quantity
G = 9.80665
NAN = float("nan")
TAU = math.tau


class Given(NamedTuple):
    """An input: what is called with a folder for files, and what is right."""

    kind: str
    text: str
    call: Callable[[Path], Any]
    exact: Any
    """Numbers; None where a refusal is right."""
    rtol: float = 1e-12
    warns: str = ""
    """Words of a warning that must come."""


def array(values: Any, units: str) -> xr.DataArray:
    return xr.DataArray(values, attrs={"units": units})


def series(values: Any, units: str) -> pd.Series:
    found = pd.Series(values)
    found.attrs["units"] = units
    return found


def masked(values: Any, k: int = 1) -> np.ma.MaskedArray:
    """Numbers with the k-th under the mask, which has a number of its own."""
    found = np.ma.array(np.asarray(values, float), mask=False)
    found[k] = np.ma.masked
    found.data[k] = -9999.0
    return found


def of(name: str, text: str) -> float:
    """A number of a table of a scene's file."""
    head, _, key = name.rpartition(".")
    found = scene_from_toml(f'base = "paper"\n[{head}]\n{key} = "{text}"\n')
    return float(getattr(found.start, key))


def environment_file(key: str, text: str) -> float:
    places = 'places = { values = [[0, 0, 0]], unit = "m" }'
    return scene_from_toml(f'base = "paper"\n[environment]\n{places}\n{key} = "{text}"\n').environment[key]


def written(folder: Path, text: str) -> Path:
    path = folder / "table.csv"
    path.write_text(text)
    return path


def sled(**more: Any) -> sj.RocketSled:
    return sj.RocketSled(**dict(time=[0.0, 1.0, 2.0], thrust=[9e4, 9e4, 0.0], mass=300.0) | more)


def rates() -> Iterator[Given]:
    """Frequencies count cycles and angular rates radians."""
    ways = {
        "125.66370614359172 rad/s": 20.0,
        "0.12566370614359172 rad/ms": 20.0,
        "1200 rpm": 20.0,
        "7200 deg/s": 20.0,
        "20 Hz": 20.0,
        "0.02 kHz": 20.0,
        "20 1/s": 20.0,
        "20 cycle/s": 20.0,
        "1200 revolution/minute": 20.0,
        "1200 cycle/min": 20.0,
    }
    for text, hertz in ways.items():
        value, _, unit = text.partition(" ")
        quantity = Q(float(value), unit)
        yield Given("A10", f"low of a band, {text}", lambda _, q=quantity: band_edges(q, 2000.0)[0], hertz)
        yield Given("A10", f"[environment] low, {text}", lambda _, t=text: environment_file("low", t), hertz)
        yield Given(
            "A10",
            f"frequency of modes, {text}",
            lambda _, v=value, u=unit: sj.Modes(array([float(v)], u), [0.01], np.ones((1, 1, 3))).frequency,
            hertz,
        )
        # 1/s counts radians where a rate of turning is meant
        exact = 20.0 if unit == "1/s" else TAU * hertz
        yield Given("A10", f"w_x, {text}", lambda _, q=quantity: sj.Motion(w_x=q).w_x, exact)
        yield Given("A10", f"[start] w_z, {text}", lambda _, t=text: of("start.w_z", t), exact)
        yield Given(
            "A10",
            f"cutoff of a sensor, {text}",
            lambda _, q=quantity: sj.Sensor("front", cutoff=q).cutoff,
            hertz,
        )
    for unit, exact in (("rad/m", 2 / TAU), ("cycle/m", 2.0), ("1/m", None), ("deg/m", 2 / 360), ("kg/m", None)):
        call = lambda _, u=unit: positive("wavenumber", "cycles/m")(Q([2.0], u))
        yield Given("A10", f"wavenumber, {unit}", call, exact)
    for unit in ("m", "s", "rad", "m/s"):
        yield Given("A10", f"low in {unit}", lambda _, u=unit: band_edges(Q(20.0, u), 2000.0), None)
    table = "frequency [rad/s], damping, a x, a y, a z\n314.1592653589793, 0.01, 1, 1, 1\n"
    yield Given("A10", "modes in rad/s in a file", lambda p: sj.load_modes(written(p, table)).frequency, 50.0)


def masks() -> Iterator[Given]:
    """What is under a mask is missing."""
    ramp = np.arange(5.0)
    calls: dict[str, Callable[[], Any]] = {
        "survey, distance": lambda: sj.SampledTrack(masked(ramp), np.zeros(5), 0.0),
        "survey, lateral": lambda: sj.SampledTrack(ramp, masked(1e-4 * ramp), 0.0),
        "survey, vertical": lambda: sj.SampledTrack(ramp, 0.0, masked(1e-4 * ramp)),
        "survey, roll": lambda: sj.SampledTrack(ramp, 0.0, np.zeros(5), masked(1e-4 * ramp)),
        "load, force": lambda: sj.TabulatedLoad(np.ma.masked_less([[1, 0, 0], [-1, 0, 0]], 0), time=[0.0, 1.0]),
        "load, time": lambda: sj.TabulatedLoad(np.zeros((5, 3)), time=masked(ramp)),
        "load, moment": lambda: sj.TabulatedLoad(
            np.zeros((2, 3)), np.ma.masked_less([[1, 0, 0], [-1, 0, 0]], 0), time=[0.0, 1.0]
        ),
        "speeds over time": lambda: sj.SpeedProgramme.over_time(ramp, masked(ramp + 100)),
        "speeds, times": lambda: sj.SpeedProgramme.over_time(masked(ramp), ramp + 100),
        "speeds over distance": lambda: sj.SpeedProgramme(ramp, masked(ramp + 100)),
        "thrust": lambda: sled(thrust=masked([9e4, 9e4, 0.0])),
        "mass": lambda: sled(mass=np.ma.masked),
        "grid": lambda: Grid(SCENE, {"speed": masked(ramp + 100)}),
        "speed": lambda: sj.paper_scene(speed=np.ma.masked),
        "speed of a record": lambda: sj.paper_scene(speed=np.ma.array(900.0, mask=True)),
        "modes, frequency": lambda: sj.Modes(masked([10.0, 20.0]), [0.01, 0.01], np.ones((2, 1, 3))),
        "modes, damping": lambda: sj.Modes([10.0, 20.0], masked([0.01, 0.01]), np.ones((2, 1, 3))),
        "modes, shapes": lambda: sj.Modes([10.0, 20.0], [0.01, 0.01], masked(np.ones((2, 1, 3)))),
        "damping of a beam": lambda: sj.Modes.beam(
            [1.0], mass=1.0, length=4.0, stiffness=1e5, damping=masked([0.01] * 3)
        ),
        "section, play": lambda: sj.Section(points=SCENE.section.points, play=masked([1e-3] * 5)),
        "section, points": lambda: sj.Section(points=masked(SCENE.section.points), play=[1e-3] * 5),
        "list of masked": lambda: finite("x", "m")([masked(ramp), masked(ramp)]),
        "quantity of masked": lambda: finite("x", "m")(Q(masked(ramp), "mm")),
        "array of masked": lambda: finite("x", "m")(array(masked(ramp), "mm")),
        "density of a record": lambda: power_spectral_density(masked(np.arange(16.0)), 100.0),
        "densities of windows": lambda: window_densities(masked(np.arange(64.0)), 100.0, np.array([10.0, 20.0])),
        "whole numbers of pandas": lambda: finite("x", "m")(pd.array([1, None], dtype="Int64")),
        "time of samples": lambda: resample(masked(np.arange(16.0)), np.arange(16.0), 1.0),
        "waves": lambda: sj.FourierTrack(masked([1.0, 2.0]), [1e-3, 1e-3], [0.0, 0.0]),
        "place of a sensor": lambda: sj.Sensor("front", place=masked([0.0, 0.0, 0.0])),
    }
    for text, call in calls.items():
        yield Given("A13", text, lambda _, call=call: call(), None)
    # where numbers may be missing
    yield Given("A13", "envelope", lambda _: envelope(masked([[1.0], [5.0], [2.0]]))[1], NAN)
    yield Given("A13", "oscillator", lambda _: oscillator_response(masked(np.ones(16)), 100.0, 5.0)[-1], NAN)
    yield Given("A13", "level", lambda _: running_level(masked(np.ones(16)), 100.0)[1][0], NAN)
    record = xr.Dataset({"front": ("time", masked(np.ones(12)), {"units": "g"})}, {"time": (np.arange(12) / 1e3)})
    record["time"].attrs["units"] = "s"
    yield Given("A13", "a record", lambda _: len(measured_runs(record, RIG)[0].signals[0].value), 11)


def durations() -> Iterator[Given]:
    """Durations count in seconds, and dates have no beginning."""
    for unit, size in (("ns", 1e-9), ("us", 1e-6), ("ms", 1e-3), ("s", 1.0), ("m", 60.0), ("h", 3600.0)):
        steps = np.arange(1, 4).astype(f"timedelta64[{unit}]")
        exact = size * np.arange(1, 4)
        over = lambda _, t=steps: sj.SpeedProgramme.over_time(t - t[0], [36.0] * 3).distance
        yield Given("A14", f"times of speeds in {unit}", over, 36 * (exact - exact[0]), 1e-9)
        load = lambda _, t=steps: sj.TabulatedLoad(np.zeros((3, 3)), time=t).time
        yield Given("A14", f"times of loads in {unit}", load, exact)
        yield Given("A14", f"times of thrust in {unit}", lambda _, t=steps: sled(time=t).time, exact)
        delay = lambda _, t=steps: sj.Sensor("front", delay=t[0]).delay
        yield Given("A14", f"delay in {unit}", delay, size)
    three = pd.to_timedelta([1, 2, 3], unit="s")
    for text, given in {
        "index of pandas": three,
        "series of pandas": pd.Series(three),
        "array of xarray": xr.DataArray(np.asarray(three)),
        "array of xarray with s": array(np.asarray(three), "s"),
        "array of xarray with ns": array(np.asarray(three), "ns"),
        "list of Python's": [datetime.timedelta(seconds=k) for k in (1, 2, 3)],
        "list of pandas'": list(three),
        "list of NumPy's": list(np.asarray(three)),
    }.items():
        yield Given("A14", text, lambda _, t=given: sj.TabulatedLoad(np.zeros((3, 3)), time=t).time, [1.0, 2.0, 3.0])
    dates = np.datetime64("2026-01-01") + np.asarray(three)
    for text, given in {
        "dates": dates,
        "dates of pandas": pd.DatetimeIndex(dates),
        "dates of xarray": xr.DataArray(dates),
        "a list of dates": [datetime.datetime(2026, 1, k) for k in (1, 2, 3)],
        "no time": np.array([1, "NaT", 3], "timedelta64[s]"),
    }.items():
        yield Given("A14", text, lambda _, t=given: sj.TabulatedLoad(np.zeros((3, 3)), time=t), None)
    yield Given("A14", "length in seconds", lambda _: sled(length=np.timedelta64(5, "s")), None)
    for unit in ("", "s"):
        times = xr.Variable("time", np.arange(12).astype("timedelta64[ms]"), {"units": unit} if unit else {})
        record = xr.Dataset({"front": ("time", np.ones(12), {"units": "g"})}, {"time": times})
        call = lambda _, ds=record: measured_runs(ds, RIG)[0].signals[0].time[-1]
        yield Given("A14", f"times of a record, {unit!r}", call, 0.011)
    late = record.assign_coords(time=dates[0] + np.arange(12).astype("timedelta64[ms]"))
    yield Given("A14", "dates of a record", lambda _: measured_runs(late, RIG), None)
    lasting = xr.Dataset({"front": ("time", np.arange(12).astype("timedelta64[s]"))}, record.coords)
    yield Given("A14", "a record of durations", lambda _: measured_runs(lasting, RIG), None)


def units() -> Iterator[Given]:
    """What has a unit is converted, and another kind of unit refused."""
    speeds = {"km/h": 1 / 3.6, "ft/s": 0.3048, "m s-1": 1.0, "m.s-1": 1.0, "mph": 0.44704, "knot": 1852 / 3600}
    speeds |= {"cm/s": 0.01, "km s^-1": 1000.0}
    for unit, factor in speeds.items():
        call = lambda _, u=unit: sj.paper_scene(speed=array(900.0, u)).speed
        yield Given("A15", f"speed in {unit}", call, 900 * factor)
        yield Given(
            "A15",
            f"speeds of a grid in {unit}",
            lambda _, u=unit: Grid(SCENE, {"speed": array([900.0, 950.0], u)}).axes["speed"],
            [900 * factor, 950 * factor],
        )
    lengths = {"mm": 1e-3, "in": 0.0254, "ft": 0.3048, "um": 1e-6, "US_survey_foot": 1200 / 3937}
    for unit, factor in lengths.items():
        survey = lambda _, u=unit: sj.SampledTrack(np.arange(5.0), array(np.full(5, 0.5), u), 0.0).lateral
        yield Given("A15", f"survey in {unit}", survey, np.full(5, 0.5 * factor))
        distance = lambda _, u=unit: sj.SampledTrack(series(np.arange(5.0), u), np.zeros(5), 0.0).distance
        yield Given("A15", f"distances of a survey in {unit}", distance, [0.0, 4 * factor])
        play = lambda _, u=unit: sj.Section(points=SCENE.section.points, play=array([1.0] * 5, u)).play
        yield Given("A15", f"play in {unit}", play, [factor] * 5)
    for unit, factor in {"kN": 1e3, "lbf": 4.4482216152605}.items():
        call = lambda _, u=unit: sled(thrust=array([9.0, 9.0, 0.0], u)).thrust
        yield Given("A15", f"thrust in {unit}", call, np.array([9.0, 9.0, 0.0]) * factor)
    for text, given in {
        "speed in kg": lambda: sj.paper_scene(speed=array(900.0, "kg")),
        "speed in m/s^2": lambda: sj.paper_scene(speed=array(900.0, "m/s^2")),
        "survey in s": lambda: sj.SampledTrack(np.arange(5.0), array(np.ones(5), "s"), 0.0),
        "thrust in kg": lambda: sled(thrust=array([9.0, 9.0, 0.0], "kg")),
        "a number in m": lambda: sled(friction=array(0.1, "m")),
        "time since a date": lambda: sled(time=array([0.0, 1.0, 2.0], "seconds since 2026-01-01")),
        "speed in a unit of nobody": lambda: sj.paper_scene(speed=array(900.0, "furz")),
        "temperature": lambda: sj.paper_scene(speed=array(900.0, "degC")),
    }.items():
        yield Given("A15", text, lambda _, call=given: call(), None)
    for units_of, exact in (("", 0.25), ("1", 0.25), ("percent", 0.0025), ("%", 0.0025)):
        call = lambda _, u=units_of: sled(friction=array(0.25, u)).friction
        yield Given("A15", f"friction in {units_of!r}", call, exact)
    varied = result_dataset(
        {"status": ("speed", [0, 0])},
        {"speed": ("speed", [250.0, 300.0], {"units": "m/s"})},
        run_attributes(SCENE, sj.Motion(), {"function": "sweep"}, ["speed"]),
    )
    chosen = lambda _: sj.load_scene(varied, speed=array(900.0, "km/h")).speed
    yield Given("A15", "a case by its speed in km/h", chosen, 250.0)
    other = varied.assign_coords(speed=("speed", [900.0, 1080.0], {"units": "km/h"}))
    yield Given("A15", "a result in km/h", lambda _: sj.load_scene(other, speed=900.0), None)
    yield Given("A15", "a result in km/h, the first", lambda _: sj.load_scene(other.isel(speed=0)), None)


def joined() -> Iterator[Given]:
    """A result that was joined from several scenes has none."""

    def part(clearance: float, speeds: list[float], **more: Any) -> xr.Dataset:
        scene = sj.paper_scene(clearance=clearance).replace(**more)
        attrs = run_attributes(scene, sj.Motion(), {"function": "sweep"}, ["speed"])
        coords = {"speed": ("speed", speeds, {"units": "m/s"})}
        return result_dataset({"status": ("speed", [0] * len(speeds))}, coords, attrs)

    one, same, other = part(1e-3, [1e3, 1.1e3]), part(1e-3, [1.2e3, 1.3e3]), part(2e-3, [1.4e3, 1.5e3])
    light = part(1e-3, [1.4e3, 1.5e3], gravity=0.0)
    clearance = lambda ds, **more: float(PARAMETERS["clearance"].of(sj.load_scene(ds, **more)))
    beside = xr.concat([one, part(2e-3, [1e3, 1.1e3])], "play")
    calls: dict[str, tuple[Callable[[], Any], Any]] = {
        "of one scene": (lambda: clearance(xr.concat([one, same], "speed"), speed=1.2e3), 1e-3),
        "one case of one scene": (lambda: clearance(xr.concat([one, same], "speed").isel(speed=3)), 1e-3),
        "of two plays": (lambda: clearance(xr.concat([one, other], "speed"), speed=1.4e3), None),
        "one case of two plays": (lambda: clearance(xr.concat([one, other], "speed").isel(speed=3)), None),
        "the first of two plays": (lambda: clearance(xr.concat([one, other], "speed").isel(speed=0)), 1e-3),
        "of two gravities": (lambda: clearance(xr.concat([one, light], "speed"), speed=1.4e3), None),
        "of three": (lambda: clearance(xr.concat([one, same, other], "speed"), speed=1.5e3), None),
        "beside each other": (lambda: clearance(beside, speed=1e3), None),
        "the second beside": (lambda: clearance(beside.isel(play=1), speed=1e3), None),
        "its start": (lambda: sj.load_start(xr.concat([one, other], "speed"), speed=1.4e3), None),
        "merged": (lambda: clearance(xr.combine_by_coords([other, one], combine_attrs="override"), speed=1e3), None),
        "filled up": (lambda: clearance(one.reindex(speed=[1e3, 1.1e3, 1.2e3]), speed=1e3), 1e-3),
    }
    for text, (call, exact) in calls.items():
        yield Given("A12", text, lambda _, call=call: call(), exact)


def overloads() -> Iterator[Given]:
    """Marks of overload are missing in records, with a word, and refused elsewhere."""
    steady = np.arange(12) / 1e3
    for mark in (9.9e37, -9.9e37, 9.97e36, 9.969209968386869e36, 1e38, 9.91e37, np.inf):
        values = np.append(np.ones(11), mark)
        record = xr.Dataset(
            {"front": ("time", values, {"units": "m/s^2"})}, {"time": ("time", steady, {"units": "s"})}
        )
        largest = lambda _, ds=record: abs(measured_runs(ds, RIG)[0].signals[0].value).max()
        yield Given("A18", f"a record with {mark:g}", largest, 1.0, warns="overload")
    for cell in ("9.9E37", "-9.9E+37", "9.97e36", "1E38", "OVL", "Over", "inf", "1.#INF", "-1.#INF"):
        rows = "".join(f"{k},{1 + k % 2}\n" for k in range(12))
        text = f"time [ms], front [m/s^2]\n{rows}12,{cell}\n"
        largest = lambda p, t=text: measured_runs(written(p, t), RIG)[0].signals[0].value.max()
        yield Given("A18", f"a file with {cell}", largest, 2.0, warns="overload")
        survey = f"distance [m], lateral [mm]\n0,0\n1,0.1\n2,{cell}\n3,0\n4,0\n"
        yield Given("A18", f"a survey with {cell}", lambda p, t=survey: sj.load_rail(written(p, t)), None)
        speeds = f"time [s], speed [m/s]\n0,100\n1,110\n2,{cell}\n3,120\n"
        yield Given("A18", f"speeds with {cell}", lambda p, t=speeds: sj.load_speed(written(p, t)), None)
    thrust = "time [s], thrust [N]\n0,9e4\n1,9.9E37\n2,0\n"
    yield Given("A18", "thrust", lambda p: sj.RocketSled.from_file(written(p, thrust), mass=300.0), None)


def records() -> Iterator[Given]:
    """An oscillator on a record from the midst of a motion has moved before."""
    rate = 10_000.0
    for band in ((150, 500), (100, 800)):
        filtered = scipy.signal.butter(4, np.array(band) / (rate / 2), "bandpass", output="sos")
        noise = np.random.default_rng(7).standard_normal((20, 20_000))
        long = scipy.signal.sosfilt(filtered, noise, axis=-1)
        for frequency in (20.0, 40.0, 80.0, 300.0):
            moved = abs(oscillator_response(long, rate, frequency))[:, -8000:].max(axis=-1).mean()
            call = lambda _, x=long, f=frequency: shock_response_spectrum(x[:, -8000:], rate, [f]).mean()
            yield Given("A9", f"noise of {band} Hz at {frequency:g} Hz", call, moved, 0.15)


def pauses() -> Iterator[Given]:
    """A programme ends when no thrust is left: twice the way of one push, and the slide from 1 m/s on."""
    for push, friction, later in ((1.0, 0.5, 6.0), (0.5, 0.5, 4.0), (1.0, 0.4, 9.0), (2.0, 0.8, 12.0)):
        times = np.array([0.0, 0.001, push, push + 0.001])
        of_one = dict(mass=500.0, friction=friction)

        def call(_: Path, times=times, later=later, of_one=of_one) -> float:
            thrust = [0.0, 1e4, 1e4, 0.0] * 2
            return float(sj.RocketSled(np.append(times, times + later), thrust, **of_one).programme().distance[-1])

        once = float(sj.RocketSled(times, [0.0, 1e4, 1e4, 0.0], **of_one).programme().distance[-1])
        yield Given("A11", f"{push:g} s of thrust again after {later:g} s", call, 2 * once + 0.5 / G / friction, 1e-4)


def scales() -> Iterator[Given]:
    """Shapes of largest value one are warned of, or divided by the root of their masses."""
    for mass in (100.0, 500.0, 2000.0):
        mounts = [sj.Mount(x=x, name=name) for x, name in ((2.0, "a"), (-2.0, "b"))]
        beam = sj.Modes.beam([2.0, -2.0], mass=mass, length=4.0, stiffness=1e7)
        largest = np.abs(np.asarray(beam.shapes)).max(axis=(1, 2))
        tall = sj.Modes(beam.frequency, beam.damping, beam.shapes / largest[:, None, None])
        body = dict(mass=mass, inertia=(mass, 2 * mass, 2 * mass), mounts=mounts, length=0.2)
        made = lambda _, m=tall, body=body: sj.Sled(modes=m, **body).modes.count
        yield Given("A16", f"largest value 1 of {mass:g} kg", made, 3, warns="modal mass")

        def read(folder: Path, tall=tall, largest=largest) -> Any:
            names = dict(mounts=["a", "b"], modal_mass=1 / largest**2)
            arrays = {name: np.asarray(getattr(tall, name)) for name in ("frequency", "damping", "shapes")}
            np.savez(folder / "modes.npz", **arrays, **names)
            return sj.load_modes(folder / "modes.npz").shapes

        yield Given("A16", f"with modal masses, of {mass:g} kg", read, np.asarray(beam.shapes))


def chords() -> Iterator[Given]:
    """Of a sine the versines give the sine, and no wave besides."""
    distance = np.arange(0.0, 400.01, 0.25)
    for chord, wavelength, phase in ((18.9, 12.0, 1.0), (18.9, 30.0, 2.0), (10.0, 7.0, 0.5), (5.0, 3.3, 1.5)):
        wave = np.sin(TAU * distance / wavelength + phase)

        def read(folder: Path, wave=wave, chord=chord, wavelength=wavelength) -> float:
            versine = (1 - np.cos(np.pi * chord / wavelength)) * wave
            rows = "".join(f"{x},{v:.9f}\n" for x, v in zip(distance, versine, strict=True))
            found = sj.load_rail(written(folder, f"distance [m], lateral [mm]\n{rows}"), chord=chord).lateral
            # one and the error over the amplitude
            return 1.0 + np.std(np.asarray(found) / 1e-3 - wave)

        yield Given("A17", f"a sine of {wavelength:g} m by a chord of {chord:g} m", read, 1.0, 0.1)


INPUTS = [
    *(given for kind in (rates, masks, durations, units, joined, overloads) for given in kind()),
    *(given for kind in (records, pauses, scales, chords) for given in kind()),
]


def outcome(given: Given, folder: Path) -> str:
    """Tells what came: "right", "refused", or what is wrong."""
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            found = np.asarray(given.call(folder), float)
        except ValueError as error:
            lines = str(error).splitlines()
            return "refused" if len(lines) < 4 and len(lines[0]) < 400 else f"unclear: {error}"
        except Exception as error:
            return f"traceback: {error!r}"
    if given.exact is None:
        return f"taken: {found}"
    if not any(given.warns in str(one.message) for one in said) and given.warns:
        return f"no word: {found}"
    right = np.allclose(found, given.exact, rtol=given.rtol, atol=0.0, equal_nan=True)
    return "right" if right else f"wrong: {found} for {given.exact}"


@pytest.mark.parametrize("given", INPUTS, ids=lambda one: f"{one.kind}-{one.text}")
def test_no_input_gives_a_wrong_number_in_silence(given, tmp_path):
    assert outcome(given, tmp_path) == ("refused" if given.exact is None else "right")


def test_there_are_two_hundred_inputs():
    assert len(INPUTS) >= 200
    assert len({(given.kind, given.text) for given in INPUTS}) == len(INPUTS)


if __name__ == "__main__":
    import collections
    import sys
    import tempfile

    wrong: collections.Counter[str] = collections.Counter()
    for given in INPUTS:
        with tempfile.TemporaryDirectory() as folder:
            came = outcome(given, Path(folder))
        good = came == "right" or came == "refused"
        wrong[given.kind] += not good
        if not good or (came == "refused") != (given.exact is None):
            print(given.kind, given.text, "->", came)
    print(f"{wrong.total()} of {len(INPUTS)} wrong:", dict(wrong))
    sys.exit(int(wrong.total() > 0))
