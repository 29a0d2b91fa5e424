"""Parts of a program that XLA compiles to one kernel on a CPU, their loops included.

By default XLA starts each of the some hundred kernels in a step of an integration on its own, which takes longer than
a batch of 30 cases needs to compute. A call that it must not inline and that bears the attribute `xla_cpu_small_call`
becomes one kernel; no other program of the process is changed by it.

The part is a `jax.jit` inside the program, whose rules for derivatives and batches are JAX's own. Its results pass
through a primitive that does nothing but set the attributes on the call which they come from, when the program is
lowered. The transpose of that primitive is one for arguments and vice versa, so that calls of reverse mode are marked
by what are their results.
"""

import math
from collections.abc import Callable

import jax
from jax.extend.core import Primitive
from jax.extend.mlir import ir
from jax.extend.mlir.dialects import stablehlo
from jax.interpreters import ad, batching, mlir
from jaxtyping import PyTree

from .notices import note_compiling
from .tracing import split_arrays

ATTRIBUTES = "mhlo.frontend_attributes"
"""Name by which XLA finds the attributes of a call."""
LARGEST = 32 << 10
"""Numbers of an only result from which on there is no kernel; with twice as many some could not be compiled."""


def in_one_kernel(fun: Callable, *args: PyTree) -> PyTree:
    """Call `fun(*args)`: on a CPU one kernel of the compiled program, unless a LAPACK call, scatter or sort is in it,
    or its only result is an array of `LARGEST`.

    **Arguments:** `fun`: of pytrees, whose result is a pytree of arrays.
    """
    note_compiling()
    call, arrays = split_arrays(fun, args)
    # a traced value that the function closes over must be an argument of the call, too
    of_arrays, closed_over = jax.closure_convert(call, arrays)
    # Of the call that becomes the kernel XLA finds only those arguments in memory that an operation inside it has as
    # operands, and fails where one is without use. Those of a second call inside it are all operands. Derivatives
    # leave the outermost of several calls with arguments that the next one does not get: then that one is the kernel.
    # The last one is the whole program where the function is called outside of any.
    kernel = _called(_called(of_arrays, kernel=False), kernel=True)
    return jax.jit(_called(kernel, kernel=True))(arrays, *closed_over)


def _called(fun: Callable, kernel: bool) -> Callable:
    """Return a function that calls `fun` by a call that XLA does not inline, and compiles as a kernel if asked to."""
    inner = jax.jit(fun)

    def call(*args: PyTree) -> PyTree:
        # The marks on results lead the lowering to the call. Those on arguments are results of the transposed call.
        args = jax.tree.map(lambda x: _argument.bind(x, kernel=kernel), args)
        return jax.tree.map(lambda x: _result.bind(x, kernel=kernel), inner(*args))

    return call


def _mark(context: mlir.LoweringRuleContext, x: ir.Value, kernel: bool) -> list[ir.Value]:
    """Set the attributes on the call that a value comes from, once; empty ones where it cannot be a kernel."""
    call = getattr(x.owner, "operation", x.owner)
    # another result of the call may have marked it; after transformations a value may come from elsewhere
    if getattr(call, "name", "") != "func.call" or ATTRIBUTES in call.attributes:
        return [x]
    marks = {"inlineable": ir.StringAttr.get("false")}
    if kernel:
        functions = context.module_context.symbol_table
        inside = _operations(_callee(call), functions, set())
        if _only_calls(call, functions) and all(map(_fits, inside)):
            marks["xla_cpu_small_call"] = ir.StringAttr.get("true")
            _hide_constants(call)
            _hide_from_library(inside)
        else:
            marks = {}
    call.attributes[ATTRIBUTES] = ir.DictAttr.get(marks)
    return [x]


def _hide_constants(call: ir.Operation) -> None:
    """Pass the operands of a call through a barrier.

    XLA would fold constants into the called function, whose arguments would have no use then, so that it fails.
    """
    with ir.InsertionPoint(call), call.location:
        barrier = stablehlo.OptimizationBarrierOp(list(call.operands))
    for k, value in enumerate(barrier.operation.results):
        call.operands[k] = value


def _hide_from_library(operations: list[ir.Operation]) -> None:
    """Rewrite products of matrices, and large sums and extremes, so that XLA does not recognise them.

    Since JAX 0.11 it computes those it recognises by a library (YNNPACK), and has no code for that inside a kernel.
    """
    large = 1024  # numbers; from 4096, as measured, they are left to the library
    for operation in operations:
        if operation.name == "stablehlo.dot_general":
            operation = _written_out(operation)
        if operation.name != "stablehlo.reduce" or len(operation.operands) != 2:
            continue
        kind = ir.RankedTensorType(operation.operands[0].type)
        block = operation.regions[0].blocks[0]
        simple = len(block.operations) == 2 and isinstance(kind.element_type, ir.FloatType)
        if simple and math.prod(kind.shape) >= large:
            step, end = block.operations
            with ir.InsertionPoint(end), end.location:
                # "v if v is NaN else the sum": the same for all numbers, NaN included, because it has v as a term
                value = block.arguments[1]
                is_nan = stablehlo.compare(value, value, stablehlo.ComparisonDirectionAttr.get("NE"))
                end.operands[0] = stablehlo.select(is_nan, value, step.results[0])


