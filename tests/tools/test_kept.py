"""Programs that are kept whole: found by another process where nothing differs, and by none where anything does."""

import contextlib
import functools
import hashlib
import os
import pickle
import subprocess
import sys
import threading
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax.orbits.simulate import stand_in
from slipperjax.tools import cache, kept
from slipperjax.tools.code import stable_digest

from ..common import compilations

PROGRAM = """
import importlib.metadata, os, sys
import jax, jax.numpy as jnp, numpy as np, equinox as eqx, functools
import slipperjax as sj
{before}
{law}
args, options = {arguments}, dict({options})
print(np.asarray(sj.jit({function}, static_argnames="how")(*args, **options)).tolist())
"""
LAW = """
class Base(eqx.Module):
    def slope(self, x): return 2 * x
class Law(Base):
    k: jax.Array
    name: str = eqx.field(static=True, default="a")
    shape: object = eqx.field(static=True, default=lambda x: x + 1)
    def __call__(self, x): return self.k * self.shape(self.slope(x))
    def __add__(self, other): return self(other)
TABLE = np.zeros(5000)
FACTOR = 3.0
def twice(f):
    @functools.wraps(f)
    def wrapper(*args): return 2 * f(*args)
    return wrapper
@jax.custom_jvp
def rule(x): return x
rule.defjvp(lambda x, t: (x[0], 5 * t[0]))
@twice
def own(x, *, to=7): return FACTOR * x + TABLE[4000] + to + jax.grad(rule)(1.0)
def made(a): return lambda x: own(x) + a
chosen = made(1.0)
mapped = jax.vmap(lambda x, y: x + y[0], in_axes=(0, None))
def function(law, x, how=1):
    z = jnp.ones((2, 2))
    return law(x) + (law + x) + chosen(x) + how * mapped(z, z)[0, 0] + powers(x)
powers = functools.partial(lambda x, y: x**y, y=2)
"""
"""Functions and classes of a user, of all the kinds that a trace may depend on."""


@dataclass(frozen=True)
class Case:
    """A process, and what differs in it from the first one."""

    old: str = ""
    new: str = ""
    before: str = ""
    environment: dict = field(default_factory=dict)
    arguments: str = "(Law(jnp.array(3.0)), np.array(0.5))"
    options: str = "how=1"
    function: str = "function"


CHANGES = {
    "option of JAX": Case(before="jax.config.update('jax_default_matmul_precision', 'highest')"),
    "promotion": Case(before="jax.config.update('jax_numpy_dtype_promotion', 'strict')"),
    "random numbers": Case(before="jax.config.update('jax_threefry_partitionable', False)"),
    "random generator": Case(before="jax.config.update('jax_default_prng_impl', 'rbg')"),
    "flags of XLA": Case(environment={"XLA_FLAGS": "--xla_backend_optimization_level=1"}),
    "number of devices": Case(before="jax.config.update('jax_num_cpu_devices', 2)"),
    "plain form": Case(environment={"SLIPPERJAX_PLAIN": "1"}),
    "source of the package": Case(before="import slipperjax.tools.kept as kept; kept.IMPORTED = 'edited'"),
    **{
        f"version of {name}": Case(
            before="real = importlib.metadata.version; "
            f"importlib.metadata.version = lambda name: 'x' if name == '{name}' else real(name)"
        )
        for name in ("jax", "jaxlib", "numpy", "equinox", "diffrax", "lineax", "optimistix")
    },
    "type of numbers": Case(arguments="(Law(jnp.array(3.0)), np.array(0.5, np.float32))"),
    "weak type": Case(arguments="(Law(jnp.array(3.0)), 0.5)"),
    "shape": Case(arguments="(Law(jnp.array([3.0])), np.array(0.5))"),
    "structure": Case(arguments="(Law(jnp.array(3.0), 'a'), np.array(0.5), 1)", options=""),
    "static argument": Case(options="how=2"),
    "type of a static argument": Case(options="how=1.0"),
    "static argument by position": Case(arguments="(Law(jnp.array(3.0)), np.array(0.5), 3)", options=""),
    "static field": Case('default="a"', 'default="b"'),
    "function in a static field": Case("x + 1", "x + 2"),
    "method": Case("self.k * self.shape", "2 * self.k * self.shape"),
    "operator": Case("return self(other)", "return -self(other)"),
    "class that is inherited from": Case("return 2 * x", "return 4 * x"),
    "global number": Case("FACTOR = 3.0", "FACTOR = 4.0"),
    "one element of a global array": Case("TABLE = np.zeros(5000)", "TABLE = np.arange(5000) // 3999.0"),
    "default by name": Case("to=7", "to=8"),
    "decorator": Case("return 2 * f(*args)", "return 3 * f(*args)"),
    "rule of a derivative": Case("5 * t[0]", "6 * t[0]"),
    "enclosed variable": Case("made(1.0)", "made(2.0)"),
    "axes of a batch": Case("in_axes=(0, None)", "in_axes=(1, None)"),
    "argument of a partial": Case("y=2)", "y=3)"),
    "function": Case(function="lambda law, x, how: law(x) + own(x)"),
}
"""What differs from `Case()`, by what it shows."""


