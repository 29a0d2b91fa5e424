"""Lyapunov spectra of any differentiable map or ODE, from its exact tangent dynamics (Benettin et al. 1980).

A system is a function `step(state, k)`, which advances the state (a pytree of floats) over interval number k.
Tangents are propagated by forward mode and orthonormalised at the end of each interval. The logarithms of their
growth are the local exponents, whose means are the spectrum (doi:10.1007/BF02128236).

`step` must be differentiable *as a map*: the instant of an event inside it (a touchdown, a switch) must depend on the
state in a differentiable way. If the force jumps at the end of the integration step that contains the event, the
derivative lacks the saltation term, and the exponents are wrong even for very short steps.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float, Int, PyTree

from ..tools.checks import finite, numbers, positive, require, shown_number, whole
from ..tools.compile import call_compiled
from ..tools.forms import in_one_kernel
from ..tools.texts import brief
from ..tools.tracing import is_traced
from ..tools.types import Numbers, Real
from .kinds import Regime

Step = Callable[[PyTree, Real], PyTree]
"""Function `step(state, k)` that returns the state at the end of interval number k, a float."""
Scale = Callable[[PyTree], PyTree]
"""Function from a state to the weights of its components; the norm of a tangent is the root of the sum of
(weight * component)^2."""


class LyapunovSpectrum(eqx.Module):
    """Exponents and their history. All arrays have leading axes (lanes) if made under `vmap`."""

    history: Float[Array, "*lanes intervals count"]
    """Logarithm of the growth in each interval [1]."""
    state: PyTree
    """State at the end."""
    tangents: PyTree
    """Orthonormal tangents at the end: like the state, with a leading axis of length count."""
    periods: Float[Array, "*lanes"]
    """Periods in an interval [1]."""
    period: Float[Array, "*lanes"]
    """Length of a period [s], or in the unit of the system's time."""
    status: Int[Array, "*lanes"] | None = None
    """Status code of the state at the end, see `slipperjax.Status`; None where the state was not checked."""

    def __repr__(self) -> str:
        if is_traced(self.history) or np.ndim(self.history) != 2:
            return f"LyapunovSpectrum(history={shown_number(self.history)})"
        # exponents of a lost motion mean nothing
        if self.status is not None and np.any(self.status):
            return f"LyapunovSpectrum(status {shown_number(self.status)})"
        pairs = zip(np.asarray(self.per_period), self.stderr, strict=True)
        exponents = ", ".join(f"{exponent:.5g} +- {error:.2g}" for exponent, error in pairs)
        total = self.history.shape[0] * float(self.periods)
        text = f"LyapunovSpectrum({exponents} [1/period],\n  over {total:g} periods of {float(self.period):.5g} s"
        if not self.resolved:
            lasting = "one motion does not show whether its chaos lasts"
            text += f",\n  not resolved: {lasting if self._chaotic else 'the errors leave the sign open'}"
        return text + ")"

    @property
    def per_period(self) -> Float[Array, "*lanes count"]:
        """Exponents [1/period]."""
        return jnp.mean(self.history, axis=-2) / self.periods[..., None]

    @property
    def per_second(self) -> Float[Array, "*lanes count"]:
        """Exponents [1/s]."""
        return self.per_period / self.period[..., None]

    @property
    def stderr(self) -> Float[np.ndarray, "*lanes count"]:
        """Standard errors of `per_period` [1/period], see `one_motion_standard_error`; not for use under a
        transformation. For chaos they are valid only for what the record shows: it may have other bands, or end."""
        return one_motion_standard_error(self.history) / np.asarray(self.periods)[..., None]

    @property
    def resolved(self) -> Bool[np.ndarray, "*lanes"]:
        """Whether it is known that the largest exponent is not positive; not for use under a transformation.

        Chaos of one motion is never resolved. A record of N periods in which chaos does not end shows with 95 %
        confidence only that its mean life exceeds N / 3. For slippers `slipperjax.lyapunov_sweep` runs several
        motions for longer.
        """
        good = is_sure(self.per_period[..., 0], self.stderr[..., 0]) & ~self._chaotic
        return np.asarray(good if self.status is None else good & (np.asarray(self.status) == 0))

    @property
    def _chaotic(self) -> Bool[np.ndarray, "*lanes"]:
        return is_chaotic(self.per_period[..., 0], self.stderr[..., 0])

    @property
    def weighted(self) -> Float[np.ndarray, "*lanes count"]:
        """Exponents [1/period] as a smoothly weighted mean, more accurate than `per_period` for regular motions, see
        `weighted_mean`; not for use under a transformation."""
        return weighted_mean(self.history) / np.asarray(self.periods)[..., None]

    @property
    def kaplan_yorke(self) -> Float[np.ndarray, "*lanes"]:
        """Kaplan-Yorke dimension, see `kaplan_yorke`; not for use under a transformation."""
        return kaplan_yorke(self.per_period)

    @property
    def kaplan_yorke_stderr(self) -> Float[np.ndarray, "*lanes"]:
        """Standard error of `kaplan_yorke`, see `dimension_standard_error`; not for use under a transformation."""
        return dimension_standard_error(self.history)


