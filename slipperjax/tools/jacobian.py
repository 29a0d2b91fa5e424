"""Reverse mode by Jacobians of forward mode, for functions of few numbers.

Reverse mode through the steps of an integration is a program of three times the size of forward mode's, which takes
as much longer to compile. Where few numbers are differentiated, the product with a Jacobian is the same derivative.
"""

import functools
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Primitive, Var, jaxpr_as_fun, set_current_trace
from jax.interpreters import ad, batching, mlir, partial_eval

from .compile import split_arrays

MOST_FORWARD = 16
"""Numbers up to which a derivative in reverse mode is a product with the Jacobian.

Over three periods of 100 steps that takes half as long as reverse mode by one number, 1.6 times by 10 and 3.8
times by 30; to compile, half as long by any.
"""


def by_jacobian(fun: Callable, *args: Any) -> Any:
    """Call `fun(*args)`, whose derivatives in reverse mode are products with its Jacobian by forward mode.

    So they are where `MOST_FORWARD` numbers are differentiated at most, those that `fun` closes over included, and
    it is not called for a batch; elsewhere reverse mode goes through `fun`.

    **Arguments:** `fun`: of pytrees, whose result is a pytree of arrays.
    """
    call, arrays = split_arrays(fun, args)
    program, shapes = jax.make_jaxpr(call, return_shape=True)(arrays)
    results = _called.bind(*_operands(program), *jax.tree.leaves(arrays), program=program.jaxpr)
    return jax.tree.unflatten(jax.tree.structure(shapes), results)


def _operands(program: ClosedJaxpr) -> list[Any]:
    """Return what a traced function closed over, which may be traced itself."""
    return [jnp.asarray(value) for value in program.consts]


def _call(*operands: Any, program: Any) -> list[Any]:
    count = len(program.constvars)
    closed = ClosedJaxpr(program, operands[:count])
    return jaxpr_as_fun(closed)(*operands[count:])


def _is_float(value: Any) -> bool:
    return jnp.issubdtype(value.dtype, jnp.floating)


def _push(*operands: Any, program: Any, live: tuple[bool, ...]) -> tuple[list[Any], list[Any]]:
    """Return results, and tangents of those that are numbers, from arguments and tangents of the `live` ones."""
    primals = operands[: len(live)]
    tangents = operands[len(live) :]

    def moving(*some):
        # the arguments that are differentiated, among the others
        of_live = iter(some)
        every = [next(of_live) if is_live else p for p, is_live in zip(primals, live, strict=True)]
        results = _call(*every, program=program)
        return [r for r in results if _is_float(r)], results

    _, pushed, results = jax.jvp(moving, _of_live(primals, live), tangents, has_aux=True)
    return results, pushed


def _push_flat(*operands: Any, **parameters: Any) -> list[Any]:
    results, pushed = _push(*operands, **parameters)
    return [*results, *pushed]


def _of_live(values: Sequence[Any], live: tuple[bool, ...]) -> tuple[Any, ...]:
    return tuple(value for value, is_live in zip(values, live, strict=True) if is_live)


def _linearised(
    operands: Sequence[Any],
    live: tuple[bool, ...],
    program: Any,
) -> tuple[list[Any], list[list[Any]]]:
    """Return results and Jacobians: of each result that is a number, by each of the `live` arguments."""
    at = _of_live(operands, live)
    sizes = [math.prod(p.shape) for p in at]
    ends = np.cumsum(sizes)
    # places of each argument in the vector of all numbers
    parts = [(slice(end - size, end), p) for end, size, p in zip(ends, sizes, at, strict=True)]

    def pushed(direction):
        directions = [direction[where].reshape(p.shape).astype(p.dtype) for where, p in parts]
        return _push(*operands, *directions, program=program, live=live)

    def split(jacobian):
        return [jacobian[where].reshape(*p.shape, *jacobian.shape[1:]) for where, p in parts]

    results, jacobians = jax.vmap(pushed, out_axes=(None, 0))(jnp.eye(int(ends[-1])))
    return results, [split(jacobian) for jacobian in jacobians]


def _jvp(primals, tangents, *, of: Primitive, **parameters):
    """Rule of both primitives: the second one pushes the tangents of a function that calls the one `of`."""
    operands = list(primals)
    program = parameters["program"]
    if of is _pushed:
        closed = jax.make_jaxpr(functools.partial(_push_flat, **parameters))(*primals)
        program = closed.jaxpr
        operands = [*_operands(closed), *primals]
        tangents = [None] * len(closed.consts) + list(tangents)
    live = tuple(t is not None and type(t) is not ad.Zero for t in tangents)
    both = _pushed.bind(*operands, *_of_live(tangents, live), program=program, live=live)
    count = len(program.outvars)
    pushed = iter(both[count:])
    moved = []
    # whole numbers among the results have no tangent
    for r in both[:count]:
        moved.append(next(pushed) if _is_float(r) else ad.Zero(jax.typeof(r).to_tangent_aval()))
    return both[:count], moved