def in_process(case: Case, folder: Path) -> tuple[str, set[str]]:
    """What a process prints, and the programs that are kept after it."""
    law = LAW.replace(case.old, case.new) if case.old else LAW
    assert (law == LAW) == (not case.old)
    names = ("before", "arguments", "options", "function")
    code = PROGRAM.format(law=law, **{name: getattr(case, name) for name in names})
    env = os.environ | {"SLIPPERJAX_CACHE": str(folder), "PYTHONWARNINGS": "ignore"} | case.environment
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env, check=False)
    assert not found.returncode, found.stderr
    return found.stdout, kept_in(folder)


def kept_in(folder: Path) -> set[str]:
    return {path.name for path in folder.rglob("*-whole")}


@pytest.mark.full
@pytest.mark.usefixtures("own_cache")
def test_programs_with_linear_systems_run_in_a_process_that_lowers_none(tmp_path):
    """Until LAPACK is fetched, its addresses are 0."""
    case = Case(function="lambda law, x, how: jnp.linalg.inv(x * jnp.eye(3))")
    first = in_process(case, tmp_path)
    assert len(first[1]) == 1
    assert in_process(case, tmp_path) == first


@pytest.mark.full
@pytest.mark.usefixtures("own_cache")
def test_each_kind_of_change_is_a_new_program(tmp_path):
    """In processes of their own. The digest of each change is another one, too, so that none hides another."""
    printed, before = in_process(Case(), tmp_path)
    assert len(before) == 1
    # found, in a process whose sets have another order
    assert in_process(Case(environment={"PYTHONHASHSEED": "7"}), tmp_path) == (printed, before)
    # options that only tell more or less leave programs as they are
    assert in_process(Case(before="jax.config.update('jax_log_compiles', False)"), tmp_path) == (printed, before)
    # a few at once, each with programs of its own, which are none of the others'
    with ThreadPoolExecutor() as pool:
        found = pool.map(lambda name: in_process(CHANGES[name], tmp_path / name)[1], CHANGES)
        programs = dict(zip(CHANGES, found, strict=True))
    assert {name for name, of in programs.items() if len(of) != 1} == set()
    assert len(set.union(before, *programs.values())) == 1 + len(CHANGES)
    assert len(CHANGES) >= 25


def digest_of(case: Case) -> str | None:
    """The digest of the user's functions and of a law, in this process."""
    known = {"__name__": "of_a_user", "eqx": eqx, "jax": jax, "jnp": jnp, "np": np, "functools": functools}
    exec(LAW.replace(case.old, case.new) if case.old else LAW, known)
    # the classes of its arguments are found in their tree
    law = jax.tree.structure(known["Law"](jnp.array(3.0)))
    return stable_digest((known["function"], law))


@pytest.mark.parametrize("name", [name for name, change in CHANGES.items() if change.old])
def test_each_change_of_code_is_another_digest(name):
    assert digest_of(Case()) == digest_of(Case())
    assert digest_of(Case()) is not None
    assert digest_of(CHANGES[name]) not in (digest_of(Case()), None)


@pytest.mark.full
@pytest.mark.usefixtures("own_cache")
def test_functions_in_modules_of_the_user_count(tmp_path, monkeypatch):
    (tmp_path / "helpers.py").write_text("def k(x): return 2 * x")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
    case = Case(before="import helpers", function="lambda law, x, how: helpers.k(x)")
    first, _ = in_process(case, tmp_path / "cache")
    (tmp_path / "helpers.py").write_text("def k(x): return 3 * x")
    second, after = in_process(case, tmp_path / "cache")
    assert [float(first), float(second)] == [1.0, 1.5]
    assert len(after) == 2


