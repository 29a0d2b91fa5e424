"""The commands that look at one case: a trajectory, and a periodic motion."""

import sys
from pathlib import Path
from typing import Any

from .files import Outputs
from .interrupts import on_thread
from .options import COUNT, FROM_ZERO, Case, option, result, takes_case
from .root import LOST, app


def _overview(ds: Any) -> Any:
    # imported when it draws: compiling need not wait for it
    from ..plots.trajectories import overview

    return overview(ds)


@app.command()
@option("--periods", COUNT, "Forcing periods to simulate.", default=60)
@option("--saves-per-period", COUNT, "Saved states per forcing period.")
@option("--probe", FROM_ZERO, "Periods that are repeated with half the step, for the error; or 0.", default=4)
@result("trajectory")
@takes_case
def simulate(case: Case, periods: int, saves_per_period: int | None, probe: int, out: Path) -> int:
    """Simulate one case and write its trajectory."""
    from ..flow.simulate import default_steps, step_plan
    from ..flow.simulate import simulate as run
    from ..flow.status import Status

    scene, files = case.scene, Outputs(out, ".nc", ".png")
    # here, too, so that an error is the only line
    step_plan(lambda: default_steps(scene, None), case.steps_per_period, saves_per_period)
    print(f"simulating {periods} periods of {float(scene.period) * 1e3:.4g} ms ...", file=sys.stderr)
    options = dict(saves_per_period=saves_per_period, probe=probe, **case.options)
    found = on_thread(lambda: run(scene, periods, **options))
    ds = found.to_xarray()
    files.write(ds, _overview)
    status, parts = Status(int(found.status)), [f"{ds.attrs['steps_per_period']} steps per period"]
    if status != Status.NOT_FINITE:
        if float(found.peak.force) > 0:
            parts.append(found.peak.text(scene))
        if found.probe is not None:
            parts.append(_error(found.probe))
    print("; ".join([*parts, f"status: {status}"]))
    return LOST if status == Status.NOT_FINITE else 0


def _error(probe: Any) -> str:
    """Says by how much half the step changes a result."""
    import numpy as np

    most, peaks = float(np.max(probe.error)), np.asarray(probe.peak_error)
    of_force = peaks[np.isfinite(peaks)]
    if not np.isfinite(most):
        return "half the step does not stay finite"
    force = f" and its highest force by {float(np.max(of_force)):.1e} of it" if len(of_force) else ""
    return f"half the step changes a period by {most:.1e} (unit: 1 mm, 10 mrad, 1 m/s, 10 rad/s){force}"


@app.command()
@option("--period", COUNT, "Forcing periods after which the motion recurs.", default=1)
@option("--transient", FROM_ZERO, "Forcing periods simulated before Newton's method; default 60, and 240 if need be.")
@result("orbit")
@takes_case
def orbit(case: Case, period: int, transient: int | None, out: Path) -> int:
    """Find a periodic motion, stable or not, with its Floquet multipliers and contact signature."""
    from ..orbits.periodic import periodic_orbit

    files = Outputs(out, ".nc", ".png")
    print(f"looking for a motion of period {period} ...", file=sys.stderr)
    found = on_thread(lambda: periodic_orbit(case.scene, period, transient=transient, **case.options))
    if is_lost(found):
        return LOST
    files.write(found.to_xarray(), _overview)
    leading = ", ".join(f"{m.real:.6g}{m.imag:+.6g}i" if m.imag else f"{m.real:.6g}" for m in found.multipliers[:4])
    print(
        f"period {found.period}, {'stable' if found.stable else 'unstable'}, largest exponent "
        f"{float(found.exponent):.6g} per period; multipliers {leading}, ...; {found.signature}; "
        f"{int(found.iterations)} iterations, residual {float(found.residual):.1g} (scaled)"
    )
    return 0


def is_lost(orbit: Any) -> bool:
    """Whether Newton's method found no orbit, which is said."""
    from ..flow.status import Status

    status = Status(int(orbit.status))
    if status != Status.FINITE:
        print(f"no file is written; residual {float(orbit.residual):.2g}; status: {status}")
    return status != Status.FINITE