def weights_of(state: PyTree, scale: Scale | None) -> Float[Array, " size"]:
    """Return the weights of all components in one array; by default all are one."""
    if scale is None:
        return jnp.ones_like(ravel_pytree(state)[0])
    # a scale may return one number for a whole leaf
    full = lambda s, w: jnp.broadcast_to(jnp.asarray(w, s.dtype), s.shape)
    return ravel_pytree(jax.tree.map(full, state, scale(state)))[0]


def fixed_directions(
    seed: int,
    count: int,
    size: int,
    weights: Array,
) -> Float[Array, "count size"]:
    """Return random directions, the same in every run; components of weight zero are zero."""
    normal = jnp.asarray(np.random.default_rng(seed).standard_normal((count, size)))
    return jnp.where(weights > 0, 1 / jnp.where(weights > 0, weights, 1.0), 0.0)[None] * normal


def gram_schmidt(
    rows: Array,
    weights: Array,
) -> tuple[Float[Array, "count size"], Float[Array, " count"]]:
    """Return orthonormal rows by Gram-Schmidt, each projected twice, and the logarithms of their former lengths.

    A row that vanishes has a logarithm of about -354 (the root of the smallest number in double precision). A fixed
    direction, made orthogonal to the earlier rows, replaces it.
    """
    count, size = rows.shape
    # squares up to this number count as zero
    tiny = jnp.finfo(rows.dtype).tiny
    # scalar products use the weighted components
    dual = lambda a: weights[None] ** 2 * a
    spare = fixed_directions(1, count, size, weights)
    basis, logs = [], []
    # each row with its spare direction, which replaces the row where it vanishes
    for row, other in zip(rows, spare, strict=True):
        pair = jnp.stack([row, other])
        if basis:
            before = jnp.stack(basis)
            # two projections are enough for orthogonality up to rounding
            for _ in range(2):
                pair = pair - (dual(pair) @ before.T) @ before
        square, spare_square = jnp.sum(dual(pair) * pair, axis=1)
        vanished, spare_vanished = square <= tiny, ~(spare_square > tiny)
        length = jnp.sqrt(jnp.where(jnp.isfinite(square), jnp.maximum(square, tiny), jnp.nan))
        spare_length = jnp.sqrt(jnp.where(spare_vanished, 1.0, spare_square))
        fresh = jnp.where(spare_vanished, 0.0, pair[1] / spare_length)
        basis.append(jnp.where(vanished, fresh, pair[0] / length))
        logs.append(jnp.log(length))
    return jnp.stack(basis), jnp.stack(logs)


def orthonormalise(
    tangents: PyTree,
    state: PyTree,
    scale: Scale | None = None,
) -> tuple[PyTree, Float[Array, " count"]]:
    """Return tangents made orthonormal at `state`, and the logarithms of their lengths; NaN where the state is not
    finite."""
    flat, unravel = ravel_pytree(state)
    rows = jax.vmap(lambda t: ravel_pytree(t)[0])(tangents)
    rows = jnp.where(jnp.all(jnp.isfinite(flat)), rows, jnp.nan)
    rows, logs = gram_schmidt(rows, weights_of(state, scale))
    return jax.vmap(unravel)(rows), logs


