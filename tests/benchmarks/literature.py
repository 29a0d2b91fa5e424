"""Numbers that others published, computed anew by `slipperjax.analysis`: maps, flows and oscillators with impacts.

    python tests/benchmarks/literature.py              # the tables of docs/lab/benchmarks.md, in half a minute
    python tests/benchmarks/literature.py stop lorenz  # of some systems

Nothing is tuned: Newton's method starts from published values, rounded, or where the source's computation begins.
"""

import itertools
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from slipperjax.analysis.continuation import continue_motion, switch
from slipperjax.analysis.floquet import jacobians
from slipperjax.analysis.hybrid import impact_step, return_step
from slipperjax.analysis.lyapunov import LyapunovSpectrum, map_spectrum
from slipperjax.analysis.ode import ode_spectrum, ode_step
from slipperjax.analysis.shooting import PeriodicMotions, shoot
from slipperjax.tools.checks import one_of
from slipperjax.tools.files import table_lines

CAPD = "CAPD, interval methods (github.com/CAPDGroup/CAPD, 7310792)"
TUCKER = "Galias and Tucker, Int. J. Bifurcation Chaos 21, 551 (2011), in CAPD"
FORTIN = "Fortin, interval methods (github.com/ClementFortin/BilliardOscillatingParabola, 6b95943)"
SICONOS = "Siconos, LinearOscillatorED.ref (github.com/siconos/siconos-tutorials, b6c9bfd)"
AUTO = "AUTO-07p, tutorial, demo ab (github.com/auto-07p/auto-07p, 44cc1c4)"
SPECTRA = "sites.google.com/view/lyapunov-spectrum"
SPROTT = "Sprott, quoted in huggingface.co/datasets/nvidia/Nemotron-CC-Math-v1"
CHAOSTOOLS = "tests of ChaosTools.jl (github.com/JuliaDynamics/ChaosTools.jl)"
PATRA = "chaos.suparnpatra.com/tools/logistic"
SHORT = "a mean over a motion whose length is not given"


class Number(NamedTuple):
    """A published number and ours."""

    system: str
    quantity: str
    published: str
    """As printed, with an error "value ± error", or an interval "low to high"."""
    ours: float
    error: float
    """Standard error of `ours`; zero where it is converged."""
    source: str
    note: str = ""
    """Why the two may differ by more than the published digits."""

    @property
    def bounds(self) -> tuple[float, float]:
        """The published interval, or one unit of the last digit to each side."""
        if " to " in self.published:
            low, high = map(float, self.published.split(" to "))
            return low, high
        value, _, error = self.published.partition(" ± ")
        mantissa, _, power = value.partition("e")
        width = float(error) if error else 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2]))
        return float(value) - width, float(value) + width

    @property
    def shown(self) -> str:
        """Ours, with its error or to 12 digits."""
        return f"{self.ours:.4f} ± {self.error:.4f}" if self.error else f"{self.ours:.12g}"

    @property
    def difference(self) -> float:
        """Ours less the published value, or the middle of its interval."""
        return self.ours - sum(self.bounds) / 2

    @property
    def agrees(self) -> bool:
        """True where ours lies within the published digits and three standard errors of ours."""
        low, high = self.bounds
        return low - 3 * self.error <= self.ours <= high + 3 * self.error


def numbers(only: Sequence[str] = ()) -> Iterator[Number]:
    """Computes all numbers, or those of some systems by name, one system after the other."""
    for name in only or SYSTEMS:
        yield from SYSTEMS[name]()


def rows(found: Sequence[Number]) -> list[str]:
    """Gives the tables in Markdown: by system and source, and number by number."""
    brief = []
    for (system, source), group in itertools.groupby(found, key=lambda n: (n.system, n.source)):
        some = list(group)
        worst = max(some, key=lambda n: abs(n.difference) / (n.bounds[1] - n.bounds[0] + 6 * n.error))
        furthest = f"{worst.quantity}: {worst.published}, ours {worst.shown}"
        row = {"system": system, "numbers": len(some), "within": sum(n.agrees for n in some), "furthest": furthest}
        brief.append(row | {"source": source})
    each = []
    for n in found:
        within = "yes" if n.agrees else f"no: {n.note}" if n.note else "NO"
        row = {"system": n.system, "quantity": n.quantity, "published": n.published, "ours": n.shown}
        each.append(row | {"difference": f"{n.difference:.1e}", "within": within})
    return [*table_lines(brief), "", *table_lines(each)]


def compared(system, source, quantities, published, ours, errors=0, note="", digits="") -> list[Number]:
    """Pairs published numbers, separated by blanks, with ours. The quantities' names are separated by commas.

    **Arguments:** `digits`: what stands behind each published number, such as its error.
    """
    names, texts = quantities.split(", "), [text + digits for text in published.split()]
    many = zip(names, texts, np.ravel(ours), np.broadcast_to(errors, len(names)), strict=True)
    return [Number(system, name, text, float(value), float(error), source, note) for name, text, value, error in many]


