"""Sweeps: every case of a grid from the same start, as one batch, to an xarray dataset."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import diffrax
import numpy as np

from ..flow.record import AbstractOutput
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.scene import Scene, check_scene
from ..orbits.exponents import check_count
from ..orbits.periodic import TOLERANCE
from ..orbits.simulate import Trajectory, first_of
from ..results.result import Result
from .call import Call
from .exponents import LyapunovExponents
from .orbits import NearestOrbit
from .store import Store, run_or_store


def sweep(
    scene: Scene,
    grid: Mapping[str, object],
    *,
    product: bool = True,
    record: str | AbstractOutput | Sequence[str | AbstractOutput] = "sections",
    transient: int = 300,
    periods: int = 10,
    steps_per_period: int | Sequence[int] | np.ndarray | None = None,
    refine: int = 1,
    saves_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    start: Motion | State | Trajectory | str | None = None,
    begin: float | None = None,
    probe: bool | None = None,
    loads: bool | None = None,
    chunk: int | None = None,
    workers: int | None = None,
    progress: bool | None = None,
    store: Store | str | Path | None = None,
    executor: object = None,
) -> Result:
    """Simulate a scene for every combination of parameter values, as one batch.

    **Arguments:**

    - `scene`: the case whose parameters are varied.
    - `grid`: values by parameter name (see `PARAMETERS` for names and units); several names make a product.
        Coordinates of the start (y, z, v_y, v_z, w_x, w_y, w_z) may also be varied, for pictures of basins.
    - `product`: False reads the lists side by side: case k has the k-th value of each, along the dimension `case`.
    - `record`: values to keep of the last `periods` periods: a name, a record, or a list of both. "sections":
        velocities at the upward zero crossings of each coordinate, as in the paper's bifurcation diagrams, and
        `strobe`, the state once per period from the start; "strobe": the state once per recorded period; "history":
        states and contact forces `saves_per_period` times per period. All other records keep a few numbers per case,
        for any number of periods: "motion" (`kind` and `period` by recurrence), "loads" or one of them ("peak_force",
        "peak_period", "impulse", "contact_fraction", "penetration"), "rms" (of accelerations), "extremes" (of
        coordinates), "contact_load" and others of `slipperjax.flow.RECORDS`; "exponent" (the largest, without a
        certificate, measured after the recorded periods); "exponents" and "orbits", see `lyapunov_sweep` and
        `orbit_sweep`; and `slipperjax.flow.Record` with any function of a period's course.
    - `transient`: forcing periods before the recorded periods. If `record` has only "exponents" or "orbits", these
        are measured directly after the transient, exponents over `periods`.
    - `steps_per_period`: one number for all cases, or an array of the grid's shape; by default the number of
        `default_steps_per_period` for each case, times `refine`. Cases with the same number run together.
    - `probe`: whether the first recorded period of every case is repeated with half the step, to measure its error:
        `probe_error`, in multiples of `slipperjax.model.accuracy_scales` [1]; the status reports an error above a
        tenth. By default where this takes less than a tenth of the time and needs no further compilation.
    - `solver`, `start`, `begin`, `saves_per_period`: as for `simulate`.
    - `loads`: whether peak forces, impulses, times in contact and penetrations of the recorded periods are also kept;
        by default with sections and histories. Any load adds the statuses that follow from loads: no contact, pressed
        in, and too few steps for the damping of contacts.
    - `chunk`: cases per call, rounded up to 16, 24, 32, 40, 48, 56, 64, 80, ..., or 8 where there are no more cases;
        `workers`: threads, by default one per core, but always one for implicit solvers of diffrax, see
        `solvers.calls_lapack`. Both do not change results.
    - `progress`: whether to show progress and the remaining time: True for a bar on terminals and in notebooks, and
        lines from time to time in files and pipes; by default only the bar, which disappears at the end.
    - `store`: path of a zarr store, or a `Store`, which is written during the sweep; the same call continues where
        the last call ended. `executor`: a `dask.distributed.Client` or `concurrent.futures.Executor` that computes
        it.

    **Returns:** a `Result` with the grid's names as first dimensions, then `crossing`, `period` or `time`. `status`
    of each case is 0 where nothing is wrong, or a code for the problem; `steps_per_period` is the number of its
    integration steps. A case that diverges does not affect the others. A varied start coordinate x gives the
    dimension `start_x`. With `store`, values are read from disk when they are used.

    **Raises:** `ValueError`, before anything is compiled, that names the wrong argument, or memory and time of an
    impossible run; `Interrupted` after Ctrl-C, with the finished cases.
    """
    call = Call(
        transient,
        periods,
        saves_per_period,
        begin,
        loads,
        probe,
        record=record,
        steps_per_period=steps_per_period,
        refine=refine,
        solver=solver,
        product=product,
    )
    return run_or_store(
        call,
        scene,
        grid,
        first_of(start),
        store=store,
        executor=executor,
        chunk=chunk,
        workers=workers,
        progress=progress,
    )


def lyapunov_sweep(
    scene: Scene,
    grid: Mapping[str, object],
    *,
    count: int = 1,
    transient: int = 300,
    periods: int = 500,
    certify: bool = True,
    orbits: bool = True,
    **options: object,
) -> Result:
    """Measure Lyapunov exponents for every case of a grid, as one batch, each with its certificate.

    A case that has reached a stable periodic orbit after the transient gets its exponents from the orbit's Floquet
    multipliers: exact to about 1e-8, at a seventh of the cost of a measurement. This happens only where the orbit is
    certain, see `slipperjax.sweeps.reached`. All other cases are measured: cases whose orbit is unstable, distant or
    missing, cases whose forcing does not recur, and cases with any problem.

    **Arguments:**

    - `count`, `periods`: as for `lyapunov_spectrum`; periods are rounded up to blocks of `BLOCK`, and the status is
      checked after each block.
    - `transient`: at least `BLOCK` forcing periods.
    - `certify`: whether other estimates check each case; this doubles the cost, and for chaotic cases costs five
      times as much.
    - `orbits`: whether exponents come from orbits where possible; False measures all cases.
    - others: as for `sweep`, where this is the record "exponents".

    **Returns:** a `Result` over the grid with

    - `exponent` and its standard error `stderr` [1/period], with dimension `count`, the largest first;
    - `weighted_exponent` [1/period]: the same as a smoothly weighted mean, more precise for regular motions, see
      `slipperjax.analysis.weighted_mean`;
    - `by_orbit`: whether the exponents belong to an orbit, with standard errors of zero;
    - `kaplan_yorke` [1], the dimension, and `kaplan_yorke_stderr`, its standard error, where `count` > 1;
    - `kind` and `period` [forcing periods]: of the orbit, or of the motion by recurrence in the last `LAST` counted
      periods, see `slipperjax.analysis.classify`;
    - `regime`: see `slipperjax.analysis.regime`;
    - `status` and `steps_per_period`: as for `sweep`.

    With `certify` it also has

    - `half_step`, the largest exponent with half the step, and its standard error `half_step_stderr` [1/period];
    - `floquet` [1/period]: ln |largest multiplier| per period of periodic motions;
    - `resolved`: whether the estimates agree, see below;
    - `escapes`: how many of `MOTIONS` longer motions of a chaotic case became regular within `HOLD` further periods;
    - `chaotic_for`: least number of forcing periods for which chaos lasted;
    - `least_mean_life` [forcing periods]: if chaos ends, its mean life is longer with 95 % confidence.

    A measured case is `resolved` where its status is 0 and

    - the exponents with full and half steps differ by at most three standard errors of their difference, or 1e-3;
    - the exponents of both halves of the record differ by at most three standard errors, or 1e-2;
    - if it is periodic, its weighted exponent agrees with its multiplier within 1e-3.

    A case on an orbit is resolved where a stable orbit is also found with half the step, and the exponents differ by
    at most 1e-2.

    The exponents of a certified chaotic case, and their standard errors, come from its `MOTIONS` longer motions, see
    `slipperjax.analysis.pooled_standard_error`. Where some of these became regular, the case is "transient chaos",
    with the exponents of the chaotic part.

    **Raises:** `ValueError` that names the wrong argument; `Interrupted` after Ctrl-C. Chaotic cases whose longer
    motions were not finished then have the exponents measured before, and `Status.NOT_RUN`.
    """
    record = LyapunovExponents(check_count(check_scene(scene), count), None, certify, orbits)
    return sweep(scene, grid, record=record, transient=transient, periods=periods, **options)


def orbit_sweep(
    scene: Scene,
    grid: Mapping[str, object],
    *,
    period: int = 1,
    transient: int = 60,
    tolerance: float = TOLERANCE,
    max_iterations: int = 40,
    **options: object,
) -> Result:
    """Find a periodic orbit for every case of a grid, with its Floquet multipliers, after a transient.

    **Arguments:** `period`: forcing periods after which the orbits recur; `transient`: forcing periods before the
    search; `tolerance`: scaled residual that counts as found [1]; `max_iterations`: of Newton's method for each case;
    others as for `sweep`, where this is the record "orbits".

    **Returns:** a `Result` over the grid with

    - `orbit`: the state at the start of a period, in the order and units of `slipperjax.model.COORDINATES`;
      `orbit_state`: all its numbers;
    - `multiplier_real` and `multiplier_imag` [1], over `period` forcing periods;
    - `orbit_exponent` [1/period], ln |largest multiplier| per forcing period; `stable`;
    - `residual` [1], scaled; `iterations`; `status`, which is `Status.NO_ORBIT` where none was found.

    **Raises:** `ValueError` that names the wrong argument; `Interrupted` after Ctrl-C.
    """
    record = NearestOrbit(period, tolerance, max_iterations)
    return sweep(scene, grid, record=record, transient=transient, periods=period, **options)