@pytest.fixture
def folder(tmp_path, own_cache):
    """A folder of kept programs, which this process uses."""
    cache.keep_in(tmp_path)
    return tmp_path


def cubed(x, how=1):
    return {"cube": how * x**3, "twice": 2 * x}


@pytest.mark.parametrize("value", [2.0, np.float64(2.0), np.arange(3.0), jnp.arange(3.0)], ids=str)
def test_a_kept_program_gives_what_jit_gives(folder, value):
    right = sj.jit(cubed, static_argnames="how")(value, how=2)
    kept.forget()
    with compilations() as seconds:
        found = sj.jit(cubed, static_argnames="how")(value, how=2)
    assert not seconds
    assert len(kept_in(folder)) == 1
    plain = jax.jit(cubed, static_argnames="how")(value, how=2)
    for name in plain:
        assert np.array_equal(found[name], plain[name])
        assert np.array_equal(found[name], right[name])
        assert (found[name].weak_type, found[name].committed) == (plain[name].weak_type, plain[name].committed)


def test_static_arguments_that_are_equal_are_told_apart_by_their_type(folder):
    call = sj.jit(cubed, static_argnames="how")
    assert [call(2, how=how)["cube"].dtype for how in (1, 1.0)] == [np.int64, np.float64]


def damaged(content: bytes) -> list[bytes]:
    """What crashes, disks and others may leave in place of a file's content."""
    flipped = bytearray(content)
    flipped[len(content) // 2] ^= 1
    return [b"", content[:10], content[:-5], bytes(flipped), b"of somebody else"]


def test_damaged_files_are_compiled_anew_and_written_again(folder):
    sj.jit(cubed)(2.0)
    (path,) = folder.glob("*-whole")
    whole = path.read_bytes()
    for content in damaged(whole):
        path.write_bytes(content)
        with compilations() as seconds:
            assert float(sj.jit(cubed)(2.0)["cube"]) == 8.0
        assert len(seconds) == 1
        assert kept._read(path)


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="files have no owner here")
def test_files_of_others_are_not_loaded(folder, monkeypatch):
    sj.jit(cubed)(2.0)
    monkeypatch.setattr(os, "getuid", lambda: folder.stat().st_uid + 1)
    with compilations() as seconds:
        sj.jit(cubed)(2.0)
    assert len(seconds) == 1


@pytest.mark.parametrize("option", ["jax_debug_nans", "jax_disable_jit"])
def test_options_that_watch_a_trace_are_obeyed(folder, option):
    sj.jit(cubed)(2.0)
    before = kept_in(folder)
    seen = []
    jax.config.update(option, True)
    try:
        sj.jit(lambda x: seen.append(x) or x * x)(3.0)
    finally:
        jax.config.update(option, False)
    assert seen
    assert kept_in(folder) == before


def test_what_cannot_be_told_apart_is_not_kept(folder):
    lock = threading.Lock()
    printed = lambda x: jax.debug.print("{}", x) or x
    locked = lambda x: 2 * x if lock else x
    for fun in (printed, locked):
        assert float(sj.jit(fun)(2.0)) in (2.0, 4.0)
        assert float(sj.jit(fun)(2.0)) in (2.0, 4.0)
    assert not kept_in(folder)
    assert stable_digest(lock) is None


def test_arguments_elsewhere_are_not_kept(folder):
    mesh = jax.sharding.Mesh(np.array(jax.devices()[:1]), ("x",))
    spread = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec())
    assert float(sj.jit(cubed)(jax.device_put(2.0, spread))["cube"]) == 8.0
    assert not kept_in(folder)