def first_tangents(state: PyTree, count: int, scale: Scale | None = None) -> PyTree:
    """Return `count` orthonormal tangents in fixed random directions; zero in components of weight zero."""
    flat, unravel = ravel_pytree(state)
    directions = fixed_directions(0, count, flat.size, weights_of(state, scale))
    return orthonormalise(jax.vmap(unravel)(directions), state, scale)[0]


def push_tangents(
    step: Step,
    state: PyTree,
    tangents: PyTree,
    intervals: int,
    *,
    index: Real = 0.0,
    scale: Scale | None = None,
) -> tuple[PyTree, PyTree, Float[Array, "intervals count"]]:
    """Propagate orthonormal tangents through `intervals` intervals. Pure; may be used under jit and vmap.

    **Arguments:**

    - `step`, `state`: the system and its initial state.
    - `tangents`: like the state, with a leading axis of length count.
    - `index`: index of the first interval.
    - `scale`: function of a state that returns the weights of its components, like the state or broadcasting to it. A
        component of weight zero does not count in norms; it is propagated and scaled with the rest of its tangent.

    **Returns:** the state and the tangents at the end, and the logarithms of their growth in each interval.
    """

    # out_axes None below: the state at the end is the same for all tangents, and is computed once
    def push(state, tangent, k):
        return jax.jvp(lambda s: step(s, k), (state,), (tangent,))

    def interval(carry, k):
        state, tangents = carry
        state, tangents = jax.vmap(push, in_axes=(None, 0, None), out_axes=(None, 0))(state, tangents, k)
        tangents, logs = orthonormalise(tangents, state, scale)
        return (state, tangents), logs

    # all intervals in one kernel
    run = lambda carry: jax.lax.scan(interval, carry, index + jnp.arange(float(intervals)))
    (state, tangents), history = in_one_kernel(run, (state, tangents))
    return state, tangents, history


def map_spectrum(
    step: Step,
    state: PyTree,
    intervals: int,
    *,
    count: int | None = None,
    transient: int = 0,
    align: int = 0,
    scale: Scale | None = None,
    index: Real = 0.0,
    periods: Real = 1.0,
    period: Real = 1.0,
) -> LyapunovSpectrum:
    """Return the Lyapunov spectrum of a map, or of a flow that `step` integrates.

    Compiled once for each `step`. A new lambda is compiled again; an `equinox.Module` with other values in its arrays
    is not. For many starts, use `jax.jit(jax.vmap(...))` over this function.

    **Arguments:**

    - `step`: `step(state, k)`, the state one interval later. The interval should be so short that no tangent grows
        or shrinks by more than about 1e12 relative to another tangent, and so long that the steps cost more than
        orthonormalising.
    - `state`: a pytree of real numbers.
    - `intervals`: number of intervals that count.
    - `count`: number of exponents, the largest first; default all.
    - `transient`: intervals before the tangents start; `align`: further intervals in which the tangents align with
        their directions. Both do not count.
    - `scale`: weights of the components, see `push_tangents`.
    - `index`: index of the first interval.
    - `periods`: periods in an interval; `period`: length of a period [s].

    **Returns:** a `LyapunovSpectrum`.

    **Raises:** `ValueError` that names the wrong argument.
    """
    intervals = whole("intervals", intervals, 1)
    align = whole("align", align, 0)
    transient = whole("transient", transient, 0)
    index = finite("index")(index)
    periods = positive("periods")(periods)
    period = positive("period", "s")(period)
    with checked_system(step, state, scale, index) as first:
        size = sum(leaf.size for leaf in jax.tree.leaves(first))
        count = size if count is None else whole("count", count, 1)
        require(count <= size, "count", f"be at most {size}, the size of the state", count)
        # As an argument of the program, any transient runs without a new compilation; reverse mode needs a constant.
        fixed = transient if is_traced((step, first)) else None
        settings = count, align, intervals, transient > 0, fixed
        history, state, tangents = call_compiled(_spectrum, (step, scale), settings, first, index, transient)
    return LyapunovSpectrum(history, state, tangents, periods, period)


