"""Parts of a program that XLA compiles to one kernel on a CPU, loops included.

A step of an integration has some hundred kernels. By default XLA starts each kernel separately, and these starts take
longer than the computation of a batch of 30 cases. XLA compiles a call to one kernel where the call has the attribute
`xla_cpu_small_call` and must not be inlined. The attribute changes no other program of the process.

Such a part is a `jax.jit` inside the program, so that JAX's own rules for derivatives and batches apply. The results
of the part pass through a primitive. When the program is lowered, this primitive sets the attributes on the call that
computes the results; it does nothing else. A second primitive does the same for arguments. Each primitive is the
transpose of the other: in reverse mode arguments become results, and the call of reverse mode is marked, too.
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
"""Size [numbers] from which a call's only result prevents a kernel; at twice this size some calls did not compile."""


def in_one_kernel(fun: Callable, *args: PyTree) -> PyTree:
    """Call `fun(*args)` as one kernel of the compiled program on a CPU. There is no such kernel where `fun` contains
    a LAPACK call, a scatter or a sort, or where its only result is an array of `LARGEST` numbers or more.

    **Arguments:** `fun`: function of pytrees that returns a pytree of arrays.
    """
    note_compiling()
    call, arrays = split_arrays(fun, args)
    # a traced value that the function closes over must also be an argument of the call
    of_arrays, closed_over = jax.closure_convert(call, arrays)
    # XLA fails where an argument of the call that becomes the kernel is not an operand inside this call. Therefore
    # the call contains a second call, of which all arguments are operands. Derivatives may give the outermost call
    # arguments that it does not pass to the next call; then the next call becomes the kernel. The outermost `jax.jit`
    # is the whole program where the function is called outside of any program.
    kernel = _called(_called(of_arrays, kernel=False), kernel=True)
    return jax.jit(_called(kernel, kernel=True))(arrays, *closed_over)


def _called(fun: Callable, kernel: bool) -> Callable:
    """Return a function that calls `fun` by a call that XLA does not inline; with `kernel` the call is one kernel."""
    inner = jax.jit(fun)

    def call(*args: PyTree) -> PyTree:
        # The lowering finds the call by its marked results. Marked arguments are results of the transposed call.
        args = jax.tree.map(lambda x: _argument.bind(x, kernel=kernel), args)
        return jax.tree.map(lambda x: _result.bind(x, kernel=kernel), inner(*args))

    return call


def _mark(context: mlir.LoweringRuleContext, x: ir.Value, kernel: bool) -> list[ir.Value]:
    """Set the attributes, once, on the call that computes a value; empty ones where the call cannot be a kernel."""
    call = getattr(x.owner, "operation", x.owner)
    # another result may have marked the call before; after transformations a value may not come from a call
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

    Without the barrier XLA would fold constants into the called function, and fail at the arguments without use.
    """
    with ir.InsertionPoint(call), call.location:
        barrier = stablehlo.OptimizationBarrierOp(list(call.operands))
    for k, value in enumerate(barrier.operation.results):
        call.operands[k] = value


def _hide_from_library(operations: list[ir.Operation]) -> None:
    """Rewrite products of matrices, large sums and large extremes, so that XLA does not recognise them.

    Since JAX 0.11 XLA leaves the operations that it recognises to a library (YNNPACK), which it cannot call inside a
    kernel.
    """
    large = 1024  # numbers; by measurement XLA uses the library from 4096 numbers on
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
                # "v if v is NaN, else the sum" equals the sum, also for NaN, because v is a term of the sum
                value = block.arguments[1]
                is_nan = stablehlo.compare(value, value, stablehlo.ComparisonDirectionAttr.get("NE"))
                end.operands[0] = stablehlo.select(is_nan, value, step.results[0])


def _written_out(product: ir.Operation) -> ir.Operation:
    """Replace a product of matrices by a sum of products of numbers; return the sum."""
    numbers = stablehlo.DotDimensionNumbers(product.attributes["dot_dimension_numbers"])
    kind = ir.RankedTensorType(product.results[0].type)
    axes = []  # places of each factor's axes in the array of all products: axes of the result, then summed axes
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
    """Return whether the called function only calls a second, marked function, and passes all its arguments on."""
    block = functions[_callee(call)].entry_block
    inner, *others = [operation.operation for operation in block.operations]
    if inner.name != "func.call" or len(others) > 1:
        return False
    # where a large result is the only one, XLA divides its work among threads, which it cannot do inside a kernel
    if len(inner.results) == 1 and math.prod(ir.RankedTensorType(inner.results[0].type).shape) >= LARGEST:
        return False
    return ATTRIBUTES in inner.attributes and set(block.arguments) <= set(inner.operands)


def _operations(name: str, functions: ir.SymbolTable, seen: set[str]) -> list[ir.Operation]:
    """Return the operations of a function and of the functions that it calls, each once."""
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
    """Return whether an operation can be inside a kernel."""
    if operation.name == "stablehlo.scatter":
        return _updates_once(operation)
    if operation.name == "stablehlo.dot_general":
        # `_written_out` takes floating-point numbers of one type
        types = {ir.RankedTensorType(x.type).element_type for x in (*operation.operands, *operation.results)}
        return len(types) == 1 and isinstance(types.pop(), ir.FloatType)
    # for these operations XLA calls a library on a CPU, or has no code inside a kernel
    others = "chlo.top_k", "stablehlo.custom_call", "stablehlo.fft", "stablehlo.select_and_scatter", "stablehlo.sort"
    return operation.name not in others


def _updates_once(scatter: ir.Operation) -> bool:
    """Return whether a scatter has one index, so that XLA replaces the scatter by the update of a slice.

    XLA does not replace a scatter that adds windows; derivatives of a batch by samples of a rail have such scatters.
    """
    numbers = stablehlo.ScatterDimensionNumbers(scatter.attributes["scatter_dimension_numbers"])
    combines = len(list(scatter.regions[0].blocks[0].operations)) > 1
    if numbers.update_window_dims and combines:
        return False
    shape = ir.RankedTensorType(scatter.operands[len(scatter.results)].type).shape
    return all(size == 1 for k, size in enumerate(shape) if k != numbers.index_vector_dim)


_argument = Primitive("slipperjax_argument")
_result = Primitive("slipperjax_result")
# both primitives return their array unchanged, and are the transposes of each other
for primitive, other in ((_argument, _result), (_result, _argument)):
    primitive.def_impl(lambda x, kernel: x)
    primitive.def_abstract_eval(lambda x, kernel: x)
    ad.deflinear2(primitive, lambda cotangent, x, kernel, other=other: [other.bind(cotangent, kernel=kernel)])
    batching.defvectorized(primitive)
    mlir.register_lowering(primitive, lambda context, x, kernel: [x])
# JAX must not reuse the lowering of another call, because the operand of each comes from another place
mlir.register_lowering(_result, _mark, platform="cpu", cacheable=False)
