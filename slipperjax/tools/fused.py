"""Sums over one axis fused into one pass, and values stored so that XLA does not recompute them.

On a CPU XLA computes five sums of products of one force by computing the force five times, once inside each sum. One
reduction of five operands computes the force once. JAX defines no transpose of such a reduction, and its derivative
is far too slow. Here the reduction is a linear primitive; so are its transpose, a broadcast, and the storing of
values. Derivatives in both modes are again such operations on all operands at once. Separate operations would each
compute again what the operands have in common, and programs of derivatives would be five times as long.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.extend.core import Primitive
from jax.extend.mlir import ir
from jax.extend.mlir.dialects import func
from jax.interpreters import ad, batching, mlir


def sums(*operands):
    """Return the sum of each operand over its last axis; all operands have one shape.

    **Arguments:** arrays of shape `(*batch, n)` and of one floating-point type.

    **Returns:** a list with one array of shape `batch` per operand.
    """
    return _sums.bind(*operands)


def spread(n: int, *scalars):
    """Repeat each value along a new last axis of length n, which is the transpose of `sums`.

    **Returns:** a list with one array of shape `(*batch, n)` per value, where `batch` is the shape to which all of
    them broadcast.
    """
    return _spread.bind(*jnp.broadcast_arrays(*(jnp.asarray(x, float) for x in scalars)), n=n)


def store(tree):
    """Return the same values, each computed once and stored.

    XLA computes an elementwise value again in each kernel that uses it. This multiplies the work where many kernels
    use a value, as in an elimination without loops.

    **Arguments:** a pytree of floating-point arrays. **Returns:** the same values.
    """
    return _of_leaves(_stored, tree)


def _of_leaves(primitive: Primitive, tree):
    """Call a primitive on a pytree's leaves, together for leaves of one shape; a repeated leaf is passed once."""
    leaves, structure = jax.tree.flatten(tree)
    once = {id(x): jnp.asarray(x, float) for x in leaves}
    of = {}
    for shape in dict.fromkeys(jnp.shape(x) for x in once.values()):
        alike = {key: x for key, x in once.items() if jnp.shape(x) == shape}
        of |= zip(alike, primitive.bind(*alike.values()), strict=True)
    return jax.tree.unflatten(structure, [of[id(x)] for x in leaves])


def store_cotangent(tree):
    """Return the same values, and store their cotangents: reverse mode computes each once for all inputs."""
    return _of_leaves(_with_stored_cotangents, tree)


def _linear(name: str, implementation: Callable, shape: Callable, transpose: Callable) -> Primitive:
    """Return a linear primitive of operands of one shape; each operand has one result that depends on it alone.

    **Arguments:** `shape`: gives a result's shape from an operand's; `transpose`: gives the operands' cotangents from
    the results' cotangents and the operands' shape. Operands without tangent or cotangent are left out.
    """
    primitive = Primitive(name)
    primitive.multiple_results = True

    def jvp(primals, tangents, **parameters):
        results = primitive.bind(*primals, **parameters)
        # symbolic zeros: nothing is computed for them
        out = [ad.Zero(jax.typeof(x).to_tangent_aval()) for x in results]
        # only operands that have a tangent
        live = [k for k, t in enumerate(tangents) if type(t) is not ad.Zero]
        if live:
            pushed = primitive.bind(*(tangents[k] for k in live), **parameters)
            for k, t in zip(live, pushed, strict=True):
                out[k] = t
        return results, out

    def transposed(cotangents, *operands, **parameters):
        # JAX expects None for the operands that are known, in which the result is not linear
        out: list[jax.Array | ad.Zero | None] = [
            ad.Zero(x.aval) if ad.is_undefined_primal(x) else None for x in operands
        ]
        # only operands whose cotangent is needed and is not zero
        live = [k for k, zero in enumerate(out) if zero is not None and type(cotangents[k]) is not ad.Zero]
        if live:
            pulled = transpose([cotangents[k] for k in live], operands[live[0]].aval.shape)
            for k, c in zip(live, pulled, strict=True):
                out[k] = c
        return out

    def batch(operands, axes, **parameters):
        size = next(x.shape[a] for x, a in zip(operands, axes, strict=True) if a is not None)
        # the axis of cases becomes the first axis of all operands, so that they have one shape again
        moved = [batching.bdim_at_front(x, a, size) for x, a in zip(operands, axes, strict=True)]
        return primitive.bind(*moved, **parameters), [0] * len(moved)

    def avals_of_results(*avals, **parameters):
        return [a.update(shape=shape(a.shape, **parameters)) for a in avals]

    primitive.def_impl(implementation)
    primitive.def_abstract_eval(avals_of_results)
    ad.primitive_jvps[primitive] = jvp
    ad.primitive_transposes[primitive] = transposed
    batching.primitive_batchers[primitive] = batch
    mlir.register_lowering(primitive, mlir.lower_fun(implementation, multiple_results=True))
    return primitive


