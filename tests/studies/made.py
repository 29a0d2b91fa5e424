"""Made datasets with known answers: what sweeps would give if the paper's claims held."""

from types import SimpleNamespace

import numpy as np
import xarray as xr

from slipperjax.studies.dang2024.claims import DUAL_LINES
from slipperjax.sweeps.attractors import attractors

from ..plots.test_branches import branch

PERIODS = 400
CROSSINGS = 12
SECTIONS = ("v_y", "v_z", "w_x", "w_y", "w_z")


def strobe(kind):
    """States once per period of a motion of period n, given as n, or a chaotic one, given as "chaotic"."""
    if kind == "chaotic":
        x = np.empty(PERIODS)
        x[0] = 0.3
        for k in range(1, PERIODS):
            x[k] = 3.9 * x[k - 1] * (1 - x[k - 1])
    else:
        x = np.arange(PERIODS) % kind / kind
    return np.outer(x, np.full(10, 1e-2))


def section(points, level):
    """Velocities of a section with so many distinct points about a level; NaN where there are no more."""
    values = np.full(CROSSINGS, np.nan)
    if points:
        values[:10] = level + np.arange(10) % points
    return values


def diagram(name, values, kinds, points=None, levels=None, dim=None):
    """A dataset of `sweep` over one parameter.

    **Arguments:** `kinds`: of `strobe`, by case; `points`: numbers of points by section, 1 where not given; `levels`:
    mean velocities by section, 100 where not given.
    """
    values, points, levels = np.asarray(values, float), points or {}, levels or {}
    dim = dim or name
    ds = xr.Dataset(coords={name: (dim, values)})
    full = lambda given, default: np.broadcast_to(given if given is not None else default, values.shape)
    for s in SECTIONS:
        pairs = zip(full(points.get(s), 1), full(levels.get(s), 100.0), strict=True)
        ds[s] = ((dim, "crossing"), np.stack([section(n, level) for n, level in pairs]))
    known = {kind: strobe(kind) for kind in set(kinds)}
    ds["strobe"] = ((dim, "strobe_period", "coordinate"), np.stack([known[kind] for kind in kinds]))
    ds["status"] = (dim, np.zeros(len(values), int))
    return ds


def exponents(name, values, positive):
    """A dataset of `lyapunov_sweep` over one parameter, with exponents of 0.1 or -0.1."""
    exponent = np.where(np.broadcast_to(positive, np.shape(values)), 0.1, -0.1)[:, None]
    data = {
        "exponent": ((name, "count"), exponent),
        "stderr": ((name, "count"), np.full_like(exponent, 0.01)),
        "resolved": (name, np.ones(len(values), bool)),
        "status": (name, np.zeros(len(values), int)),
    }
    return xr.Dataset(data, {name: np.asarray(values, float)})


def flagged(ds, at, status=1, number=np.nan):
    """A copy with cases flagged at some values of the parameter, which hold a `number` but for their `stderr`."""
    (name,) = ds["status"].dims
    hit = np.isin(np.round(ds[name].values, 9), np.round(np.atleast_1d(at), 9))
    assert hit.sum() == np.size(at)
    hit = xr.DataArray(hit, dims=name)
    changed = [key for key, v in ds.data_vars.items() if v.dtype.kind == "f" and key != "stderr"]
    numbers = {key: ds[key].where(~hit, number) for key in changed}
    return ds.assign(numbers | {"status": ds["status"].where(~hit, status)})


def attractors_once(ds, *args):
    """`attractors`, computed once for all cases of a status with the same states: made data have few of them."""
    (dim,) = ds["status"].dims
    pairs = zip(ds["strobe"].values, ds["status"].values, strict=True)
    marks = [(states.tobytes(), int(status)) for states, status in pairs]
    firsts = list(dict.fromkeys(marks))
    found = attractors(ds.isel({dim: [marks.index(mark) for mark in firsts]}), *args)
    return type(found)(*(column[[firsts.index(mark) for mark in marks]] for column in found))


def speeds_as_claimed():
    """Fig. 5 as the paper has it."""
    speeds = np.arange(100.0, 2501.0, 10.0)
    between = lambda a, b: (speeds >= a) & (speeds <= b)
    third, high = between(820, 970), speeds > 1810
    kinds = ["chaotic" if s < 820 or s > 1810 else 3 if s < 980 else 1 for s in speeds]
    points = {
        "v_y": np.select([third, between(980, 1810)], [3, 1], 10),
        "v_z": np.select([between(820, 980), between(990, 1810)], [2, 1], 10),
        "w_x": np.select([between(1660, 1810), between(980, 1650)], [0, 1], 10),
    }
    levels = {
        "v_y": np.where(high, 1.0, speeds / 100),
        "w_y": np.where(high, 1000.0, 10.0),
        "w_z": np.where(high, 1000.0, 10.0),
    }
    return diagram("speed", speeds, kinds, points, levels)


