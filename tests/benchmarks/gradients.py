"""Values and derivatives through impacts by several tools, beside exact ones: the tables of docs/lab/gradients.md.

    python -m tests.benchmarks.gradients               # all problems
    python -m tests.benchmarks.gradients ball table    # some problems, or tools

A row is a function of a problem and its two numbers, decorated with `row`, that returns the problem's outputs.
Derivatives are by the numbers relative to their values.
"""

import dataclasses
import functools
import inspect
import json
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
from scipy.integrate import solve_ivp

import slipperjax as sj
from slipperjax.analysis import impact_step, switched_step

from . import exact
from .landed import STORED
from .timing import seconds, show

G = float(exact.GRAVITY)
DIFFERENCES = 10.0 ** np.arange(-1.5, -6.0, -0.5)
"""Relative steps of central differences, of which the best one counts."""


@dataclasses.dataclass(frozen=True)
class Problem:
    """A motion with impacts from time 0 to `end`, over two numbers, with exact outputs and derivatives."""

    name: str
    at: tuple[float, float]
    answers: Callable[[], exact.Exact]
    system: Callable[..., tuple] | None = None
    """Gives (field, gap, reset, state) from `numpy` or `jax.numpy` and the two numbers; the state begins with the
    outputs. None for slippers."""
    end: float = 0.0
    """End of the motion; for slippers a number of forcing periods."""
    steps: int = 0
    """Steps until then, of methods with constant steps."""

    @functools.cached_property
    def exact(self) -> exact.Exact:
        """The answers, computed once."""
        return self.answers()


class Row(NamedTuple):
    """What a tool computes, CPU seconds of the first call, which compiles, and seconds of a later one."""

    found: exact.Exact
    compiling: float
    again: float


def by_forward(function: Callable, problem: Problem) -> Row:
    """Value, first and second derivatives in one program, by forward mode twice."""
    at, outputs = jnp.array(problem.at), len(problem.exact.value)
    twice = lambda u: (out := function(problem, *(u * at))[:outputs], out)
    once = lambda u: (pair := jax.jacfwd(twice, has_aux=True)(u), pair)[1]
    both = lambda u: (once(u)[0], once(u))
    run = jax.jit(jax.jacfwd(both, has_aux=True))
    begin = time.process_time()
    second, (first, value) = jax.block_until_ready(run(jnp.ones(2)))
    compiling = time.process_time() - begin
    again = min(seconds(lambda: run(jnp.ones(2)))[1] for _ in range(9))
    return Row(exact.Exact(*map(np.asarray, (value, first, second))), compiling, again)


def by_differences(function: Callable, problem: Problem) -> Row:
    """Central differences, of first and second derivatives with the step whose error is least."""
    at = lambda step, i, k: np.multiply(problem.at, [1 + i * step, 1 + k * step])
    values = lambda *shift: np.asarray(function(problem, *at(*shift)))[: len(problem.exact.value)]
    begin = time.perf_counter()
    tables = [exact.central(functools.partial(values, step), step) for step in DIFFERENCES]
    again = (time.perf_counter() - begin) / len(DIFFERENCES)
    best = lambda name: min((getattr(t, name) for t in tables), key=lambda v: error(v, getattr(problem.exact, name)))
    return Row(exact.Exact(*map(best, exact.Exact._fields)), 0.0, again)


def error(found: Any, true: np.ndarray) -> float:
    """Greatest error of an output, relative to the greatest magnitude among the output's numbers."""
    flat = lambda array: np.reshape(array, (len(true), -1))
    return float(np.max(np.max(np.abs(flat(found) - flat(true)), 1) / np.max(np.abs(flat(true)), 1)))


ROWS: list[tuple[str, tuple[Problem, ...], Callable[[Problem], Row], int]] = []


def lines(function: Callable) -> int:
    """Count the lines of a function's body, without its description."""
    inside = [line.strip() for line in inspect.getsource(function).splitlines() if line.strip()]
    return sum(not line.startswith(("@", "def ", '"""')) for line in inside)


def row(
    name: str,
    *problems: Problem,
    derive: Callable[[Callable, Problem], Row] = by_forward,
    uses: tuple[Callable, ...] = (),
) -> Callable:
    """Add a row to the tables of some problems: a function of a problem and its two numbers.

    **Arguments:** `derive`: how its derivatives are found; `uses`: other functions that a user would write.
    """

    def added(function: Callable) -> Callable:
        ROWS.append((name, problems, functools.partial(derive, function), sum(map(lines, (function, *uses)))))
        return function

    return added