def test_errors_are_those_of_jit(folder):
    with pytest.raises(TypeError, match="abstract array"):
        sj.jit(cubed)("text")
    with pytest.raises(ValueError, match=r"unhashable|Non-hashable"):
        sj.jit(cubed, static_argnames="how")(2.0, how=[1])
    with pytest.raises(ZeroDivisionError):
        sj.jit(lambda x: x / (1 // 0))(2.0)
    with pytest.raises(TypeError, match="missing"):
        sj.jit(cubed)()


def test_what_comes_out_of_jaxs_cache_is_not_kept(folder, tmp_path_factory):
    """XLA cannot write it again: it would be found, and fail when it runs."""
    cache.keep_programs(tmp_path_factory.mktemp("jax"))
    cache.keep_in(None)
    sj.jit(cubed)(3.0)
    jax.clear_caches()
    compiled = sj.jit(cubed)
    # from JAX's cache, and then the same program of this process
    for place in (None, folder, folder):
        cache.keep_in(place)
        assert float(compiled(3.0)["cube"]) == 27.0
        kept.forget()
    assert not kept_in(folder)


def test_a_program_that_does_not_run_is_replaced(folder):
    sj.jit(cubed)(2.0)
    (path,) = folder.glob("*-whole")
    other = sj.jit(lambda x: {"cube": x, "twice": x})
    other(2.0)
    (second,) = set(folder.glob("*-whole")) - {path}
    broken = pickle.dumps((b"no program", 0))
    second.write_bytes(hashlib.sha256(broken).digest() + broken)
    kept.forget()
    assert float(other(5.0)["cube"]) == 5.0
    assert kept._read(second) not in (b"", broken)


def test_two_threads_compile_a_program_once(folder):
    traced = []

    def slow(x):
        traced.append(x)
        return jnp.sin(x) * 2

    compiled = sj.jit(slow)
    with ThreadPoolExecutor(4) as pool:
        assert len(set(map(float, pool.map(compiled, [0.5] * 4)))) == 1
    assert len(traced) == 1


def test_a_scene_and_its_orbit_are_found_again(folder):
    scene = sj.paper_scene(speed=1250.0)
    step = dict(solver=sj.solvers.ImpulseRK4(), steps_per_period=20)
    first = sj.simulate(scene, 2, **step)
    kept.forget()
    with compilations() as seconds:
        second = sj.simulate(scene.replace(speed=1250.0), 2, **step)
    assert not seconds
    assert eqx.tree_equal(first, second)
    # what compiles the programs that come after a run has its shapes
    kind = lambda a: (a.shape, a.dtype, a.weak_type)
    kinds = lambda run: jax.tree.map(kind, (run.period, run.state, run.loads))
    assert kinds(stand_in(scene, 2, steps_per_period=20)) == kinds(first)


HEARD = []
"""Traces, lowerings and compilations that `listen` has heard of in this process."""


def listen():
    heard = lambda event, duration, fun_name="", **_: "compile" in event and HEARD.append(fun_name)
    jax.monitoring.register_event_duration_secs_listener(heard)


def heard():
    return list(HEARD)


def compile_one():
    """What a worker must hear of, so that hearing of nothing means something."""
    jax.jit(lambda x: x + 1)(2.0)


@contextlib.contextmanager
def one_process():
    """A function that calls another one in a new process, and an executor of this process."""
    with sj.sweeps.processes(1) as pool:
        yield lambda call: pool.submit(call).result(), pool


@contextlib.contextmanager
def one_of_dask():
    distributed = pytest.importorskip("distributed")
    options = dict(n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of dask's own making
        with distributed.LocalCluster(**options) as cluster, distributed.Client(cluster) as client:
            yield lambda call: next(iter(client.run(call).values())), client


@pytest.mark.full
@pytest.mark.parametrize("workers", [one_process, one_of_dask])
def test_workers_trace_nothing(folder, tmp_path_factory, monkeypatch, workers):
    """The calling process runs a first case, and keeps the programs that its workers find."""
    monkeypatch.setenv("SLIPPERJAX_CACHE", str(folder))
    cache.keep_in(None)
    monkeypatch.setattr(cache.Chosen, "is_known", False)
    place = tmp_path_factory.mktemp("stores")
    options = dict(transient=1, periods=1, steps_per_period=40, record="peak_force", progress=False)
    for name in ("first.zarr", "second.zarr"):
        with workers() as (call, executor):
            call(listen)
            sj.sweep(sj.paper_scene(), {"speed": [1200.0, 1250.0]}, store=place / name, executor=executor, **options)
            traced = call(heard)
            call(compile_one)
            assert len(call(heard)) > len(traced)
    assert traced == []
    assert kept_in(folder)
