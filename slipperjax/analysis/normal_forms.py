"""Normal forms of maps at bifurcations of codimension one and two, by derivatives along few directions.

Near a motion x the map P takes the points H(w) of its centre manifold to H(G(w)), with one coordinate w_j for each
critical multiplier. The Taylor coefficients of H and of the normal form G follow, monomial by monomial, from

    P(H(w)) = H(G(w)),

in which G only has the monomials that no change of coordinates removes (Kuznetsov and Meijer, Numerical Bifurcation
Analysis of Maps, doi:10.1017/9781108585804). The left side needs derivatives of P along the vectors of H, by nested
forward mode. Coefficients are normalised as in MatContM: right eigenvectors have length one, in the weights of the
motions, and left ones a product of one with them.
"""

import itertools
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from math import factorial, prod
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, PyTree

from ..tools.checks import instance, one_of
from ..tools.compile import call_compiled
from ..tools.types import Real
from .arclength import evaluated
from .floquet import multipliers, product
from .shooting import PeriodicMotions

Number = complex | float

TINY = 1e-300
"""Least length by which a direction is divided."""
RESONANT = 1e-6
"""Greatest difference of a multiplier from a product of multipliers to which it is equal."""

Slots = tuple[int, ...]
"""A monomial as the coordinates of its factors, in rising order: (0, 0, 1) is w_0^2 w_1."""


