"""Lyapunov spectra of one slipper.

The latch of touchdowns is interpolated and differentiable. Therefore tangents include how the place and the instant
of each touchdown depend on the state (saltation), and the exponents of periodic motions agree with their Floquet
multipliers.
"""

import dataclasses

import diffrax

from ..analysis.lyapunov import LyapunovSpectrum, map_spectrum
from ..flow.period_map import PeriodMap, tangent_weights
from ..flow.status import judge_states, with_growth, with_resolution
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.layout import StateLayout
from ..model.scene import Scene, check_scene, check_steady
from ..model.starts import initial_state
from ..solvers.named import resolve_solver
from ..tools.checks import require, whole
from .simulate import (
    Trajectory,
    beginning_of,
    check_rail,
    default_steps,
    first_of,
    refuse_periods,
    steps_of_call,
)


def check_count(scene: Scene, count: int) -> int:
    """Return a number of exponents, which the motion's dimension must allow.

    The dimension is ten, plus one for each contact point whose memory is integrated. A latched memory adds none:
    it follows from the motion at the touchdown.

    **Raises:** `ValueError` for more exponents, and for a scene without steady motions.
    """
    size = StateLayout.of(check_steady(scene)).dimension
    count = whole("count", count, 1)
    require(count <= size, "count", f"be at most {size}, the dimension of the motion", count)
    return count


def lyapunov_spectrum(
    scene: Scene,
    count: int = 1,
    *,
    transient: int = 200,
    periods: int = 500,
    align: int = 20,
    steps_per_period: int | None = None,
    solver: diffrax.AbstractSolver | str | None = None,
    start: Motion | State | Trajectory | None = None,
    begin: float | None = None,
) -> LyapunovSpectrum:
    """Return Lyapunov exponents of one scene by Benettin's method (doi:10.1007/BF02128236), with exact tangents.

    **Arguments:**

    - `count`: number of exponents, the largest first; one costs one tangent.
    - `transient`: forcing periods before the tangents start; `align`: further periods in which the tangents align
        with their directions; `periods`: periods that count.
    - `steps_per_period`, `solver`, `start`, `begin`: as for `simulate`.

    **Returns:** a `LyapunovSpectrum`: `.per_period`, `.per_second`, `.stderr`, `.resolved`, `.history`,
    `.kaplan_yorke`, and `.status`, a `slipperjax.Status` code of the state at the end and of the tangents' growth.
    The chaos of one motion is never `resolved`, even after a long time. At 2100 m/s many motions begin in a band that
    they leave after some 2000 periods, with an exponent of 0.31 instead of 0.26; elsewhere chaos ends in a periodic
    motion. `slipperjax.lyapunov_sweep` runs several motions.

    **Raises:** `ValueError` that names the wrong argument.
    """
    scene = check_scene(scene)
    steps = default_steps(scene, steps_per_period)
    start = first_of(start)
    origin = beginning_of(scene, begin)
    epoch = scene.epoch_at(origin)
    total = whole("periods", periods, 1) + whole("transient", transient, 0) + whole("align", align, 0)
    check_rail(scene, total, origin)
    count = check_count(scene, count)
    refuse_periods(total, steps, periods * count)
    spectrum = map_spectrum(
        PeriodMap(scene, steps_of_call(steps, scene, start), resolve_solver(scene, solver)),
        initial_state(scene, start, epoch),
        periods,
        count=count,
        transient=transient,
        align=align,
        scale=tangent_weights(scene),
        index=epoch,
        period=scene.period,
    )
    code = with_growth(with_resolution(judge_states(spectrum.state), scene, steps), spectrum.history)
    return dataclasses.replace(spectrum, status=code)