def clearances_as_claimed():
    """Fig. 8 as the paper has it."""
    c = np.round(np.arange(0.1, 5.01, 0.025), 6)
    kinds = ["chaotic" if x >= 2.575 else 2 if 1.66 < x < 1.69 else 1 for x in c]
    points = {"w_y": np.where((c > 0.59) & (c < 2.5), 2, 1)}
    levels = {s: 10 * c for s in SECTIONS}
    return diagram("clearance", c * 1e-3, kinds, points, levels)


def lengths_as_claimed():
    """Fig. 10 as the paper has it."""
    length = np.round(np.arange(0.1, 0.5001, 0.0025), 6)
    kinds = ["chaotic" if x <= 0.15 else 1 for x in length]
    points = {"w_y": np.where((length > 0.197) & (length < 0.228), 2, 1)}
    return diagram("length", length, kinds, points, {"v_y": 5.0, "v_z": 4.0})


def singles():
    """The seven single cases of Figs. 4, 7 and 12: histories and sections."""
    speeds = np.array([900.0, 1500.0, 2300.0, 1250.0, 1250.0, 1250.0, 1250.0])
    kinds = [3, 1, "chaotic", 1, "chaotic", 1, 1]
    sections = diagram("speed", speeds, kinds, {"w_x": np.array([2, 1, 10, 1, 10, 1, 1])}, dim="case")
    time = np.arange(1, 60 * 50 + 1) / 50
    wave = lambda *ratios: sum(np.sin(2 * np.pi * r * time) for r in ratios)
    noise = 1e-3 * np.random.default_rng(0).normal(size=time.size)
    alpha = [wave(1, 2 / 3), wave(1, 2, 3), 3 * wave(0.4) + wave(1), *[wave(1)] * 4]
    force = np.zeros((7, time.size, 2, 3))
    force[5, 7, 1] = 1977, 8807, 5447
    force[6, 9, 1] = 4256, 12824, 20365
    numbers = {"clearance": [1e-3] * 4 + [4e-3] + [1e-3] * 2, "length": [0.2] * 5 + [0.1, 0.4], "speed": speeds}
    coords = {key: ("case", np.array(v)) for key, v in numbers.items()}
    coords |= {"end": ["front", "rear"], "point": list("ACJ"), "period": ("time", time)}
    data = {
        "alpha_x": (("case", "time"), np.array(alpha) + noise),
        "contact_force": (("case", "time", "end", "point"), force),
        "peak_force": (("case", "end", "point"), force.max(axis=1)),
        "status": ("case", np.zeros(7, int)),
    }
    for name in ("y", "z", "roll", "v_y", "v_z", "w_x"):
        data[name] = (("case", "time"), np.tile(wave(1), (7, 1)))
    return xr.Dataset(data, coords), sections


def two_waves():
    """Fig. 13 as the paper has it: all lines that it names, f1 the highest."""
    time = np.arange(180 * 50) / (50 * 150.0)
    signal = sum((3.0 if text == "f1" else 1.0) * np.sin(2 * np.pi * f * time) for text, f in DUAL_LINES.items())
    signal = signal + 1e-3 * np.random.default_rng(0).normal(size=time.size)
    data = {name: (("speed", "time"), signal[None], {"units": u}) for name, u in UNITS.items()}
    return xr.Dataset(data | {"status": ("speed", [0])}, {"speed": [1500.0]})


UNITS = {"a_z": "m/s^2", "alpha_x": "rad/s^2", "alpha_y": "rad/s^2"}


def speed_branches():
    """A branch over speed that is stable between a flip and a fold, and the orbits of twice the period."""
    speeds = [900.0, 1000.0, 1100.0, 1200.0, 1600.0, 1700.0, 2000.0, 2200.0, 2100.0]
    labels = ("EP", "", "PD", "", "", "", "", "LP", "")
    first = branch(speeds, (0, 0, 1, 1, 1, 1, 1, 0, 0), labels, over="speed")
    below = [1080.0, 1040.0, 1000.0, 970.0, 900.0]
    twice = branch(below, (1, 1, 1, 1, 0), ("", "GR", "", "PD", "EP"), period=2, over="speed")
    return [SimpleNamespace(ds=one, period=one.attrs["orbit_period"]) for one in (first, twice)]