class NormalForm:
    """The map on the centre manifold of a motion, with one coordinate for each critical multiplier.

    The coordinate of a complex multiplier is followed by that of its conjugate.
    """

    def __init__(self, motions: PeriodicMotions, z: np.ndarray, matrices: np.ndarray, critical: Sequence[Number]):
        # without unknowns behind those of the motions
        self.z = np.asarray(z)[: motions.size + np.size(motions.reach)]
        self.motions = motions
        weights = np.asarray(motions.weights(jnp.asarray(self.z))[0])
        self.scale = np.where(weights > 0, weights, 1.0)
        # the Jacobian in weighted components
        self.matrix = self.scale[:, None] * product(np.asarray(matrices)) / self.scale
        self.multipliers: list[Number] = []
        self.right: list[np.ndarray] = []
        self.left: list[np.ndarray] = []
        for mu in critical:
            q, p = self.vectors(mu)
            pair = (lambda a: a, np.conj) if np.iscomplex(mu) else (np.real,)
            for side in pair:
                self.multipliers.append(side(mu))
                self.right.append(side(q))
                self.left.append(side(p / np.conj(np.vdot(p, q))))
        # first derivatives of H and G by coordinate
        slopes = np.diag(self.multipliers)
        self.known = {(j,): (q, slopes[j]) for j, q in enumerate(self.right)}

    def vectors(self, mu: Number) -> tuple[np.ndarray, np.ndarray]:
        """Return right and left eigenvectors of length one; the greatest component of the right one is positive."""
        left, _, right = np.linalg.svd(self.matrix - mu * np.eye(len(self.matrix)))
        q = np.conj(right[-1])
        turn = q[np.argmax(np.abs(q))]
        return q * abs(turn) / turn, left[:, -1]

    def derivative(self, *directions: np.ndarray) -> np.ndarray:
        """Return the derivative of the map along some directions, in weighted components."""
        # a complex direction is a sum of two real ones
        choices = np.array(list(itertools.product(*(range(1 + np.iscomplexobj(one)) for one in directions))))
        parts = np.array([(np.real(one), np.imag(one)) for one in directions])
        real = parts[np.arange(len(directions)), choices]
        # of length one, because differences have a width
        lengths = np.maximum(np.linalg.norm(real, axis=-1, keepdims=True), TINY)
        units = jnp.asarray(real / lengths / self.scale)
        along = jax.device_get(call_compiled(_derivatives, self.motions, (), jnp.asarray(self.z), units))
        factors = 1j ** choices.sum(axis=1) if choices.any() else np.ones(1)
        return self.scale * ((factors * lengths.prod(axis=(1, 2))) @ along)

    def expanded(self, slots: Slots) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives of H (size,) and G (coordinates,) along some coordinates."""
        if slots in self.known:
            return self.known[slots]
        order = len(slots)
        rhs = np.zeros(len(self.matrix))
        # the chain rule: one term for each partition of the slots into blocks
        for blocks, count in Counter(tuple(sorted(blocks)) for blocks in _partitions(slots)).items():
            if len(blocks) == 1:
                continue
            inner = [self.expanded(block) for block in blocks]
            rhs = rhs - count * self.derivative(*(h for h, _ in inner))
            if len(blocks) == order:
                continue
            maps = [g for _, g in inner]
            for chosen in itertools.product(*(np.flatnonzero(g) for g in maps)):
                factor = prod(g[j] for g, j in zip(maps, chosen, strict=True))
                rhs = rhs + count * factor * self.expanded(tuple(sorted(map(int, chosen))))[0]
        factor = prod(self.multipliers[j] for j in slots)
        resonant = [j for j, mu in enumerate(self.multipliers) if abs(mu - factor) < RESONANT]
        choose = lambda vectors: [vectors[j] for j in resonant]
        solution = solved(self.matrix, factor, rhs, choose(self.right), choose(self.left))
        split = len(self.matrix)
        of_map = np.zeros(len(self.multipliers), solution.dtype)
        of_map[resonant] = -solution[split:]
        self.known[slots] = solution[:split], of_map
        return self.known[slots]

    def __call__(self, coordinate: int, *slots: int) -> Number:
        """Return the coefficient of a monomial in one coordinate of the normal form."""
        repeats = prod(factorial(count) for count in Counter(slots).values())
        return self.expanded(slots)[1][coordinate] / repeats

    def turned(self, *slots: int) -> Number:
        """Return the coefficient of a monomial in the coordinate of its first factor, divided by the multiplier."""
        first = slots[0]
        return self(first, *sorted(slots)) / self.multipliers[first]

    def chain(self) -> tuple[np.ndarray, ...]:
        """Return right and left generalised eigenvectors q_0, q_1, p_0, p_1 of a double multiplier."""
        (mu,) = self.multipliers
        q, p = self.vectors(mu)
        q, p = q.real, p.real
        follow = solved(self.matrix, mu, q, [p], [q])[:-1]
        back = solved(self.matrix.T, mu, p, [q], [p])[:-1]
        length = p @ follow
        p, back = p / length, back / length
        return q, follow, p, back - (back @ follow) * p


def solved(matrix: np.ndarray, factor: Number, rhs: np.ndarray, right: Sequence, left: Sequence) -> np.ndarray:
    """Return h of (matrix - factor) h = rhs, and one number for each of the vectors `right`, which complete the range
    where the system is singular; h has no component along them, seen by `left`."""
    size, count = len(matrix), len(right)
    columns = np.reshape(np.array(right), (count, size)).T
    rows = np.conj(np.reshape(np.array(left), (count, size)))
    system = np.block([[matrix - factor * np.eye(size), columns], [rows, np.zeros((count, count))]])
    return np.linalg.solve(system, np.append(rhs, np.zeros(count)))


def _derivatives(motions: PeriodicMotions, static: tuple, z: Array, directions: Array) -> Array:
    """Return derivatives of the map along each of several lists of directions (cases, order, size)."""
    # not as one kernel, because XLA fails to link some kernels of fifth derivatives
    flow = motions.flow(z)
    higher = _slope if motions.width is None else _difference(motions.width)

    def along(directions: Array) -> Array:
        function = lambda x: ravel_pytree(flow(motions.state(x)))[0]
        first, *others = directions
        function = _slope(function, first)
        for direction in others:
            function = higher(function, direction)
        return function(z[: motions.size])

    return jax.vmap(along)(directions)


def _slope(function: Callable[[Array], Array], direction: Array) -> Callable[[Array], Array]:
    """Return the derivative of a function along a direction."""
    return lambda x: jax.jvp(function, (x,), (direction,))[1]


def _difference(width: Real) -> Callable[[Callable[[Array], Array], Array], Callable[[Array], Array]]:
    """Return the function that returns central differences of a function along a direction."""
    return lambda function, way: lambda x: (function(x + width * way) - function(x - width * way)) / (2 * width)


def _partitions(slots: Slots) -> Iterator[tuple[Slots, ...]]:
    """Yield all partitions of some slots into blocks."""
    if not slots:
        yield ()
        return
    first, *rest = slots
    for blocks in _partitions(tuple(rest)):
        yield (first,), *blocks
        for k, block in enumerate(blocks):
            yield *blocks[:k], (first, *block), *blocks[k + 1 :]


Coefficients = dict[str, Number]


def _neimark_sacker(f: NormalForm) -> Coefficients:
    return {"d": f.turned(0, 0, 1), "theta": float(np.angle(f.multipliers[0]))}


def _chenciner(f: NormalForm) -> Coefficients:
    first = f.turned(0, 0, 1)
    second = f(0, 0, 0, 0, 1, 1) / f.multipliers[0]
    return _neimark_sacker(f) | {"e": second - first**2 / 2}


def _resonance_1(f: NormalForm) -> Coefficients:
    q, follow, p, back = f.chain()
    bend = f.derivative(q, q)
    a = float(p @ bend / 2)
    b = float(p @ f.derivative(q, follow) + back @ bend)
    return {"a": a, "b": b, "s": float(np.sign(a * (b - 2 * a)))}


def _resonance_2(f: NormalForm) -> Coefficients:
    q, follow, p, back = f.chain()
    bend = lambda rhs: solved(f.matrix, 1.0, -rhs, (), ())
    h20 = bend(f.derivative(q, q))
    h11 = bend(f.derivative(q, follow) + h20)
    h30 = f.derivative(q, q, q) + 3 * f.derivative(q, h20)
    h21 = f.derivative(q, q, follow) + f.derivative(follow, h20) + 2 * f.derivative(q, h11)
    c = float(p @ h30 / 6)
    d = float(p @ h21 + back @ h30) / 2
    return {"4c": 4 * c, "-2d-6c": -2 * d - 6 * c}


def _resonance_3(f: NormalForm) -> Coefficients:
    b = f(0, 1, 1)
    c = f(0, 0, 0, 1)
    return {"b": b, "c": c, "Re c1": float((np.conj(f.multipliers[0]) * c / abs(b) ** 2 - 1).real / 3)}


def _resonance_4(f: NormalForm) -> Coefficients:
    c = f(0, 0, 0, 1)
    d = f(0, 1, 1, 1)
    return {"c": c, "d": d, "A": -1j * c / abs(d)}


def _fold_flip(f: NormalForm) -> Coefficients:
    across = f(1, 0, 1)
    a = f(0, 0, 0) / across
    b = f(0, 1, 1) * across
    c = f(0, 0, 0, 0) / across**2
    cubic = 2 * f(0, 1, 1) * f(1, 0, 0, 1) - f(1, 1, 1, 1) * (2 * f(0, 0, 0) + across)
    d = f(0, 0, 1, 1) + 2 * cubic / across
    return {"a": a, "b": b, "cNS": b * c / 3 - a * (a * b / 2 + 3 * b + d)}


def _fold_neimark_sacker(f: NormalForm) -> Coefficients:
    found = {"f200": f(0, 0, 0), "f011": f(0, 1, 2), "g110": f.turned(1, 0)}
    found |= {"f300": f(0, 0, 0, 0), "f111": f(0, 0, 1, 2), "g210": f.turned(1, 0, 0), "g021": f.turned(1, 1, 2)}
    return found | {"s": float(np.sign((found["f200"] * found["f011"]).real))}


def _two(f: NormalForm) -> Coefficients:
    """Return how the moduli of two coordinates, the first two that are no conjugates, grow with each other."""
    other = len(f.multipliers) // 2
    # the square of a modulus, which is that of a real coordinate itself
    square = lambda j: (j, j + 1 if np.iscomplex(f.multipliers[j]) else j)
    pairs = {"a": (0, 0), "b": (0, other), "c": (other, 0), "d": (other, other)}
    return {name: float(f.turned(j, *square(k)).real) for name, (j, k) in pairs.items()}


class Form(NamedTuple):
    """Normal form of one kind of bifurcation."""

    critical: tuple[Number | None, ...]
    """Critical multipliers; None for a complex pair whose angle is unknown."""
    order: int
    """Order of the highest derivatives of the map that the coefficients need."""
    coefficients: Callable[[NormalForm], Coefficients]


FORMS = {
    "LP": Form((1.0,), 2, lambda f: {"a": f(0, 0, 0)}),
    "PD": Form((-1.0,), 3, lambda f: {"b": f(0, 0, 0, 0)}),
    "NS": Form((None,), 3, _neimark_sacker),
    "CP": Form((1.0,), 3, lambda f: {"c": f(0, 0, 0, 0)}),
    "GPD": Form((-1.0,), 5, lambda f: {"e": f(0, 0, 0, 0, 0, 0)}),
    "CH": Form((None,), 5, _chenciner),
    "R1": Form((1.0,), 2, _resonance_1),
    "R2": Form((-1.0,), 3, _resonance_2),
    "R3": Form((np.exp(2j * np.pi / 3),), 3, _resonance_3),
    "R4": Form((1j,), 3, _resonance_4),
    "LPPD": Form((1.0, -1.0), 3, _fold_flip),
    "LPNS": Form((1.0, None), 3, _fold_neimark_sacker),
    "PDNS": Form((-1.0, None), 3, _two),
    "NSNS": Form((None, None), 3, _two),
}
"""Normal forms by label."""


def form_at(motions: PeriodicMotions, z: np.ndarray, label: str) -> NormalForm:
    """Return the normal form at a point, with the multipliers nearest to the unit circle as complex critical ones."""
    matrices = np.asarray(evaluated(motions, z).matrices)
    mu = multipliers(matrices)
    upper = sorted(mu[mu.imag > 0], key=lambda one: abs(abs(one) - 1))
    # exactly on the circle
    pairs = iter([one / abs(one) for one in upper])
    return NormalForm(motions, z, matrices, [next(pairs) if one is None else one for one in FORMS[label].critical])


def normal_form(
    motions: PeriodicMotions,
    state: PyTree,
    value: Real | Sequence[Real] | Float[np.ndarray, " parameters"],
    label: str,
) -> Coefficients:
    """Return the coefficients of the normal form at a bifurcation, in MatContM's normalisation.

    | label | coefficients |
    |---|---|
    | LP, PD | `a` of w + a w^2; `b` of -w + b w^3 |
    | NS | `d` of exp(i theta) w (1 + d abs(w)^2), stable for a negative real part; `theta` [rad] |
    | CP, GPD | `c` of w + c w^3; `e` of -w + e w^5 |
    | CH | `d`, `theta`, and `e`, whose real part decides |
    | R1, R2 | `a`, `b` and `s` = sign(a (b - 2 a)); `4c` and `-2d-6c` |
    | R3, R4 | `b`, `c` and `Re c1`; `c`, `d` and `A` |
    | LPPD | `a`, `b`, `cNS` |
    | LPNS | `f200`, `f011`, `g110` and so on by the powers of w, z and conj(z), and `s` = sign(f200 f011) |
    | PDNS, NSNS | `a`, `b`: relative growth of the first modulus with the squares of both; `c`, `d`: of the second |

    **Arguments:** `motions`: of any number of parameters; `state`, `value`: of a motion at the bifurcation, with one
    value for each parameter; `label`: one of the table.

    **Raises:** `ValueError` for another label, and where the map does not have the derivatives that the coefficients
    need, see `PeriodicMotions.derivatives`.
    """
    instance("motions", motions, PeriodicMotions, "slipperjax.analysis.PeriodicMotions")
    one_of("label", label, tuple(FORMS))
    _, order, coefficients = FORMS[label]
    if order > motions.derivatives:
        most = f"derivatives of order {motions.derivatives}, which are all that the map has"
        raise ValueError(f"Argument `label` must need at most {most}, but {label} needs order {order}.")
    z = np.asarray(motions.unknowns(state, *np.ravel(np.asarray(value, float))))
    return {name: _plain(number) for name, number in coefficients(form_at(motions, z, label)).items()}


def _plain(number: Number) -> Number:
    """Return a number of Python, real where it has no imaginary part."""
    number = complex(number)
    return number if number.imag else number.real
