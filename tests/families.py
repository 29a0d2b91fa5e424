"""Programs that many tests share: one for each kind of argument, whatever its numbers are.

An operation of JAX outside of a program is a program of its own, for each shape; so numbers of rails are asked for
here.
"""

from typing import Any

import equinox as eqx
import numpy as np
import xarray as xr

import slipperjax as sj

STEPS = 50
"""Steps per period where nothing else is said."""
SPEEDS = np.array([900.0, 1100.0, 1250.0, 1500.0, 2000.0, 1000.0, 800.0, 1300.0, 1400.0, 1700.0])
"""Speeds of `swept` [m/s], the cases of two chunks."""


def swept(
    speeds: Any = SPEEDS, v_y: Any = (0.5,), z: Any = (0.0,), scene: sj.Scene | None = None, **how: Any
) -> xr.Dataset:
    """Strobes and loads of ten periods, of cases that differ by speed and start.

    One program of 8 lanes for all scenes of the paper's parts and all numbers of steps to 100, and one more for each
    length of the transient; a probe takes a third one.
    """
    options = dict(record=["strobe", "loads"], transient=10, periods=10, steps_per_period=STEPS) | how
    options = dict(chunk=8, probe=False) | options
    grid = {"speed": speeds, "start_v_y": v_y, "start_z": z}
    ds = sj.sweep(sj.paper_scene() if scene is None else scene, grid, **options)
    one = [name for name in ("start_v_y", "start_z") if ds.sizes.get(name) == 1]
    return ds.isel(dict.fromkeys(one, 0))


def settling(speed: float = 1250.0, start: Any = None) -> sj.orbits.Trajectory:
    """Every step of 20 periods, those of `swept`: one program for all speeds and starts."""
    return sj.simulate(sj.paper_scene(speed), 20, steps_per_period=STEPS, start=start)


@eqx.filter_jit
def irregularity_of(track: Any, places: Any) -> Any:
    """Displacements of a rail: one program for each kind of rail and number of places."""
    return track.irregularity(places)


@eqx.filter_jit
def motion_of(track: Any, places: Any) -> Any:
    """Displacements of a rail and their slopes: one program for each kind of rail and number of places."""
    return track.motion(places)


@eqx.filter_jit
def facts_of(track: Any) -> tuple[Any, Any, Any]:
    """Recurrence [m], steepest slope [1] and shortest wavelength [m] of a rail: one program for each kind."""
    return track.recurrence, track.steepest_slope, track.shortest_wavelength


def largest(one: Any, other: Any) -> float:
    """The greatest difference of displacements that both have."""
    return max(float(abs(a - b).max()) for a, b in zip(one, other, strict=True) if a is not None)