def _spectrum(functions, static, state, index, transient):
    """Return the history after the intervals of alignment, and the state and tangents at the end."""
    step, scale = functions
    count, align, intervals, runs, fixed = static
    if runs:
        most = transient if fixed is None else fixed
        run = lambda state: jax.lax.fori_loop(0, most, lambda i, s: step(s, index + i), state)
        state = in_one_kernel(run, state)
    tangents = first_tangents(state, count, scale)
    begin = index + transient
    state, tangents, history = push_tangents(step, state, tangents, align + intervals, index=begin, scale=scale)
    return history[align:], state, tangents


@contextmanager
def checked_system(step: Step, state: PyTree, scale: Scale | None = None, index: Real = 0.0) -> Iterator[PyTree]:
    """Yield `state` as arrays of floats, for a computation with a system.

    **Raises:** `ValueError` unless `state` is a pytree of finite real numbers, `step` a function, and `scale` a
    function or None; or where the computation fails because `step` returns another kind of state than it gets.
    """
    require(callable(step), "step", "be a function", step)
    require(scale is None or callable(scale), "scale", "be a function", scale)
    require(jax.tree.leaves(state), "state", "be a pytree of real numbers", state)
    state = jax.tree.map(lambda leaf: finite("state")(check_real("state", leaf)), state)
    failure = None
    try:
        yield state
    except TypeError as error:
        failure = error
    # only after a failure, because this traces `step` once more
    if failure is not None:
        end = jax.eval_shape(lambda s, k: step(s, k), state, index)
        kinds = lambda tree: jax.tree.map(lambda leaf: f"{leaf.dtype}{list(leaf.shape)}", tree)
        shown = lambda tree: brief(kinds(tree)).replace("'", "")
        need = f"be like the state that `step` returns, {shown(end)}"
        require(kinds(end) == kinds(state), "state", need, shown=shown(state))
        raise failure


def check_real(name: str, value: object) -> Any:
    """Return a value; raise `ValueError` for complex numbers, because tangents and distances would lose a part."""
    require(not np.iscomplexobj(value), name, "be real: of complex numbers take real and imaginary parts", value)
    return value


SURE = 3.0
"""Number of standard errors by which a positive exponent must exceed zero."""
LEAST = 1e-3
"""Exponents up to this count as zero [1/period]."""


def is_chaotic(exponent: Numbers, stderr: Numbers) -> np.ndarray:
    """Return whether a largest Lyapunov exponent [1/period] exceeds both `SURE` standard errors and `LEAST`."""
    return np.asarray(np.asarray(exponent) > np.maximum(SURE * np.asarray(stderr), LEAST))


def is_sure(exponent: Numbers, stderr: Numbers) -> np.ndarray:
    """Return whether the sign of a largest Lyapunov exponent is known, or its value to 0.01 [1/period]."""
    exponent, stderr = np.asarray(exponent), np.asarray(stderr)
    return np.asarray(is_chaotic(exponent, stderr) | (SURE * stderr <= np.maximum(np.abs(exponent), 0.01)))


def regime(
    exponent: Numbers, stderr: Numbers, kind: Sequence[str] | np.ndarray, trusted: Numbers, escapes: Numbers | int = 0
) -> np.ndarray:
    """Return the regime of each case, one of `slipperjax.analysis.REGIMES`.

    A case is unresolved where it is not trusted, where exponent and recurrence contradict each other, and where the
    exponent is neither positive nor known well enough to count as zero or negative.

    **Arguments:** `exponent`, `stderr`: the largest exponent and its standard error [1/period]; `kind`: of
    `Attractors`; `trusted`: whether status and certificates are good; `escapes`: number of longer motions that were
    chaotic at first and regular at the end. All have the same shape.
    """
    exponent = numbers("exponent", exponent)
    stderr = numbers("stderr", stderr)
    trusted = numbers("trusted", trusted)
    escapes = numbers("escapes", escapes)
    kind = np.asarray(kind)
    chaotic = is_chaotic(exponent, stderr)
    periodic = kind == Regime.PERIODIC.kind_name
    contradicts = (chaotic & periodic) | (~chaotic & (kind == Regime.CHAOTIC.kind_name))
    # chaos that some longer motions have left
    lasting = np.where(escapes > 0, Regime.TRANSIENT, Regime.CHAOTIC)
    codes = np.where(chaotic, lasting, np.where(periodic, Regime.PERIODIC, Regime.REGULAR))
    good = trusted.astype(bool) & np.isfinite(exponent) & is_sure(exponent, stderr) & ~contradicts
    return Regime.regime_names(np.where(good, codes, Regime.UNRESOLVED))


