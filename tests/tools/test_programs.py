"""Programs in a folder: found again without tracing, never for anything else, and never a failure."""

import dataclasses
import enum
import functools
import itertools
import os
import shutil
import subprocess
import sys
from pathlib import Path

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slipperjax as sj
from slipperjax import sweeps
from slipperjax.flow.recorders import Strobe
from slipperjax.tools import programs as programs_module
from slipperjax.tools.compile import TRACING, jit
from slipperjax.tools.program_cache import compile_cache
from slipperjax.tools.programs import ENDING, Folder, NotNamed, kind_of, named, whole_program

SIMULATE = """
import sys
import jax
import slipperjax as sj

traced = []
jax.monitoring.register_event_listener(lambda name, **_: traced.append(name) if name == "/slipperjax/tracing" else 0)
place = sj.compile_cache()
found = sj.simulate(sj.paper_scene(speed=float(sys.argv[1])), 4, steps_per_period=50, saves_per_period=1, loads=False)
print(place, len(traced), found.end.motion.y.item().hex(), found.end.motion.w_x.item().hex())
"""


def run(folder: Path | str, speed: float = 1200.0, **variables: str) -> tuple[Path, int, list[str]]:
    """The folder of a fresh process that simulates, how often it traces, and what it finds."""
    environment = {**os.environ, "SLIPPERJAX_CACHE": str(folder)} | variables
    done = subprocess.run(
        [sys.executable, "-c", SIMULATE, str(speed)], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    place, traced, *values = done.stdout.split()
    return Path(place), int(traced), values


def programs(place: Path) -> list[Path]:
    return sorted(place.glob(f"*{ENDING}"))


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """A folder that a process has filled, how often it traced, and what it found."""
    folder = tmp_path_factory.mktemp("programs")
    place, traced, values = run(folder)
    assert traced == len(programs(place)) > 0
    assert all(whole_program(path.read_bytes()) for path in programs(place))
    assert not list(place.glob("*.part"))
    return folder, traced, values


def test_a_second_process_traces_nothing_and_finds_the_same_bits(first):
    folder, traced, values = first
    assert run(folder)[1:] == (0, values)
    assert run("off")[2] == values
    # other numbers take the same programs
    assert run(folder, 1300.0)[1] == 0
    # settings that programs depend on make others
    assert run(folder, JAX_DEFAULT_MATMUL_PRECISION="highest")[1] == traced


def test_damaged_files_are_made_again(first, tmp_path):
    shutil.copytree(first[0], tmp_path, dirs_exist_ok=True)
    damage = [lambda b: b[:-9], lambda b: b"", lambda b: b[:99] + bytes([b[99] ^ 1]) + b[100:]]
    place = next(tmp_path.iterdir())
    for path, spoil in zip(programs(place), itertools.cycle(damage), strict=False):
        path.write_bytes(spoil(path.read_bytes()))
    assert run(tmp_path)[1:] == first[1:]
    # what was compiled once more is whole: JAX's own cache, whose programs cannot be written down, had no part in it
    assert run(tmp_path)[1:] == (0, first[2])


def test_what_jax_takes_from_its_own_cache_is_not_written_down(tmp_path, monkeypatch):
    folder, kept = Folder(tmp_path), []
    monkeypatch.setattr(programs_module, "_keep", lambda path, program: kept.append(path))

    class Lowered:
        """Of JAX, whose cache has what it is compiled to, or has not."""

        def __init__(self, hit):
            self.hit = hit

        def compile(self):
            if self.hit:
                jax.monitoring.record_event("/jax/compilation_cache/cache_hits")
            return jax.jit(lambda x: [x + 1]).lower(1.0).compile()

    for hit in (True, False):
        lower = lambda mark, hit=hit: (Lowered(hit), jax.tree.structure(0))
        program = folder.program(sj.simulate, hit, jax.tree.structure(0), [1.0], lower).result()
        assert program([2.0]) == 3.0
    assert len(kept) == 1


class Colour(enum.Enum):
    RED = 1


@dataclasses.dataclass(frozen=True)
class OfAUser:
    x: int = 0


def of_a_user(x):
    return x


def test_names_differ_where_programs_do():
    scene = sj.paper_scene()
    structure = jax.tree.structure
    values = [
        None,
        1,
        1.0,
        True,
        "1",
        (1, 2),
        [1, 2],
        ((1,), 2),
        {"a": 1},
        np.arange(3),
        np.arange(3.0),
        np.arange(4),
        np.float64(1),
        np.dtype("f8"),
        np.dtype("f4"),
        sj.RK4(),
        sj.Rodas4(),
        sj.RK4,
        diffrax.Tsit5(),
        sj.Latching(diffrax.Kvaerno5()),
        sj.Latching(diffrax.Kvaerno3()),
        Strobe(),
        sj.simulate,
        sj.initial_state,
        jnp.sin,
        sj.Status.FINITE,
        sj.Status.NOT_FINITE,
        structure(scene),
        structure(sj.paper_scene(memory=sj.SmoothSwitch())),
        structure((1, 2)),
        structure([1, 2]),
        structure((1, (2,))),
        structure((1, None)),
    ]
    names = [named(value) for value in values]
    assert len(set(names)) == len(names)
    assert named(structure(sj.paper_scene(speed=2000.0))) == named(structure(scene))


@pytest.mark.parametrize(
    "value",
    [OfAUser(), of_a_user, lambda x: x, Colour.RED, object(), (1, of_a_user), np.array([None]), {1, 2}, iter(())],
    ids=["class", "function", "lambda", "enum", "object", "tuple", "objects", "set", "iterator"],
)
def test_what_is_not_of_this_package_has_no_name(value):
    with pytest.raises(NotNamed):
        named(value)


def test_functions_inside_others_have_no_name():
    with pytest.raises(NotNamed):
        named(sj.flow.Reduced(lambda ds: ds))
    inner = functools.partial(sj.simulate, periods=3)
    with pytest.raises(NotNamed):
        named(inner)


def test_kinds_of_leaves():
    assert kind_of(jnp.zeros(3)) == kind_of(np.zeros(3)) == ((3,), np.dtype("f8"), False)
    assert len({kind_of(x) for x in (1, 1.0, True, 1j, np.float64(1), jnp.asarray(1.0), np.int64(1))}) == 7
    with pytest.raises(NotNamed):
        kind_of("text")


def times(x, factor, *, power=1):
    return {"y": (factor * x) ** power}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Programs are kept in a folder in this process, for one test."""
    found = Folder(tmp_path)
    monkeypatch.setattr(programs_module, "_KEPT", [found])
    return found


TRACED = []
jax.monitoring.register_event_listener(lambda name, **_: TRACED.append(name) if name == TRACING else None)


def test_calls_with_a_folder_are_those_without(folder, monkeypatch):
    monkeypatch.setattr(programs_module, "_NAMED", {*programs_module._NAMED, __name__.partition(".")[0]})
    compiled = jit(times, static_argnames=("power",))
    TRACED.clear()
    for x in (2.0, np.float64(2), jnp.asarray(2.0), jnp.arange(3.0), 2):
        for power in (1, 2):
            expected = times(x, 3.0, power=power)["y"]
            found = compiled(x, 3.0, power=power)["y"]
            assert np.array_equal(found, expected)
            assert compiled(x, factor=3.0, power=power)["y"].dtype == jnp.asarray(expected).dtype
    assert len(programs(folder.place)) == len(TRACED) == 20  # 5 kinds of x, 2 powers, by place and by name
    # a static argument by its place, and inside transformations
    assert compiled(2.0, 3.0)["y"] == 6.0
    assert jax.jit(lambda x: compiled(x, 3.0, power=2)["y"])(2.0) == 36.0
    assert jax.grad(lambda x: compiled(x, 3.0, power=2)["y"])(2.0) == 36.0
    assert jax.vmap(lambda x: compiled(x, 3.0, power=2)["y"])(jnp.arange(2.0)).tolist() == [0.0, 9.0]


def test_changed_settings_are_left_to_jax(folder):
    assert folder.usable
    with jax.debug_nans(True):
        assert not folder.usable
    with jax.default_matmul_precision("highest"):
        assert not folder.usable
    assert folder.usable


def test_an_error_while_tracing_is_raised_each_time(folder):
    calls = []

    def make(mark):
        calls.append(mark)
        raise ValueError("wrong")

    for _ in range(2):
        with pytest.raises(ValueError, match="wrong"):
            folder.program(sj.simulate, 1, jax.tree.structure(0), [1.0], make)
    assert len(calls) == 2


def test_a_folder_that_is_gone_is_no_failure(folder):
    folder.place.rmdir()
    found = sj.simulate(sj.paper_scene(), 1, steps_per_period=50)
    assert bool(jnp.isfinite(found.end.motion.y))
    assert not folder.place.exists()


def test_the_source_code_is_part_of_a_name(folder, monkeypatch, tmp_path):
    before = folder._made_from
    assert Folder(tmp_path)._made_from == before
    monkeypatch.setattr(Path, "read_bytes", lambda path, read=Path.read_bytes: read(path) + b"#")
    assert Folder(tmp_path)._made_from != before


@pytest.mark.parametrize("kept", [False, True])
def test_prepared_programs_are_not_compiled_again(kept, request, monkeypatch):
    if kept:
        request.getfixturevalue("folder")
        monkeypatch.setattr(programs_module, "_NAMED", {*programs_module._NAMED, __name__.partition(".")[0]})
    compiled = jit(times, static_argnames=("power",))
    TRACED.clear()
    for _ in range(2):
        compiled.prepare(jnp.arange(5.0), 7.0, power=3)
    assert compiled(jnp.arange(5.0), 7.0, power=3)["y"][1] == 343.0
    assert len(TRACED) == 1
    # the call itself says what is wrong
    compiled.prepare(jnp.arange(5.0), jnp.arange(3.0))
    with pytest.raises(TypeError, match="shapes"):
        compiled(jnp.arange(5.0), jnp.arange(3.0))
    # inside other programs there is nothing to prepare
    jax.jit(lambda x: compiled.prepare(x, 1.0))(1.0)


@pytest.mark.parametrize(
    "run",
    [
        lambda: sj.sweep(sj.paper_scene(), {"speed": [700.0, 1200.0]}, transient=10, periods=2),
        lambda: sj.lyapunov_sweep(sj.paper_scene(), {"speed": [1200.0]}, transient=300, periods=50),
    ],
    ids=["sweep", "exponents"],
)
def test_sweeps_prepare_the_programs_that_they_call(run, monkeypatch):
    def keys(name):
        found = []
        for module in (sweeps.executors, sweeps.maps):
            own = getattr(module, name, None)
            if own is not None:

                def call(*args, _own=own, **options):
                    found.append(key_of(args, options))
                    return _own(*args, **options)

                call.prepare = lambda *args, _own=own, **options: prepared.append((name, key_of(args, options)))
                monkeypatch.setattr(module, name, call)
        return found

    def key_of(args, options):
        static = {k: v for k, v in options.items() if k in ("solver", "periods", "recorder")}
        others = jax.tree.flatten((args, {k: v for k, v in options.items() if k not in static}))
        return tuple((k, static[k]) for k in sorted(static)), others[1], tuple(map(jax.typeof, others[0]))

    prepared: list = []
    called = {name: keys(name) for name in ("advance", "batch_jacobians")}
    run()
    assert prepared
    for name, key in prepared:
        assert key in called[name]


def test_no_folder_where_the_cache_is_off(monkeypatch):
    monkeypatch.setenv("SLIPPERJAX_CACHE", "off")
    monkeypatch.setattr(programs_module, "_KEPT", [])
    assert compile_cache() is None
    assert programs_module.programs_kept() is None