def ball_system(xp, height, restitution):
    field = lambda t, s: xp.stack([s[1], -G + 0 * t, 0 * t])
    reset = lambda t, s: xp.stack([0 * t, -restitution * s[1], t])
    return field, lambda t, s: s[0], reset, xp.stack([height, 0 * height, 0 * height])


def stop_system(xp, start, force):
    damping, frequency, gap, rebound = map(float, (exact.DAMPING, exact.FREQUENCY, exact.GAP, exact.REBOUND))
    field = lambda t, s: xp.stack([s[1], force * xp.cos(frequency * t) - 2 * damping * s[1] - s[0], 0 * t])
    reset = lambda t, s: xp.stack([s[0], -rebound * s[1], t])
    return field, lambda t, s: gap - s[0], reset, xp.stack([start, 0 * start, 0 * start])


def table_system(xp, height, amplitude):
    rebound = float(exact.TABLE_REBOUND)
    field = lambda t, s: xp.stack([s[1], -1 + 0 * t, 0 * t])
    gap = lambda t, s: s[0] - amplitude * xp.sin(t)
    reset = lambda t, s: xp.stack([s[0], (1 + rebound) * amplitude * xp.cos(t) - rebound * s[1], t])
    return field, gap, reset, xp.stack([height, 0 * height, 0 * height])


def balls_system(xp, upper, share):
    rebound = float(exact.BALLS_REBOUND)
    field = lambda t, s: xp.stack([s[2], s[3], -G + 0 * t, -G + 0 * t, 0 * t])
    gap = lambda t, s: xp.minimum(s[0], s[1] - s[0])

    def reset(t, s):
        change = (1 + rebound) * (s[2] - s[3]) / (1 + share)
        of_floor = xp.stack([s[0], s[1], -rebound * s[2], s[3], t])
        of_balls = xp.stack([s[0], s[1], s[2] - share * change, s[3] + change, t])
        return xp.where(s[0] < s[1] - s[0], of_floor, of_balls)

    still = 0 * upper
    return field, gap, reset, xp.stack([float(exact.LOWER) + still, upper, still, still, still])


def play_system(xp, start, force):
    """The fourth state is 1 in contact; a reset turns it over, and with it the gap."""
    damping, frequency, play, spring = map(float, (exact.SOFT, exact.SLOW, exact.PLAY, exact.SPRING))

    def field(t, s):
        pushed = s[3] * spring * (s[0] - play * xp.sign(s[0]))
        return xp.stack([s[1], force * xp.cos(frequency * t) - 2 * damping * s[1] - s[0] - pushed, s[3], 0 * t])

    gap = lambda t, s: (1 - 2 * s[3]) * (play**2 - s[0] ** 2)
    reset = lambda t, s: xp.stack([s[0], s[1], s[2], 1 - s[3]])
    return field, gap, reset, xp.stack([start, 0 * start, 0 * start, 0 * start])


def solved(function: Callable, *at: float) -> tuple:
    """Numbers and answers of a problem of `exact.py`."""
    return at, functools.partial(exact.exact, function, at)


def stored(periods: int) -> exact.Exact:
    """Answers for the slipper, by landed.cpp."""
    found = json.loads(STORED.read_text())["periods"][str(periods)]
    return exact.Exact(*(np.array(found[name]) for name in exact.Exact._fields))


BALL = Problem("ball", *solved(exact.ball, 1.0, 0.8), ball_system, float(exact.BALL_END), 50)
STOP = Problem("stop", *solved(exact.stop, 0.1, 1.0), stop_system, float(exact.STOP_END), 2000)
PLAY = Problem("play", *solved(exact.play, 0.3, 0.6), play_system, float(exact.PLAY_END), 2000)
TABLE = Problem("table", *solved(exact.table, 2.0, 1.2), table_system, float(exact.TABLE_END), 200)
BALLS = Problem("balls", *solved(exact.balls, 1.0, 0.4), balls_system, float(exact.BALLS_END), 200)
SLIPPERS = [
    Problem(f"slipper{n}", (0.5, 1250.0), functools.partial(stored, n), end=n, steps=100 * n) for n in (3, 30)
]
RIGID = BALL, STOP, PLAY, TABLE, BALLS


