"""What the package uses of others that these do not promise to keep: it is there, and does what is needed.

The table is in CONTRIBUTING.md. A failure here after an update names the module that needs another way.
"""

import importlib
import io
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import click
import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix
import pytest
import zarr
from jax.experimental.compilation_cache.compilation_cache import reset_cache
from jax.extend.core import Primitive, get_opaque_trace_state
from jax.extend.mlir import ir
from jax.interpreters import ad, batching, mlir
from jaxtyping import AbstractArray, Array, Float
from tqdm import tqdm

from slipperjax.tools.cache import keep_programs
from slipperjax.tools.checks import positive
from slipperjax.tools.fields import ShapeChecked, field
from slipperjax.tools.forms import compiler_options

NAMES = {
    "jax.extend.core": "Primitive get_opaque_trace_state",
    "jax.extend.mlir.ir": "DictAttr FlatSymbolRefAttr FloatType FunctionType InsertionPoint Operation "
    "RankedTensorType StringAttr SymbolTable Value WalkResult DenseI64ArrayAttr DenseElementsAttr FloatAttr",
    "jax.extend.mlir.dialects.func": "CallOp FuncOp ReturnOp",
    "jax.extend.mlir.dialects.stablehlo": "ComparisonDirectionAttr DotDimensionNumbers OptimizationBarrierOp "
    "ReduceOp ScatterDimensionNumbers add broadcast_in_dim compare constant multiply return_ select",
    "jax.experimental.serialize_executable": "deserialize_and_load serialize",
    "jax.interpreters.ad": "Zero deflinear2 is_undefined_primal primitive_jvps primitive_transposes",
    "jax.interpreters.batching": "bdim_at_front defvectorized primitive_batchers",
    "jax.interpreters.mlir": "LoweringRuleContext lower_fun register_lowering",
    "jaxlib.lapack": "prepare_lapack_call",
}


@pytest.mark.parametrize("module", NAMES)
def test_names_are_there(module):
    found = importlib.import_module(module) if module.count(".") < 4 else None
    if found is None:  # a dialect is an attribute, which may be no module of that name
        parent, _, name = module.rpartition(".")
        found = getattr(importlib.import_module(parent), name)
    missing = [name for name in NAMES[module].split() if not hasattr(found, name)]
    assert not missing, f"slipperjax.tools (compile, fused, kept, one_kernel) need {missing} of {module}"


def test_the_trace_state_differs_inside_transformations():
    outside, inside = get_opaque_trace_state(), []
    jax.jit(lambda: inside.append(get_opaque_trace_state()))()
    states = [get_opaque_trace_state() == outside, inside[0] == outside]
    assert states == [True, False], "slipperjax.tools.tracing.is_transformed compares trace states"


@pytest.fixture(scope="module")
def doubled():
    """A linear primitive, with the rules that the package writes, and what these were called with."""
    primitive, seen = Primitive("doubled"), {}

    def lowered(context, x):
        seen["functions"] = context.module_context.symbol_table
        seen["owner"] = getattr(getattr(x.owner, "operation", x.owner), "name", "")
        return mlir.lower_fun(lambda x: 2 * x, multiple_results=False)(context, x)

    def transposed(cotangent, x):
        assert ad.is_undefined_primal(x)
        return [primitive.bind(cotangent)]

    primitive.def_impl(lambda x: 2 * x)
    primitive.def_abstract_eval(lambda x: x.update(shape=x.shape))
    ad.primitive_jvps[primitive] = lambda x, t: (primitive.bind(*x), primitive.bind(*t))
    ad.primitive_transposes[primitive] = transposed
    batching.defvectorized(primitive)
    mlir.register_lowering(primitive, lowered, platform="cpu", cacheable=False)
    mlir.register_lowering(primitive, mlir.lower_fun(lambda x: 2 * x, multiple_results=False))
    return primitive.bind, seen


def test_rules_of_a_primitive_are_used(doubled):
    bind, _ = doubled
    x = jnp.array([1.0, 3.0])
    assert bind(x).tolist() == jax.jit(jax.vmap(bind))(x).tolist() == [2.0, 6.0]
    words = "slipperjax.tools.fused and one_kernel give rules for derivatives and batches"
    assert jax.jvp(bind, (x,), (x,))[1].tolist() == [2.0, 6.0], words
    assert jax.linear_transpose(bind, x)(x)[0].tolist() == [2.0, 6.0], words
    assert jax.jit(jax.grad(lambda x: jnp.sum(bind(x))))(x).tolist() == [2.0, 2.0], words
    assert jax.typeof(x).to_tangent_aval().shape == (2,), "slipperjax.tools.fused makes zeros of tangent types"


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="for CPUs")
def test_a_lowering_sees_the_call_that_its_operand_comes_from(doubled):
    bind, seen = doubled
    jax.jit(lambda x: bind(jax.jit(jnp.sin)(x))).lower(1.0)
    assert seen["owner"] == "func.call", "slipperjax.tools.one_kernel marks the call of an inner jax.jit"
    assert isinstance(seen["functions"], ir.SymbolTable), "slipperjax.tools.one_kernel looks into called functions"


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="for CPUs")
def test_xla_takes_the_options_of_cpus():
    options = compiler_options("cpu")
    for name, value in options.items():
        jax.jit(lambda x: x + 1, compiler_options={name: value}).lower(1.0).compile()
    with pytest.raises(Exception, match="No such compile option"):
        jax.jit(lambda x: x + 1, compiler_options={"xla_cpu_no_such": True}).lower(1.0).compile()