def _written_out(product: ir.Operation) -> ir.Operation:
    """Replace a product of matrices by a sum of products of their numbers; return the sum."""
    numbers = stablehlo.DotDimensionNumbers(product.attributes["dot_dimension_numbers"])
    kind = ir.RankedTensorType(product.results[0].type)
    axes = []  # of each factor, in the array of all products: those of the result, then those that are summed over
    free = len(numbers.lhs_batching_dimensions)
    last = kind.rank
    sides = (
        (numbers.lhs_batching_dimensions, numbers.lhs_contracting_dimensions),
        (numbers.rhs_batching_dimensions, numbers.rhs_contracting_dimensions),
    )
    for factor, (batch, summed) in zip(product.operands, sides, strict=True):
        place = {axis: k for k, axis in enumerate(batch)} | {axis: last + k for k, axis in enumerate(summed)}
        for axis in range(ir.RankedTensorType(factor.type).rank):
            if axis not in place:
                place[axis] = free
                free += 1
        axes.append([place[axis] for axis in sorted(place)])
    left = ir.RankedTensorType(product.operands[0].type)
    summed = [left.shape[axis] for axis in numbers.lhs_contracting_dimensions]
    wide = ir.RankedTensorType.get([*kind.shape, *summed], kind.element_type)
    number = ir.RankedTensorType.get([], kind.element_type)
    with ir.InsertionPoint(product), product.location:
        factors = [
            stablehlo.broadcast_in_dim(wide, factor, ir.DenseI64ArrayAttr.get(to))
            for factor, to in zip(product.operands, axes, strict=True)
        ]
        nothing = stablehlo.constant(ir.DenseElementsAttr.get_splat(number, ir.FloatAttr.get(kind.element_type, 0.0)))
        over = ir.DenseI64ArrayAttr.get(range(kind.rank, wide.rank))
        total = stablehlo.ReduceOp([kind], [stablehlo.multiply(*factors)], [nothing], over)
        block = total.regions[0].blocks.append(number, number)
        with ir.InsertionPoint(block):
            stablehlo.return_([stablehlo.add(*block.arguments)])
    product.results[0].replace_all_uses_with(total.results[0])
    product.erase()
    return total.operation


def _callee(call: ir.Operation) -> str:
    """Return the name of the called function."""
    return ir.FlatSymbolRefAttr(call.attributes["callee"]).value


def _only_calls(call: ir.Operation, functions: ir.SymbolTable) -> bool:
    """Tell whether the called function only calls another one, which is marked, and passes all its arguments on."""
    block = functions[_callee(call)].entry_block
    inner, *others = [operation.operation for operation in block.operations]
    if inner.name != "func.call" or len(others) > 1:
        return False
    # XLA shares the work of a large only result among threads, for which it has no code inside a kernel
    if len(inner.results) == 1 and math.prod(ir.RankedTensorType(inner.results[0].type).shape) >= LARGEST:
        return False
    return ATTRIBUTES in inner.attributes and set(block.arguments) <= set(inner.operands)


def _operations(name: str, functions: ir.SymbolTable, seen: set[str]) -> list[ir.Operation]:
    """Return the operations of a function, and of those that it calls, each once."""
    found = []

    def visit(operation):
        found.append(operation)
        if operation.name == "func.call" and _callee(operation) not in seen:
            found.extend(_operations(_callee(operation), functions, seen))
        return ir.WalkResult.ADVANCE

    seen.add(name)
    functions[name].operation.walk(visit)
    return found


def _fits(operation: ir.Operation) -> bool:
    """Tell whether an operation can be inside a kernel."""
    if operation.name == "stablehlo.scatter":
        return _updates_once(operation)
    if operation.name == "stablehlo.dot_general":
        # one that can be written out
        types = {ir.RankedTensorType(x.type).element_type for x in (*operation.operands, *operation.results)}
        return len(types) == 1 and isinstance(types.pop(), ir.FloatType)
    # for these XLA on a CPU calls a library, or has no code inside a kernel
    others = "chlo.top_k", "stablehlo.custom_call", "stablehlo.fft", "stablehlo.select_and_scatter", "stablehlo.sort"
    return operation.name not in others


def _updates_once(scatter: ir.Operation) -> bool:
    """Tell whether a scatter has one index, so that XLA makes a slice's update of it.

    Of windows that are added it makes none: these are in derivatives of a batch by samples of a rail.
    """
    numbers = stablehlo.ScatterDimensionNumbers(scatter.attributes["scatter_dimension_numbers"])
    combines = len(list(scatter.regions[0].blocks[0].operations)) > 1
    if numbers.update_window_dims and combines:
        return False
    shape = ir.RankedTensorType(scatter.operands[len(scatter.results)].type).shape
    return all(size == 1 for k, size in enumerate(shape) if k != numbers.index_vector_dim)


_argument = Primitive("slipperjax_argument")
_result = Primitive("slipperjax_result")
# both leave an array as it is, and are the transposes of each other
for primitive, other in ((_argument, _result), (_result, _argument)):
    primitive.def_impl(lambda x, kernel: x)
    primitive.def_abstract_eval(lambda x, kernel: x)
    ad.deflinear2(primitive, lambda cotangent, x, kernel, other=other: [other.bind(cotangent, kernel=kernel)])
    batching.defvectorized(primitive)
    mlir.register_lowering(primitive, lambda context, x, kernel: [x])
# a lowering that JAX keeps for several calls would not see where its operand comes from
mlir.register_lowering(_result, _mark, platform="cpu", cacheable=False)