def _batched(operands, axes, **parameters):
    """Rule of both primitives: reverse mode goes through a batch."""
    live = parameters.get("live", ())
    count = len(live) if live else len(operands)
    if any(axis is not None for axis in axes[:count]):
        of = _push_flat if live else _call
        results = jax.vmap(functools.partial(of, **parameters), in_axes=axes)(*operands)
        return results, [0] * len(results)
    # only tangents are a batch: all its lanes have the same results
    push = lambda *tangents: _push(*operands[:count], *tangents, **parameters)
    results, pushed = jax.vmap(push, in_axes=axes[count:], out_axes=(None, 0))(*operands[count:])
    return [*results, *pushed], [None] * len(results) + [0] * len(pushed)


def _evaluated_partially(trace, *tracers, program, live):
    """Rule of pushed tangents: the results are known, and tangents will be."""
    known = [t.pval.get_known() for t in tracers]
    if all(k is not None for k in known):
        return _pushed.bind(*known, program=program, live=live)
    count = len(live)
    size = sum(math.prod(t.aval.shape) for t in tracers[count:])
    if any(k is None for k in known[:count]) or size > MOST_FORWARD:
        with set_current_trace(trace):
            return _push_flat(*tracers, program=program, live=live)
    results, jacobians = _linearised([jnp.asarray(k) for k in known[:count]], live, program)
    with set_current_trace(trace):
        return [*results, *(_product(row, tracers[count:]) for row in jacobians)]


def _evaluated_twice(saveable, unknown, instantiated, equation):
    """The same rule inside `jax.checkpoint`: results are known, and are computed again with the tangents."""
    program = equation.params["program"]
    count = len(equation.params["live"])
    results = len(program.outvars)
    # values that the later computation needs
    needed = [
        x
        for x, there in zip(
            equation.invars,
            instantiated,
            strict=True,
        )
        if isinstance(x, Var) and not there
    ]
    known = equation
    later = [False] * len(equation.outvars)
    if any(unknown[:count]):
        known = None
        later = [True] * len(equation.outvars)
    elif any(unknown):
        # the results now, their tangents later
        of_results = dict(invars=equation.invars[:count], outvars=equation.outvars[:results])
        known = equation.replace(primitive=_called, params={"program": program}, **of_results)
        later[results:] = [True] * (len(later) - results)
    return known, equation, later, [True] * len(later), needed


def _product(row: list[Any], tangents: Sequence[Any]) -> Any:
    """Return a result's tangent from its Jacobians by the arguments, whose axes are the first, and their tangents."""
    return sum(jnp.tensordot(t, j, axes=jnp.ndim(t)) for j, t in zip(row, tangents, strict=True))


def _primitive(name: str, implementation: Callable, avals: Callable) -> Primitive:
    primitive = Primitive(name)
    primitive.multiple_results = True
    primitive.def_impl(implementation)
    primitive.def_abstract_eval(lambda *operands, **parameters: avals(parameters["program"]))
    ad.primitive_jvps[primitive] = functools.partial(_jvp, of=primitive)
    batching.primitive_batchers[primitive] = _batched
    mlir.register_lowering(primitive, mlir.lower_fun(implementation, multiple_results=True))
    return primitive


def _results(program):
    return [v.aval for v in program.outvars]


def _results_and_tangents(program):
    results = _results(program)
    return [*results, *(r for r in results if _is_float(r))]


_called = _primitive("slipperjax_called", _call, _results)
_pushed = _primitive("slipperjax_pushed", _push_flat, _results_and_tangents)
partial_eval.custom_partial_eval_rules[_pushed] = _evaluated_partially
partial_eval.partial_eval_jaxpr_custom_rules[_pushed] = _evaluated_twice


@jax.custom_jvp
def moving_with(state: Any, numbers: Any) -> Any:
    """Return `state`, which has tangents where `numbers` have, and is a batch where their tangents are one.

    A loop that carries it on is traced once then: JAX would find out by further traces, one for each loop in a loop.
    """
    return state


@moving_with.defjvp
def _moving_with_jvp(primals, tangents):
    state, numbers = tangents
    nothing = 0.0 * sum(jnp.sum(t) for t in jax.tree.leaves(numbers) if t.dtype != jax.dtypes.float0)
    return primals[0], jax.tree.map(lambda t: t if t.dtype == jax.dtypes.float0 else t + nothing, state)
