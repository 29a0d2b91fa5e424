"""Compiling: `jax.jit` with compiler options, at the top level and inside other transformations."""

import functools
import inspect
import os
import threading
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jax.extend.core import get_opaque_trace_state

from .programs import programs_kept

_TOP_LEVEL = get_opaque_trace_state()
_CPU_OPTIONS = {
    # Lets LLVM reassociate the sum over the contact points, which vectorises it. The other four options preserve
    # NaN, infinity, division and square root.
    "xla_cpu_enable_fast_math": True,
    "xla_cpu_fast_math_honor_nans": True,
    "xla_cpu_fast_math_honor_infs": True,
    "xla_cpu_fast_math_honor_division": True,
    "xla_cpu_fast_math_honor_functions": True,
    # Batches are too small for one kernel to gain from several threads; chunks of the batch use the cores instead.
    "xla_cpu_multi_thread_eigen": False,
}
COMPILER_OPTIONS: dict[str, dict[str, Any]] = {"cpu": _CPU_OPTIONS}
"""XLA options by backend; a backend that is not listed gets XLA's defaults."""

LOOP_BYTES = 64_000_000
"""Bytes that a pass of a loop may move for the loop to be one kernel: those of 1024 cases and more."""
_EXTRA = "--xla_backend_extra_options"

TRACING = "/slipperjax/tracing"
"""Event of `jax.monitoring` when the making of a program begins, for those who show what is waited for."""


def compiler_options(backend: str | None = None) -> dict[str, Any]:
    """The XLA options for a backend, by default the one that JAX uses now."""
    return COMPILER_OPTIONS.get(jax.default_backend() if backend is None else backend, {})


def loops_in_one_kernel() -> None:
    """Makes XLA compile each loop on a CPU to one kernel, without LAPACK calls, scatters or sorts in it.

    Otherwise each step of an integration starts some hundred kernels, which takes longer than a batch of 30 cases
    needs to compute. XLA has this as a flag of the process only, which it reads when the first program is made: later
    there is no effect. Where `XLA_FLAGS` sets extra options of the backend already, they stay as they are.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if _EXTRA not in flags:
        option = f"{_EXTRA}=xla_cpu_small_while_loop_byte_threshold={LOOP_BYTES}"
        os.environ["XLA_FLAGS"] = f"{flags} {option}".strip()


def jit(fun: Callable, **kwargs: Any) -> Callable:
    """`jax.jit` with `compiler_options` of the backend in use, and programs from `slipperjax.compile_cache`.

    JAX accepts compiler options for the outermost program only. Inside another transformation (jit, grad, vmap, ...)
    this is a plain `jax.jit`.

    **Arguments:** `fun`, `kwargs`: as for `jax.jit`.

    **Returns:** the compiled function. Its attribute `prepare`, called with the same arguments, traces the program
    for such arguments and compiles it on another thread; a call that needs it waits. So several are compiled at once.
    """
    inner = jax.jit(fun, **kwargs)
    static = _static_of(fun, **kwargs)
    prepared: dict[Hashable, Future] = {}
    lock = threading.Lock()

    def announced(*args: Any, **options: Any) -> Any:
        jax.monitoring.record_event(TRACING)  # this body runs only when a program is made
        return fun(*args, **options)

    @functools.cache
    def outermost(backend: str) -> Callable:
        return jax.jit(functools.wraps(fun)(announced), compiler_options=compiler_options(backend), **kwargs)

    def from_folder(args: tuple, options: dict[str, Any], *run: Callable) -> tuple[Future | None, Sequence[Any]]:
        """The program for some arguments, where programs are kept, and what it takes."""
        folder = programs_kept()
        if folder is None or static is None:
            return None, ()
        split = static.split(args, options)

        def lower(mark: str) -> tuple[Any, Any]:
            results = []

            def flat(*leaves: Any) -> list[Any]:
                found, of_results = jax.tree.flatten(split.applied(announced, leaves))
                results.append(of_results)
                return found

            flat.__name__ = fun.__name__ + mark
            return jax.jit(flat, compiler_options=compiler_options()).lower(*split.leaves), results[0]

        return folder.program(fun, split.static, split.structure, split.leaves, lower, *run), split.leaves

    @functools.wraps(fun)
    def call(*args: Any, **options: Any) -> Any:
        if get_opaque_trace_state() != _TOP_LEVEL:
            return inner(*args, **options)
        found, leaves = from_folder(args, options)
        program = None if found is None else found.result()
        if program is not None:
            return program(leaves)
        if static is not None and not all(begun.done() for begun in list(prepared.values())):
            wait([prepared.get(static.split(args, options).key, _READY)])
        return outermost(jax.default_backend())(*args, **options)

    def begun(args: tuple, options: dict[str, Any], run: Callable[[Callable[[], Any]], Future]) -> Future:
        """The program for some arguments, which another thread compiles."""
        found, _ = from_folder(args, options, run)
        if found is None or (found.done() and found.result() is None):
            # JAX finds what this makes when the function is called
            return run(outermost(jax.default_backend()).lower(*args, **options).compile)
        return found

    def prepare(*args: Any, **options: Any) -> None:
        if static is None or get_opaque_trace_state() != _TOP_LEVEL:
            return
        key = static.split(args, options).key
        with lock:  # who prepares the same on another thread waits until it is traced
            if key not in prepared:
                pool = ThreadPoolExecutor(1)
                try:
                    prepared[key] = begun(args, options, pool.submit)
                except Exception:  # the call itself will say what is wrong
                    prepared[key] = _READY
                pool.shutdown(wait=False)

    call.prepare = prepare  # type: ignore[attr-defined]
    return call


_READY: Future = Future()
_READY.set_result(None)


class _Split(NamedTuple):
    """The arguments of a call: those that its program is made for, and those that it takes."""

    static: tuple[tuple[tuple[int, Any], ...], tuple[tuple[str, Any], ...]]
    """Values by place and by name."""
    structure: Any
    """Of the places and names of all others."""
    leaves: list[Any]

    @property
    def key(self) -> Hashable:
        """What the program depends on."""
        return self.static, self.structure, tuple(map(jax.typeof, self.leaves))

    def applied(self, fun: Callable, leaves: Sequence[Any]) -> Any:
        """The function's value for other leaves."""
        args, options = jax.tree.unflatten(self.structure, leaves)
        by_place = dict(self.static[0])
        return fun(*(by_place.get(k, arg) for k, arg in enumerate(args)), **options, **dict(self.static[1]))