def kaplan_yorke(exponents: Numbers) -> Float[np.ndarray, "*lanes"]:
    """Return Kaplan-Yorke dimensions from exponents along the last axis, in any order and unit
    (doi:10.1007/BFb0064319).

    0 where all exponents are negative; the number of exponents, a lower bound, where their sum is positive. An
    exponent whose exact value is zero is used as measured: the dimension of a limit cycle of an ODE is 1 for a
    measured +1e-9, and 0 for -1e-9.
    """

    def dimension(spectrum):
        falling = np.sort(spectrum)[::-1]
        count = _spanned(falling)
        if np.isnan(falling).any():
            return np.nan
        if count in (0, len(falling)):
            return float(count)
        return count - falling[:count].sum() / falling[count]

    return np.apply_along_axis(dimension, -1, numbers("exponents", exponents, 1))


def _spanned(falling: np.ndarray) -> int:
    """Return the greatest number of exponents, the largest first, whose sum is not negative."""
    return int(np.sum(np.cumsum(falling) >= 0))


def dimension_standard_error(history: Numbers) -> Float[np.ndarray, "*lanes"]:
    """Return the standard error of the Kaplan-Yorke dimension from the record of one motion's exponents.

    Let l < 0 be the exponent at which the sum becomes negative, and S the sum of the k exponents before it. The
    dimension is k - S / l. Its change by each exponent of an interval makes a record of its own, with an error by
    `one_motion_standard_error`. This error includes what the exponents' errors have in common: it is smaller where
    S + l is constant, as for a constant divergence. It is 0 where all exponents are negative or their sum is
    positive, because the dimension is a whole number then.

    **Arguments:** `history`: exponents of the intervals, shape (*lanes, intervals, count), in any unit.
    """

    def error(record):
        falling = record[:, np.argsort(-record.mean(axis=0))]
        spectrum = falling.mean(axis=0)
        count = _spanned(spectrum)
        if np.isnan(spectrum).any():
            return np.nan
        if count in (0, len(spectrum)):
            return 0.0
        last = spectrum[count]
        change = -falling[:, :count].sum(axis=1) / last + falling[:, count] * spectrum[:count].sum() / last**2
        return one_motion_standard_error(change[:, None])[0]

    history = numbers("history", history, 2)
    lanes = history.shape[:-2]
    return np.array([error(record) for record in history.reshape(-1, *history.shape[-2:])]).reshape(lanes)


def weighted_mean(history: Numbers) -> Float[np.ndarray, "*lanes count"]:
    """Return the mean over the axis before the last, with weights exp(-1 / (t (1 - t))) that vanish at both ends.

    For a regular motion the local exponents are a quasi-periodic series. The error of the plain mean falls as the
    reciprocal of its length; the error of this mean falls faster than any power of it (doi:10.1088/1361-6544/aa84c2).
    For chaos it is as accurate as a plain mean over about half of the record.

    **Arguments:** `history`: shape (*lanes, intervals, count).
    """
    history = numbers("history", history, 2)
    # times of the intervals' middles over the length of the record
    t = (np.arange(history.shape[-2]) + 0.5) / history.shape[-2]
    weights = np.exp(-1 / (t * (1 - t)))
    return np.einsum("k,...kc->...c", weights / weights.sum(), history)