def logistic() -> Iterator[Number]:
    """Flips and the fold of x' = r x (1 - x)."""
    family = lambda r: lambda x, k: r * x * (1 - x)
    motions = lambda period: PeriodicMotions(family, jnp.zeros(1), 1.0, intervals=period)
    branch = continue_motion(motions(1), (jnp.array([0.6]), 2.5), (2.4, 3.7), ways=(1,))
    flips = []
    while len(flips) < 4:
        flip = next(event for event in branch.events if event.label == "PD")
        flips.append(flip.value)
        branch = continue_motion(*switch(branch, flip), (2.4, 3.7), ways=(1,), points=40)
    cascade = ", ".join(f"flip of period {2**k} at r" for k in range(4))
    yield from compared("logistic map", PATRA, cascade, "3 3.4495 3.5441 3.5644", flips)
    branch = continue_motion(motions(3), (jnp.array([0.5]), 3.84), (3.82, 3.85))
    fold = next(event for event in branch.events if event.label == "LP").node.z
    yield from compared("logistic map", PATRA, "fold of period 3 at r", "3.8284", fold[-1])
    step = family(fold[-1])
    cycle = sorted(float(x) for x in itertools.accumulate(range(2), step, initial=fold[0]))
    points = ", ".join(f"point {k} of the orbit at the fold" for k in (1, 2, 3))
    yield from compared("logistic map", CHAOSTOOLS, points, "0.1599288 0.5143553 0.9563178", cycle)


def spectrum(system: str, source: str, published: str, run: LyapunovSpectrum, note: str = SHORT) -> Iterator[Number]:
    """Pairs published exponents by the unit of time, the largest first, and where given the dimension."""
    exponents, error = np.asarray(run.per_second), run.stderr / np.asarray(run.period)
    texts = published.split()
    names = ", ".join(f"exponent {k}" for k in range(1, len(exponents) + 1))
    yield from compared(system, source, names, " ".join(texts[: len(exponents)]), exponents, error, note)
    if len(texts) > len(exponents):
        dimension, error = run.kaplan_yorke, run.kaplan_yorke_stderr
        yield from compared(system, source, "dimension", texts[-1], dimension, error, note)


def henon() -> Iterator[Number]:
    step = lambda s, k: jnp.stack([1 - 1.4 * s[0] ** 2 + s[1], 0.3 * s[0]])
    run = map_spectrum(step, jnp.array([0.1, 0.1]), 1_000_000, transient=1000, align=100)
    yield from spectrum("Hénon's map", SPECTRA, "0.4204 -1.6244 1.2588", run)


def towel() -> Iterator[Number]:
    def step(s, k):
        x, y, z = s
        fold = (y + 0.35) * (1 - 2 * z)
        x, y = 3.8 * x * (1 - x) - 0.05 * fold, 0.1 * (fold - 1) * (1 - 1.9 * x)
        return jnp.stack([x, y, 3.78 * z * (1 - z) + 0.2 * s[1]])

    run = map_spectrum(step, jnp.array([0.085, -0.121, 0.075]), 200_000, transient=1000, align=100)
    published = "0.42 to 0.44", "0.36 to 0.38", "-3.4 to -3.2"
    for k, (text, ours, error) in enumerate(zip(published, run.per_period, run.stderr, strict=True), 1):
        yield Number("folded towel map", f"exponent {k}", text, float(ours), float(error), CHAOSTOOLS)


def lorenz_field(t, s, args=None):
    x, y, z = s
    return jnp.stack([10 * (y - x), x * (28 - z) - y, x * y - 8 / 3 * z])


def lorenz() -> Iterator[Number]:
    options = dict(dt=0.005, steps=20, transient=200, align=100)
    run = ode_spectrum(lorenz_field, jnp.array([1.0, 1.0, 20.0]), 100_000, **options)
    yield from spectrum("Lorenz", SPECTRA, "0.9050 -0.0001 -14.5715 2.0621", run)
    step = return_step(lorenz_field, lambda t, s: s[2] - 27, dt=5e-4)
    cycles = {
        2: ("-2.1473681756955529387 to -2.1473667726311975734", "2.078047612582596404 to 2.0780486219920866198"),
        3: ("-3.7826479616493822178 to -3.7826467113320942914", "-0.28060034513739801065 to -0.28059935350049081126"),
    }
    for period, published in cycles.items():
        start = [round(float(text.split()[0]), 2) for text in published]
        orbit = shoot(step, jnp.array([*start, 27.0]), intervals=period)
        for name, text, ours in zip("xy", published, orbit.state[:2], strict=True):
            yield Number("Lorenz", f"orbit of period {period} at z = 27, {name}", text, float(ours), 0.0, TUCKER)