class _Static(NamedTuple):
    """Places and names of a function's static arguments."""

    places: frozenset[int]
    names: frozenset[str]

    def split(self, args: tuple, options: dict[str, Any]) -> _Split:
        """The arguments of a call, sorted."""
        by_place = tuple((k, arg) for k, arg in enumerate(args) if k in self.places)
        by_name = tuple((name, options[name]) for name in sorted(options) if name in self.names)
        others = tuple(None if k in self.places else arg for k, arg in enumerate(args))
        rest = {name: value for name, value in options.items() if name not in self.names}
        leaves, structure = jax.tree.flatten((others, rest))
        return _Split((by_place, by_name), structure, leaves)


def _static_of(
    fun: Callable,
    *,
    static_argnums: int | Sequence[int] = (),
    static_argnames: str | Sequence[str] = (),
    **others: Any,
) -> _Static | None:
    """The static arguments of a function from those of `jax.jit`; None where JAX has to look after its programs."""
    parameters = list(inspect.signature(fun).parameters)
    numbers = (static_argnums,) if isinstance(static_argnums, int) else static_argnums
    names = {static_argnames} if isinstance(static_argnames, str) else set(static_argnames)
    if others or any(k >= len(parameters) for k in numbers):
        return None
    names |= {parameters[k] for k in numbers}
    return _Static(frozenset(k for k, name in enumerate(parameters) if name in names), frozenset(names))


def is_traced(tree: Any) -> bool:
    """Whether any leaf is a tracer, that is, whether the call is inside a JAX transformation."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree))


def call_compiled(fun: Callable, functions: Any, static: tuple, *arrays: Any) -> Any:
    """`fun(functions, static, *arrays)`, compiled; inside another transformation it is a part of that program.

    **Arguments:** `functions`: a pytree of callables, such as `equinox.Module`s, whose array leaves become arguments
    of the compiled program, so that new values need no compilation. `static`: hashable; a new value is compiled
    again. `arrays`: pytrees of arrays.
    """
    numbers, rest = eqx.partition(functions, lambda leaf: isinstance(leaf, jax.Array | np.ndarray))
    leaves, structure = jax.tree.flatten(rest)
    return _call(fun, tuple(leaves), structure, static, numbers, arrays)


def _call_uncompiled(fun, leaves, structure, static, numbers, arrays):
    return fun(eqx.combine(numbers, jax.tree.unflatten(structure, leaves)), static, *arrays)


_call = jit(_call_uncompiled, static_argnums=(0, 1, 2, 3))
