"""Points of codimension two of maps with exact places and coefficients: digits reached, and times.

python tests/benchmarks/codimension_two.py  # the table of docs/lab/benchmarks.md, in a minute
"""

import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from slipperjax.analysis.arclength import Pace
from slipperjax.analysis.critical import CriticalMotions, continue_critical
from slipperjax.analysis.normal_forms import normal_form
from slipperjax.analysis.shooting import PeriodicMotions
from slipperjax.tools.files import table_lines

from ..analysis.systems import Companion, Generalised, delayed

WIDE = ((-30.0, 30.0), (-4.0, 4.0))


class Row(NamedTuple):
    """A point with its errors."""

    system: str
    label: str
    place: float
    """Greatest error of state and parameters; NaN where the place is given."""
    coefficients: float
    """Greatest error of the coefficients; NaN where no exact ones are known."""
    seconds: float


def along(family: Callable, label: str, state: list[float], values: Any, bounds: Any = WIDE, angle: float = 0.0):
    """Gives a curve and the seconds that it takes, compiling included."""
    motions = PeriodicMotions(family, jnp.zeros(len(state)), jnp.ones(2))
    begin = time.perf_counter()
    equations = CriticalMotions.of(motions, label)
    curve = continue_critical(equations, jnp.array(state), values, bounds, angle=angle, pace=Pace(most=0.3))
    return curve, time.perf_counter() - begin


def worst(found: dict, exact: dict) -> float:
    """Gives the greatest error of some coefficients; of a Neimark-Sacker's d only the real part counts."""
    differences = [(found[name].real if name == "d" else found[name]) - value for name, value in exact.items()]
    return float(np.max(np.abs(differences))) if differences else np.nan


def henon() -> Iterator[Row]:
    """Curves of the generalised Hénon map by R, S, kind and a fixed point; points by y, determinant, coefficients."""
    curves = (
        (0.1, 0.0, "NS", 0.8, "R1", -20 / 19, 1, {"s": 1.0}),
        (0.1, 0.0, "NS", 0.8, "R2", 20 / 19, 1, {"4c": -1.1, "-2d-6c": 0.0225}),
        (0.1, 0.0, "NS", 0.8, "R3", 10 / 19, 1, {"Re c1": 1 / 74}),
        (0.1, 0.0, "NS", 0.8, "R4", 0.0, 1, {"A": 0.0425961833636 - 0.799861665384j}),
        (0.1, 0.0, "PD", 0.1, "LPPD", 0.0, -1, {"a": 0.45, "b": 0.275, "cNS": 0.03103125}),
        (0.1, 0.2, "LP", 1.0, "CP", 1.5, -2.5, {"c": 1 / 35}),
        (0.1, 0.2, "NS", 1.4, "CH", 1.5, 1, {"d": 0.0, "theta": 2.418858405776}),
        (0.1, 0.2, "NS", 1.4, "R3", 2 / 3, 1, {"Re c1": 0.0193798449612}),
        (-0.1, 0.1, "PD", 1.0, "R2", 1.13709218687493, 1, {"4c": -0.568225531212, "-2d-6c": -0.0189718085984}),
        (-0.1, 0.1, "PD", 6.5, "LPPD", 7.0, -1, {"a": 5 / 11, "b": 0.33}),
    )
    for r, s, kind, start, label, y, determinant, exact in curves:
        family = Generalised(jnp.asarray(r), jnp.asarray(s))
        trace = family.trace(start)
        at = family.at(start, {"LP": trace - 1, "PD": -trace - 1, "NS": 1.0}[kind])
        angle = np.arccos(trace / 2) if kind == "NS" else 0.0
        curve, seconds = along(family, kind, [start] * 2, at, angle=angle)
        events = [event for event in curve.events if event.label == label]
        event = min(events, key=lambda event: abs(event.state[0] - y))
        place = np.abs(np.append(event.state - y, np.subtract(event.values, family.at(y, determinant)))).max()
        yield Row(f"Hénon {r}, {s}: {kind}", label, float(place), worst(event.coefficients, exact), seconds)


def companions() -> Iterator[Row]:
    """Companion maps with prescribed multipliers and angles [turns]."""
    circle = lambda *turns: [np.exp(sign * 2j * np.pi * turn) for turn in turns for sign in (1, -1)]
    for label, kind, spectrum in (
        ("PDNS", "PD", [-1, *circle(0.29)]),
        ("LPNS", "LP", [1, *circle(0.29)]),
        ("NSNS", "NS", circle(0.11, 0.29)),
    ):
        family, exact = Companion.of(spectrum, 0.3)
        bounds = [(value - 0.5, value + 0.5) for value in exact]
        start = exact[0], exact[1] + 0.02
        curve, seconds = along(family, kind, [0.3] * len(spectrum), start, bounds, 2 * np.pi * 0.29)
        errors = [np.abs(np.subtract(event.values, exact)).max() for event in curve.events if event.label == label]
        yield Row(f"companion {len(spectrum)}D: {kind}", label, float(min(errors)), np.nan, seconds)


def others() -> Iterator[Row]:
    """Coefficients at given places."""
    cubic = lambda a, b: lambda x, k: a + b * x - x**2 - x**3 / 4
    ricker = lambda a, b: lambda x, k: a * x * jnp.exp(-x)
    logistic = lambda a, b: lambda x, k: a * x * (1 - x)
    simple = Generalised(jnp.asarray(0.0), jnp.asarray(0.0))
    flat = Generalised(jnp.asarray(0.1), jnp.asarray(0.0))
    for system, family, state, values, label, exact in (
        ("Hénon 0, 0", simple, [0.35] * 2, (0.3675, -0.3), "PD", {"b": 0.549450549450549}),
        ("Hénon 0, 0", simple, [-0.35] * 2, (-0.1225, -0.3), "LP", {"a": -0.543928293220421}),
        ("Hénon 0.1, 0", flat, [0.8] * 2, (2.24, 1.08), "NS", {"d": 0.00639204545454545, "theta": 2.43410944181045}),
        ("delayed logistic", delayed, [0.5] * 2, (2.0, 0.0), "NS", {"theta": np.pi / 3}),
        ("Ricker", ricker, [2.0], (np.e**2, 0.0), "PD", {"b": 1 / 6}),
        ("logistic", logistic, [2 / 3], (3.0, 0.0), "PD", {"b": 9.0}),
    ):
        motions = PeriodicMotions(family, jnp.zeros(len(state)), jnp.ones(2))
        begin = time.perf_counter()
        found = normal_form(motions, jnp.array(state), values, label)
        yield Row(system, label, np.nan, worst(found, exact), time.perf_counter() - begin)
    curve, seconds = along(cubic, "PD", [-0.5], (-1.5, -1.9), ((-3.0, 5.0), (-5.0, 5.0)))
    (event,) = (event for event in curve.events if event.label == "GPD")
    place = np.abs(np.subtract(event.values, [-44 / 27, -2])).max()
    yield Row("cubic: PD", "GPD", float(place), worst(event.coefficients, {"e": -1 / 8}), seconds)


def main() -> None:
    """Prints the table."""
    shown = lambda number, form: "" if np.isnan(number) else f"{number:{form}}"
    rows = []
    for row in (*henon(), *companions(), *others()):
        errors = {
            "error of the place": shown(row.place, ".0e"),
            "of the coefficients": shown(row.coefficients, ".0e"),
        }
        rows.append({"curve": row.system, "point": row.label, **errors, "seconds": f"{row.seconds:.1f}"})
    print("\n".join(table_lines(rows)))


if __name__ == "__main__":
    main()