def rossler_field(t, s, args=None):
    x, y, z = s
    return jnp.stack([-(y + z), x + 0.2 * y, 0.2 + z * (x - 5.7)])


def rossler() -> Iterator[Number]:
    run = ode_spectrum(rossler_field, jnp.array([1.0, 1.0, 0.5]), 40_000, dt=0.02, steps=20, transient=500, align=100)
    yield from spectrum("Rössler", SPROTT, "0.0714 0 -5.3943", run)
    step = return_step(rossler_field, lambda t, s: -s[0], dt=2e-4)
    published = {
        1: "-8.3809417428298 0.029590060630665",
        2: "-5.4240738226652 0.031081210807875",
        3: "-6.233158628537965 0.03064011165815",
    }
    for period, texts in published.items():
        y, z = (round(float(text), 3) for text in texts.split())
        orbit = shoot(step, jnp.array([0.0, y, z]), intervals=period, tolerance=1e-12)
        names = ", ".join(f"orbit of period {period} at x = 0: {name}" for name in "yz")
        yield from compared("Rössler", CAPD, names, texts, orbit.state[1:], digits=" ± 4e-13")


def ueda() -> Iterator[Number]:
    field = lambda t, s, args: jnp.stack([s[1], 7.5 * jnp.cos(t) - 0.05 * s[1] - s[0] ** 3])
    period = 2 * np.pi
    options = dict(dt=period / 200, steps=200, period=period, transient=500, align=100)
    run = ode_spectrum(field, jnp.array([2.5, 0.0]), 20_000, **options)
    yield from spectrum("Duffing-Ueda", SPECTRA, "0.0999 -0.1499", run)


def jerk() -> Iterator[Number]:
    field = lambda t, s, args: jnp.stack([s[1], s[2], -s[0] + s[1] ** 2 - 2.017 * s[2]])
    run = ode_spectrum(field, jnp.array([0.0, 0.0, 1.0]), 40_000, dt=0.025, steps=20, transient=500, align=100)
    yield from spectrum("Sprott's jerk", SPECTRA, "0.0551 -0.0000 -2.0721 2.0266", run)


def pendulum() -> Iterator[Number]:
    """x'' = sin t - sin x at t = 10, and its derivatives by two parameters of the start; 12 digits of more."""
    field = lambda t, y, args: jnp.stack([y[1], jnp.sin(t) - jnp.sin(y[0])])
    step = ode_step(field, dt=6 / 4000, steps=4000, t0=4.0)
    start, first = jnp.array([1.0, 2.0]), jnp.array([[1.0, 1.0], [3.0, 4.0]])
    second = jnp.array([[1.0, 3.0, 3.0], [0.0, 2.0, 1.0]])  # coefficients of a a, a b and b b

    def end(ab):
        a, b = ab
        return step(start + first @ ab + second @ jnp.stack([a * a, a * b, b * b]), 0.0)

    curved = jax.jit(jax.jacfwd(jax.jacfwd(end)))(jnp.zeros(2))
    halved = jnp.stack([curved[:, 0, 0] / 2, curved[:, 0, 1], curved[:, 1, 1] / 2], axis=1)
    slopes = jacobians(step, start, 1)[0] @ first
    for names, texts, ours in (
        ("x, x'", "1.20483703335 1.17041482662", step(start, 0.0)),
        ("x_a, x_b, x'_a, x'_b", "-7.80565667723 -10.0010040067 -2.61890487702 -3.48358623656", slopes),
        (
            "x_aa, x_ab, x_bb, x'_aa, x'_ab, x'_bb",
            "-29.1661902480 -79.9855736890 -52.1961182105 -14.8470974998 -38.9769249315 -24.2494060090",
            halved,
        ),
    ):
        yield from compared("forced pendulum", CAPD, names, texts, ours)


def reaction() -> Iterator[Number]:
    """Folds and the Hopf point of the A -> B reaction: equilibria are fixed points of the flow's map."""

    def field(t, u, p):
        rate = p * (1 - u[0]) * jnp.exp(u[1])
        return jnp.stack([rate - u[0], 14 * rate - 3 * u[1]])

    motions = PeriodicMotions(lambda p: ode_step(field, dt=0.02, steps=20, args=p), jnp.zeros(2), 1.0)
    branch = continue_motion(motions, (jnp.zeros(2), 0.01), (0.005, 0.15))
    found = [(event.label, event.value) for event in branch.events if event.label != "EP"]
    (_, one), (_, two), (_, hopf) = found
    note = "found to 2e-7 by AUTO's tolerances"
    yield from compared("A -> B reaction", AUTO, "p1 at fold 1, p1 at fold 2", "1.057390e-1 8.893185e-2", [one, two])
    yield from compared("A -> B reaction", AUTO, "p1 at the Hopf point", "1.308998e-1", hopf, note=note)


