"""A linear model in place of runs, with which fits of trajectories take a part of a second and compile nothing."""

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.fitting.course import SIZES, Course, Model

STIFFNESS = 1e8
"""The first unknown of the model that made the record [N/m^1.5]."""
NOISE = 0.02


def wave(time: np.ndarray) -> np.ndarray:
    """The record's signal after some seconds."""
    return np.cos(1e3 * time)


def linear_record(scene: sj.Scene, periods: int = 3) -> xr.Dataset:
    """A record of a sensor `az`, 40 times per forcing period, with noise."""
    time = np.arange(40 * periods) / 40 * float(scene.period)
    signal = wave(time) + NOISE * np.random.default_rng(0).normal(size=time.size)
    return xr.Dataset({"az": ("time", signal, {"units": "m/s^2"})}, {"time": ("time", time, {"units": "s"})})


def linear_model(
    monkeypatch: pytest.MonkeyPatch, first: float = 0.0, last: Callable[[], float] = lambda: 0.0
) -> list[int]:
    """Let a linear model replace the runs of fits.

    A signal is `wave` times the first unknown over `STIFFNESS`, plus the memory of the last contact, which is `first`
    at the beginning of a record, and at the end of each window what `last` returns. Motions do not change.

    **Returns:** a list that gets the number of windows of each later call.
    """
    calls: list[int] = []

    def course(self: Model, points: np.ndarray, carried: np.ndarray, stride: int = 1) -> Course:
        calls.append(self.windows.count)
        levels, numbers = self.split(points)
        shape = wave(self.windows.time)
        value = self.problem.values(levels)[:, :1, None, None] / STIFFNESS
        reading = value * shape + carried[..., -1, None, None]
        slope = np.zeros((*reading.shape, levels.shape[1] + len(SIZES)))
        slope[..., 0] = shape / STIFFNESS
        rows = np.concatenate([numbers * SIZES, carried[..., len(SIZES) :]], axis=-1)
        rows[..., -1] = last()
        end_slope = np.zeros((*numbers.shape, slope.shape[-1]))
        end_slope[..., levels.shape[1] :] = np.eye(len(SIZES))
        return Course(reading, slope, rows, end_slope)

    def begun(self: Model, levels: np.ndarray) -> np.ndarray:
        rows = np.zeros((len(levels), self.windows.count, self.size))
        rows[..., -1] = first
        return rows

    for function in (course, begun):
        monkeypatch.setattr(Model, function.__name__, function)
    monkeypatch.setattr(Model, "compile_ahead", lambda self: None)
    return calls