@row("`switched_step`", PLAY)
def by_switched_step(problem, start, force):
    free = lambda t, s: jnp.stack([s[1], force * jnp.cos(0.8 * t) - 0.1 * s[1] - s[0], 0 * t])
    spring = lambda t, s: jnp.stack([0 * t, -10 * (s[0] - 0.5 * jnp.sign(s[0])), 1 + 0 * t])
    gap = lambda t, s: s[0] ** 2 - 0.25
    held = lambda t, s: free(t, s) + spring(t, s)
    step = switched_step(held, free, gap, dt=problem.end / problem.steps, steps=problem.steps)
    return step(jnp.stack([start, 0 * start, 0 * start]), 0.0)


@row("`impact_step`", BALL, STOP, TABLE, BALLS)
def by_impact_step(problem, *numbers):
    field, gap, reset, state = problem.system(jnp, *numbers)
    step = impact_step(field, gap, reset, dt=problem.end / problem.steps, steps=problem.steps)
    return step(state, 0.0)


def restarted(problem, numbers, tolerance, root_finder):
    """diffrax, stopped by an event, and started again behind it from the state after the impact."""
    field, gap, reset, state = problem.system(jnp, *numbers)
    event = diffrax.Event(lambda t, y, args, **_: gap(t, y), root_finder, direction=False)
    options = dict(
        stepsize_controller=diffrax.PIDController(rtol=tolerance, atol=tolerance),
        adjoint=diffrax.ForwardMode(),
        event=event,
    )
    term = diffrax.ODETerm(lambda t, y, args: field(t, y))

    def to_next(carry):
        t, y = carry
        part = diffrax.diffeqsolve(term, diffrax.Tsit5(), t, problem.end, 0.01, y, **options)
        t, y = part.ts[-1], part.ys[-1]
        return t, jnp.where(t < problem.end, reset(t, y), y)

    return jax.lax.while_loop(lambda carry: carry[0] < problem.end, to_next, (jnp.zeros(()), state))[1]


@row("diffrax, as documented", BALL, STOP, uses=(restarted,))
def by_documented_events(problem, *numbers):
    return restarted(problem, numbers, 1e-6, optimistix.Newton(1e-5, 1e-5, optimistix.rms_norm))


@row("diffrax, tight", *RIGID, uses=(restarted,))
def by_tight_events(problem, *numbers):
    return restarted(problem, numbers, 1e-10, optimistix.Newton(1e-12, 1e-12))


@row("SciPy, differences", *RIGID, derive=by_differences)
def by_scipy(problem, *numbers):
    field, gap, reset, y = problem.system(np, *numbers)
    height = lambda t, y: gap(t, y)
    height.terminal, height.direction = True, -1
    t = 0.0
    while True:
        part = solve_ivp(field, (t, problem.end), y, method="DOP853", rtol=1e-11, atol=1e-11, events=height)
        t, y = part.t[-1], part.y[:, -1]
        if part.status == 0:
            return y
        y = reset(t, y)


def by_period_map(problem, v_y, speed):
    scene = sj.paper_scene(speed=speed)
    start = sj.initial_state(scene, dataclasses.replace(sj.table_2_start(), v_y=v_y))
    steps = problem.steps // problem.end
    end = sj.period_map(scene, start, periods=problem.end, steps_per_period=steps).motion
    return jnp.stack([end.y, end.z, end.v_y, end.v_z])


row("`period_map`", *SLIPPERS)(by_period_map)
row("differences of it", *SLIPPERS, derive=by_differences)(by_period_map)


def measured(names: list[str]) -> Iterator[dict[str, str]]:
    """Rows of the table, as they are computed: those whose problem or tool has one of the names, or all of them."""
    for problem in (*RIGID, *SLIPPERS):
        for name, problems, run, count in ROWS:
            if problem in problems and (not names or {problem.name, name} & set(names)):
                found, compiling, again = run(problem)
                errors = {
                    part: f"{error(getattr(found, part), getattr(problem.exact, part)):.0e}"
                    for part in exact.Exact._fields
                }
                times = {"compile [CPU s]": f"{compiling:.0f}" if compiling else "", "run [ms]": f"{1e3 * again:.2g}"}
                yield {"problem": problem.name, "tool": name, **errors, **times, "lines": str(count)}


def main(*names: str) -> None:
    """Print each row when it is there, and all of them as a table."""
    rows = []
    for line in measured(list(names)):
        print(line, flush=True)
        rows.append(line)
    show(rows)


if __name__ == "__main__":
    main(*sys.argv[1:])
