"""Sums over one axis fused into one pass, and values stored so that XLA does not recompute them.

XLA on a CPU computes five sums of products of one force by computing that force five times, once inside each
sum. One reduction of five operands computes it once. JAX defines no transpose of that reduction, and its derivative
is far too slow. Here the reduction is a linear primitive, so that its derivatives in forward mode and reverse mode
and its batched version are one-pass reductions or broadcasts, too.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

_sums_p = Primitive("slipperjax_sums")
_sums_p.multiple_results = True


def sums(*operands):
    """Sum of each operand over its last axis; the operands share one shape.

    **Arguments:** arrays of shape `(*batch, n)` and of one floating-point type.

    **Returns:** a list with one array of shape `batch` per operand.
    """
    return _sums_p.bind(*operands)


def materialise(tree):
    """The same values, computed in one kernel and stored.

    XLA recomputes an elementwise value in every kernel that uses it, which multiplies the work of an unrolled
    elimination, but never recomputes a reduction. So this is a reduction over two entries, one of which is zero.

    **Arguments:** a pytree of floating-point arrays that broadcast to one shape. **Returns:** the same values,
    broadcast to that shape.
    """
    scalars, structure = jax.tree.flatten(tree)
    once = {id(x): x for x in scalars}  # leaves that occur twice are computed once
    shape = jnp.broadcast_shapes(*(jnp.shape(x) for x in once.values()))
    wide = (*shape, 2)
    first = jnp.broadcast_to(np.array([True, False]), wide)
    nothing = jnp.zeros(wide)
    # Plain lax operations keep tracing short: this is called very often.
    spread = lambda x: lax.broadcast_in_dim(jnp.broadcast_to(jnp.asarray(x, float), shape), wide, range(len(shape)))
    stored = sums(*(lax.select(first, spread(x), nothing) for x in once.values()))
    found = dict(zip(once, stored, strict=True))
    return jax.tree.unflatten(structure, [found[id(x)] for x in scalars])


def _implementation(*operands):
    zeros = tuple(jnp.zeros((), x.dtype) for x in operands)
    return list(lax.reduce(operands, zeros, _add, (operands[0].ndim - 1,)))


def _add(a, b):
    # named, because JAX keeps the compiled reduction of eager calls by this function
    return tuple(x + y for x, y in zip(a, b, strict=True))


def _jvp(primals, tangents):
    tangents = [ad.instantiate_zeros(t) for t in tangents]
    return _sums_p.bind(*primals), _sums_p.bind(*tangents)


def _transpose(cotangents, *operands):
    out = []
    for cotangent, operand in zip(cotangents, operands, strict=True):
        if not ad.is_undefined_primal(operand):
            out.append(None)
        elif type(cotangent) is ad.Zero:
            out.append(ad.Zero(operand.aval))
        else:
            out.append(jnp.broadcast_to(cotangent[..., None], operand.aval.shape))
    return out


def _batch(operands, axes):
    size = next(x.shape[a] for x, a in zip(operands, axes, strict=True) if a is not batching.not_mapped)
    moved = [
        jnp.broadcast_to(x, (size, *x.shape)) if a is batching.not_mapped else jnp.moveaxis(x, a, 0)
        for x, a in zip(operands, axes, strict=True)
    ]
    return _sums_p.bind(*moved), [0] * len(moved)


_sums_p.def_impl(_implementation)
_sums_p.def_abstract_eval(lambda *avals: [a.update(shape=a.shape[:-1]) for a in avals])
ad.primitive_jvps[_sums_p] = _jvp
ad.primitive_transposes[_sums_p] = _transpose
batching.primitive_batchers[_sums_p] = _batch
mlir.register_lowering(_sums_p, mlir.lower_fun(_implementation, multiple_results=True))


@jax.custom_jvp
def kept(tree):
    """The same values, which are stored, as `materialise` does, where they are differentiated."""
    return tree


@kept.defjvp
def _kept_jvp(primals, tangents):
    return materialise(primals[0]), materialise(tangents[0])
