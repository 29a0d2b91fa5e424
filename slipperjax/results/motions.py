"""Texts, tables and pictures of single motions: simulated motions, and periodic orbits."""

import numpy as np
import pandas as pd
import xarray as xr

from ..flow.datasets import scene_of
from ..flow.status import Status, is_lost, step_error
from ..model.scene import travel_unit
from ..plots.style import shown_columns
from ..plots.trajectories import Along, most_loaded, overview
from .kind import Kind, Units

LEADING = 4
"""Number of multipliers in a summary."""


class MotionKind(Kind):
    """A trajectory."""

    title = "Motion over time"

    def summary(self, ds: xr.Dataset, units: Units = None) -> list[str]:
        status = Status(int(ds.attrs["status"]))
        scene = scene_of(ds)
        lines = [f"status: {status}", f"{ds.attrs['steps_per_period']} steps per {travel_unit(scene)}"]
        # forces and errors of a lost motion mean nothing
        if is_lost(status):
            return lines
        highest = most_loaded(ds, 1)[0] if "peak_force" in ds else None
        if highest is not None and highest.peak > 0:
            along = Along.of(ds)
            when = along.words.format(along.unit * highest.instant)
            lines.append(f"highest single contact point {highest.peak:.4g} kN at {highest.name}, {when}")
        error = ds.attrs.get("probe_error [scales]")
        if error is not None:
            # without contact there is no force, and no error of a force
            peak = ds.attrs.get("probe_peak_error", np.nan)
            force = f" and its highest force by {peak:.1e} of it" if np.isfinite(peak) else ""
            lines.append(step_error(scene, error) + force)
        return lines

    def tables(self, ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
        return {"motion": shown_columns(ds, "time", units=units)}

    def plot(self, ds: xr.Dataset, **options):
        return overview(ds, **options)


class OrbitKind(MotionKind):
    """A periodic orbit, over its period."""

    title = "Periodic orbit"

    def summary(self, ds: xr.Dataset, units: Units = None) -> list[str]:
        attrs = ds.attrs
        period = int(attrs["orbit_period"])
        multipliers = ds["multiplier_real"].values + 1j * ds["multiplier_imag"].values
        exponent = np.log(abs(multipliers[0])) / period
        leading = ", ".join(map(said_multiplier, multipliers[:LEADING]))
        return [
            f"period {period}, {'stable' if attrs['stable'] else 'unstable'}, largest exponent {exponent:.6g} per "
            "forcing period",
            f"multipliers {leading}, ...",
            f"touchdowns {attrs['signature'] or 'none'}",
            f"{attrs['iterations']} iterations of Newton's method, residual {attrs['residual']:.1g} (scaled)",
            *super().summary(ds, units),
        ]

    def tables(self, ds: xr.Dataset, units: Units = None) -> dict[str, pd.DataFrame]:
        multipliers = ds[["multiplier_real", "multiplier_imag"]].to_dataframe()
        return super().tables(ds, units) | {"multipliers": multipliers}


def said_multiplier(value: complex) -> str:
    """Return a multiplier as a text; a real multiplier has no imaginary part."""
    return f"{value.real:.6g}" + (f"{value.imag:+.6g}i" if value.imag else "")