def standard_error(history: Numbers) -> Float[np.ndarray, "*lanes count"]:
    """Return the standard error of the mean over the axis before the last, allowing for autocorrelation.

    Means over 100 to 199 blocks remove most of the correlation, of any length and kind (doi:10.1063/1.457480). An
    autoregression of these means, of the order that minimises Akaike's criterion, accounts for the remaining
    correlation by its spectral density at frequency zero. Local exponents are mostly anticorrelated, because parts
    that depend on the position alone cancel from one interval to the next; block means alone would overestimate the
    error. For an exponent that has only such parts, like the zero exponent of a flow, the result is too large by a
    factor of about two. NaN below 8 intervals.

    **Arguments:** `history`: shape (*lanes, intervals, count).
    """
    history = numbers("history", history, 2)
    if history.shape[-2] < 8:
        return np.full(history.shape[:-2] + history.shape[-1:], np.nan)
    # number of blocks: 100 to 199, or the number of intervals where this is less
    n = history.shape[-2] // max(1, history.shape[-2] // 100)
    means = _means_of_parts(history, n)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        x = means - means.mean(axis=-2, keepdims=True)
        # highest order of the autoregressions
        top = min(int(10 * np.log10(n)), n // 4)
        covariance = [np.sum(x[..., lag:, :] * x[..., : n - lag, :], axis=-2) / n for lag in range(top + 1)]
        noise = covariance[0]
        weights = []
        densities = [noise * n / (n - 1)]
        criteria = [n * np.log(noise)]
        # autoregressions of rising order, by the recursion of Levinson and Durbin
        for order in range(1, top + 1):
            predicted = sum(w * covariance[order - 1 - lag] for lag, w in enumerate(weights))
            last = (covariance[order] - predicted) / noise
            weights = [w - last * v for w, v in zip(weights, weights[::-1], strict=True)] + [last]
            noise = noise * (1 - last**2)
            densities.append(noise * n / (n - order - 1) / (1 - sum(weights)) ** 2)
            criteria.append(n * np.log(noise) + 2 * order)
        # each exponent has its own best order
        best = np.argmin(np.stack(criteria), axis=0)[None]
        density = np.take_along_axis(np.stack(densities), best, axis=0)[0]
    return np.sqrt(np.where(covariance[0] == 0, 0.0, density) / n)


def one_motion_standard_error(history: Numbers) -> Float[np.ndarray, "*lanes count"]:
    """Return the standard error of the mean of one motion's record, including changes as slow as the record.

    It combines two estimates in quadrature. The first is the greatest of three errors: `standard_error`, and the
    errors from the scatter of the record's quarters and of its eighths; the scatter is greater where correlation is
    longer than the blocks (doi:10.1063/1.457480). The second is the standard deviation of the straight line through
    the eighths, for changes slower than the record. For records that show all of their correlation the result is 1.4
    to 1.7 times the true error. No record shows changes that take several times its length.

    **Arguments:** `history`: shape (*lanes, intervals, count).
    """
    history = numbers("history", history, 2)
    within = standard_error(history)
    if history.shape[-2] < 8:
        return within
    eighths = _means_of_parts(history, 8)
    quarters = _means_of_parts(history, 4)
    blocks = np.max([within, _scatter(quarters), _scatter(eighths)], axis=0)
    # change along the straight line through the eighths, from the start of the record to its end
    place = (np.arange(8) - 3.5)[:, None]
    change = 8 * np.sum(place * eighths, axis=-2) / np.sum(place**2)
    return np.hypot(blocks, change / np.sqrt(12))


def _means_of_parts(history: np.ndarray, parts: int) -> np.ndarray:
    """Return the means of the record in parts of equal length, of shape (*lanes, parts, count).

    Remaining intervals at the start do not count.
    """
    length = history.shape[-2] // parts
    used = history[..., history.shape[-2] - parts * length :, :]
    return used.reshape(*history.shape[:-2], parts, length, history.shape[-1]).mean(axis=-2)


def _scatter(means: np.ndarray) -> np.ndarray:
    """Return the standard error of the mean of independent numbers, along the axis before the last."""
    return means.std(axis=-2, ddof=1) / np.sqrt(means.shape[-2])


def pooled_standard_error(history: Numbers) -> Float[np.ndarray, "*lanes count"]:
    """Return the standard error of the mean over several independent motions on one attractor.

    It is the larger of two estimates. The first is `standard_error` within the motions. The second is the scatter of
    the means of their halves about the mean of all, which contains drift and correlations as long as a motion's
    record; for 500 forcing periods of a chaotic slipper it can be twice the first.

    **Arguments:** `history`: local exponents, shape (*lanes, motions, intervals, count).
    """
    history = numbers("history", history, 3)
    motions, intervals, count = history.shape[-3:]
    within = np.sqrt(np.mean(standard_error(history) ** 2, axis=-2) / motions)
    if intervals < 8:
        return within
    means = _means_of_parts(history, 2)
    return np.maximum(within, _scatter(means.reshape(*history.shape[:-3], 2 * motions, count)))