def parabola_map(alpha: float, restitution: float, amplitude: float) -> Callable[[Any, Any], Any]:
    """A particle above a vibrating parabola y = alpha x^2 + amplitude sin 2 pi t, from impact to impact.

    The state is the phase, x, y and the velocities along x and y just before an impact.
    """

    def field(t, s):
        _, _, _, v, w = s
        return jnp.stack([jnp.ones_like(v), v, w, 0 * v, -9.81 * jnp.ones_like(v)])

    def gap(t, s):
        return s[2] - alpha * s[1] ** 2 - amplitude * jnp.sin(2 * jnp.pi * s[0])

    def rebound(t, s):
        phase, x, y, v, w = s
        slope, rise = 2 * alpha * x, 2 * jnp.pi * amplitude * jnp.cos(2 * jnp.pi * phase)
        kick = (1 + restitution) * (w - rise - slope * v) / (1 + slope**2)
        return jnp.stack([phase, x, y, v + slope * kick, w - kick])

    flight = return_step(field, gap, rebound, dt=0.01, most=1000)

    def step(state, k):
        end = flight(state, k)
        return end.at[0].add(-jnp.floor(end[0]))

    return step


PARABOLAS = {
    (1.8, 0.75, 1.5): (
        "0.85201211 1.42146982 2.69987397 -1.61604321",
        "0.125747179 -0.68394141 -1.22162581 -3.95657185",
    ),
    (2.0, 0.8, 1.0): (
        "0.127820036 0.670583130 1.975100358 5.583667784",
        "0.212076987 -2.099509068 -1.495386375 0.603685512",
    ),
    (2.0, 0.5, 2.0): (
        "0.208102729 1.525064092 1.566045976 -0.256718059",
        "0.301251967 -1.066107922 -0.437659622 -9.781176201",
    ),
}
"""Phase, x and velocities before the first of two impacts, by steepness, coefficient of restitution and amplitude."""


def parabola() -> Iterator[Number]:
    for (alpha, restitution, amplitude), orbits in PARABOLAS.items():
        step = parabola_map(alpha, restitution, amplitude)
        for k, texts in enumerate(orbits, 1):
            phase, x, v, w = (round(float(text), 5) for text in texts.split())
            y = alpha * x**2 + amplitude * np.sin(2 * np.pi * phase)
            orbit = shoot(step, jnp.array([phase, x, y, v, w]), intervals=2, tolerance=1e-12)
            names = ", ".join(f"orbit {k} at e = {restitution}: {name}" for name in ("phase", "x", "x'", "y'"))
            yield from compared("vibrating parabola", FORTIN, names, texts, jnp.delete(orbit.state, 2))


def stop() -> Iterator[Number]:
    """Impacts of x'' = -1e5 x - 9.81 on a stop at zero, coefficient of restitution 0.9, dropped from 1."""
    field = lambda t, s: jnp.stack([jnp.ones_like(t), s[2], -1e5 * s[1] - 9.81])
    step = return_step(field, lambda t, s: s[1], lambda t, s: s * jnp.array([1.0, 1.0, -0.9]), dt=1e-5, most=2000)
    published = "4.9669839439e-3 -316.258786439", "1.49008829008e-2 -284.632907795"
    published += "2.48347052678e-2 -256.169617016", "3.47684425349e-2 -230.552655314"
    state = jnp.array([0.0, 1.0, 0.0])
    for k, texts in enumerate(published, 1):
        state = step(state, 0.0)
        yield from compared("oscillator at a stop", SICONOS, f"impact {k}: t, impact {k}: x'", texts, state[::2])
    field = lambda t, s: jnp.stack([s[1], -1e5 * s[0] - 9.81])
    rebound = lambda t, s: s * jnp.array([1.0, -0.9])
    strobe = impact_step(field, lambda t, s: s[0], rebound, dt=5e-6, steps=40_000)
    end = strobe(jnp.array([1.0, 0.0]), 0.0)
    yield from compared(
        "oscillator at a stop", SICONOS, "t = 0.2: x, t = 0.2: x'", "0.110564994695 -15.9294445819", end
    )


ALL = (parabola, stop, logistic, henon, towel, lorenz, rossler, ueda, jerk, pendulum, reaction)
SYSTEMS = {system.__name__: system for system in ALL}


def main(systems: Sequence[str]) -> None:
    """Prints the tables of all systems, or of some by name."""
    for system in systems:
        one_of("SYSTEMS", system, tuple(SYSTEMS))
    found = list(numbers(systems))
    print("\n".join(rows(found)))
    print(f"\n{sum(n.agrees for n in found)} of {len(found)} within the published digits and our errors")


if __name__ == "__main__":
    main(sys.argv[1:])