def _summed(*operands):
    zeros = tuple(jnp.zeros((), x.dtype) for x in operands)
    return list(lax.reduce(operands, zeros, _add, (operands[0].ndim - 1,)))


def _add(a, b):
    # a named function, because JAX finds the compiled reduction of eager calls by it
    return tuple(x + y for x, y in zip(a, b, strict=True))


def _repeated(*operands, n):
    return [lax.broadcast_in_dim(x, (*x.shape, n), range(x.ndim)) for x in operands]


def _reduced(*operands):
    """Store on any backend: XLA never computes a sum again, here the sum of the value and a zero."""
    # a selection keeps NaN and infinity out of the zero; a product with (1, 0) would not
    twice = _repeated(*operands, n=2)
    shape = twice[0].shape
    first = jnp.broadcast_to(np.array([True, False]), shape)
    nothing = jnp.zeros(shape)
    return _summed(*(lax.select(first, x, nothing) for x in twice))


def _passed_on(context, *operands):
    """Store on a CPU: call a function that returns its arguments, and that XLA does not inline.

    LLVM gets about four instructions for each value, and fifty with the reduction.
    """
    # one function for each call; the symbol table gives each its own name
    types = [x.type for x in operands]
    module = context.module_context
    with ir.InsertionPoint.at_block_begin(module.module.body):
        function = func.FuncOp("stored", ir.FunctionType.get(types, types), visibility="private")
        with ir.InsertionPoint(function.add_entry_block()):
            func.ReturnOp(list(function.entry_block.arguments))
    module.symbol_table.insert(function)
    call = func.CallOp(types, ir.FlatSymbolRefAttr.get(function.name.value), operands)
    mark = ir.DictAttr.get({"inlineable": ir.StringAttr.get("false")})
    call.operation.attributes["mhlo.frontend_attributes"] = mark
    return list(call.results)


# each primitive is the transpose of the other
_sums = _linear(
    "slipperjax_sums",
    _summed,
    shape=lambda of_operand: of_operand[:-1],
    transpose=lambda cotangents, of_operand: _spread.bind(*cotangents, n=of_operand[-1]),
)
_spread = _linear(
    "slipperjax_spread",
    _repeated,
    shape=lambda of_operand, n: (*of_operand, n),
    transpose=lambda cotangents, of_operand: _sums.bind(*cotangents),
)
_stored = _linear(
    "slipperjax_stored",
    _reduced,
    shape=lambda of_operand: of_operand,
    transpose=lambda cotangents, of_operand: _stored.bind(*cotangents),
)
_with_stored_cotangents = _linear(
    "slipperjax_stored_cotangents",
    lambda *operands: list(operands),
    shape=lambda of_operand: of_operand,
    transpose=lambda cotangents, of_operand: _stored.bind(*cotangents),
)

mlir.register_lowering(_stored, _passed_on, platform="cpu")


@jax.custom_jvp
def store_if_differentiated(tree):
    """Return the same values; where they are differentiated, they are stored as `store` does."""
    return tree


@store_if_differentiated.defjvp
def _store_if_differentiated_jvp(primals, tangents):
    return store(primals[0]), store(tangents[0])


@jax.custom_jvp
def circle(angle):
    """Return cosine and sine of an angle [rad], stored, so that derivatives of all orders use the stored values."""
    return store((jnp.cos(angle), jnp.sin(angle)))


@circle.defjvp
def _circle_jvp(primals, tangents):
    cosine, sine = circle(*primals)
    return (cosine, sine), (-sine * tangents[0], cosine * tangents[0])