@pytest.mark.full
def test_texts_of_cache_warnings(tmp_path, own_cache):
    keep_programs(tmp_path)
    reset_cache()  # the folder of the session's first program would stay
    program = lambda: jax.jit(lambda x: jnp.cos(x) * 0.123)(2.0)
    try:
        program()
        entries = [path for path in tmp_path.iterdir() if path.name.endswith("-cache")]
        assert entries, "slipperjax.tools.cache keeps programs in files of JAX"
        for path in entries:
            path.write_bytes(b"damaged")
        jax.clear_caches()
        with pytest.warns(UserWarning, match="Error reading persistent compilation cache entry"):
            program()
    finally:
        reset_cache()


def test_options_of_jax_can_be_listed():
    assert "jax_enable_x64" in jax.config.values, "slipperjax.tools.kept reads all options there"


def solved(solver, t1=1.0, **options):
    """The shapes of a solution of y' = -y by diffrax, of which nothing is computed."""
    term = diffrax.ODETerm(lambda t, y, args: -y)
    return jax.eval_shape(lambda: diffrax.diffeqsolve(term, solver, 0.0, t1, 0.1 * t1, jnp.ones(2), **options))


class Watching(optimistix.Newton):
    """A root finder that keeps what it is called with."""

    seen: list = eqx.field(static=True, default_factory=list)

    def init(self, fn, y, args, options, *others, **named):
        self.seen.append((len(args), "init_state" in options))
        return super().init(fn, y, args, options, *others, **named)


@pytest.mark.parametrize(("method", "numbers"), [(diffrax.Kvaerno3, {7, 8}), (diffrax.ImplicitEuler, {5})])
def test_diffrax_calls_a_root_finder_with_these_numbers_of_arguments(method, numbers):
    finder = Watching(rtol=1e-6, atol=1e-6)
    solved(method(root_finder=finder))
    words = "slipperjax.solvers.SimplifiedNewton tells the kinds of stages apart by the number of their arguments"
    assert {count for count, _ in finder.seen} <= numbers, words


def test_diffrax_gives_the_state_of_a_step_to_the_root_finders_of_its_stages():
    finder = Watching(rtol=1e-6, atol=1e-6)
    solved(diffrax.Kvaerno3(root_finder=finder))
    assert any(begun for _, begun in finder.seen), "slipperjax.solvers.SimplifiedNewton linearises once a step"


def test_diffrax_wraps_terms_that_run_backwards():
    seen = []

    class Back(diffrax.Euler):
        def step(self, terms, *others, **options):
            seen.append(hasattr(terms, "term"))
            return super().step(terms, *others, **options)

    solved(Back(), t1=-1.0)
    assert seen[0], "slipperjax.solvers.latching finds the vector field inside such terms"


def test_loops_over_stages_of_diffrax_have_a_kind():
    assert diffrax.Kvaerno5().scan_kind is None, "slipperjax.solvers.latching.differentiable sets it"


def test_the_next_step_of_a_controller_of_diffrax_comes_first():
    keep = diffrax.SaveAt(t1=True, controller_state=True)
    controller = diffrax.PIDController(rtol=1e-3, atol=1e-3)
    solution = solved(diffrax.Tsit5(), saveat=keep, stepsize_controller=controller)
    assert solution.controller_state[0].shape == (), "slipperjax.flow.stepping hands it on to the next period"


def test_zarr_writes_parts_that_end_in_partial(monkeypatch, tmp_path):
    names, replace = [], Path.replace
    monkeypatch.setattr(Path, "replace", lambda path, to: (names.append(path.name), replace(path, to))[1])
    zarr.create_array(tmp_path / "a.zarr", shape=(2,), dtype="f8")[:] = 1.0
    assert all(name.endswith(".partial") for name in names), "slipperjax.sweeps.store clears those of killed work"
    assert names


def test_an_executor_of_processes_knows_how_it_starts_them():
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        assert pool._mp_context.get_start_method() == "spawn", "slipperjax.sweeps.store refuses one that forks"


def test_a_bar_of_tqdm_is_wiped_out_when_its_delay_is_set_to_0():
    file = io.StringIO()
    with tqdm(total=1, file=file, delay=100.0, leave=False, ascii=True) as bar:
        assert not bar.disable, "slipperjax.tools.progress asks a bar whether it is shown"
        bar.delay = 0
        bar.set_description_str("compiling")
    assert "compiling" in file.getvalue()
    assert file.getvalue().endswith("\r"), "slipperjax.tools.progress ends the delay of a bar"


def test_options_of_a_command_that_is_not_made_yet():
    command = click.option("--scene")(lambda scene: None)
    assert [one.name for one in command.__click_params__] == ["scene"], "slipperjax.cli.options.takes_case"


def test_a_field_of_equinox_gets_the_name_of_its_argument():
    class Ball(ShapeChecked):
        mass: Float[Array, ""] = field("kg", positive)

    words = "slipperjax.tools.fields replaces a field's converter before equinox makes the class"
    with pytest.raises(ValueError, match="Argument `mass` must be positive"):
        pytest.fail(f"{words}: {Ball(-1.0)}")
    assert isinstance(eqx.field(converter=float).metadata["converter"], type), words


def test_annotations_of_jaxtyping_tell_their_dimensions():
    kind = Float[Array, "points 3"]
    told = issubclass(kind, AbstractArray) and kind.dim_str == "points 3"
    assert told, "slipperjax.tools.fields reads shapes of fields"
