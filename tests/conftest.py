"""Shapes and types of annotations are enforced; programs that are not kept already are compiled with little effort.

`pytest` alone leaves out tests marked `full`; named files, `-k`, `-m` and `--full` take them in. `-m slow` and
`-m benchmark` compile as users do, and so do the others with `XLA_FLAGS` of one's own, as in
`XLA_FLAGS=--xla_backend_optimization_level=3 pytest`.
"""

import contextlib
import importlib
import math
import os
import pkgutil
import platform
import shutil
import sys
import tempfile
import zlib
from pathlib import Path

import platformdirs
import pytest

# tests leave the user's cache alone, see `_share_programs`
os.environ["SLIPPERJAX_CACHE"] = "off"
EVERY_DAY = "not benchmark and not slow"
"""The marker expression of pyproject.toml."""
CACHE = "JAX_COMPILATION_CACHE_DIR"
"""JAX's own variable: a folder for compiled programs, by default one below the user's cache folder. They are found by
their content, so that a second run compiles what has changed."""
MOST = 1 << 31
"""Bytes of programs above which all are deleted before a run."""
MOST_MAPPINGS = 25_000
"""Parts of memory in which a process may keep its programs; Linux ends one of 65,530 (vm.max_map_count)."""
MOST_PAGES = 3_000_000_000 // 4096
"""Pages of memory from which on a process lets its programs go: with JAX 0.12 they took 7 GB in fewer parts."""


if sys.dont_write_bytecode:
    # half of the time before a first test goes into bytecode, which is kept elsewhere if not beside the sources
    sys.pycache_prefix = sys.pycache_prefix or str(Path(platformdirs.user_cache_dir("slipperjax"), "bytecode"))
    sys.dont_write_bytecode = False


def pytest_addoption(parser):
    parser.addoption("--full", action="store_true", help="take in the tests marked full, where no file is named")
    words = "count traced, lowered and compiled programs and processor seconds by test, and write FILE"
    parser.addoption("--programs", nargs="?", const="", default=None, metavar="FILE", help=words)
    words = "list the tolerances that are used up by more than a third, see tests/tolerances.py"
    parser.addoption("--tolerances", action="store_true", help=words)


def pytest_configure(config):
    whole_tree = config.args_source is config.ArgsSource.TESTPATHS
    if whole_tree and config.option.markexpr == EVERY_DAY and not (config.option.full or config.option.keyword):
        config.option.markexpr = f"{EVERY_DAY} and not full"
    if config.getoption("tolerances"):
        from .tolerances import Tolerances

        config.pluginmanager.register(Tolerances())
    if config.getoption("programs") is not None:
        from .programs import BUDGET, Programs

        file = config.getoption("programs")
        # the name of a test after the option would be taken for it, and written over
        if file and not file.endswith(".csv"):
            raise pytest.UsageError(f"--programs takes a file that ends in .csv, but is given {file}")
        of_all = whole_tree and config.option.markexpr == f"{EVERY_DAY} and not full"
        config.pluginmanager.register(Programs(file, BUDGET if of_all else math.inf))
        if not hasattr(config, "workerinput"):
            os.environ[CACHE] = tempfile.mkdtemp(prefix="slipperjax_tests_")
    if os.environ.get("SLIPPERJAX_PLAIN") == "1":
        config.addinivalue_line("filterwarnings", "ignore:slipperjax computes in its plain form")
    if config.getoption("markexpr") == "benchmark":
        return  # checks cost time, which benchmarks measure, as they measure compiling
    if config.getoption("markexpr") != "slow":
        # most of what is compiled runs for milliseconds; the same operations, in other instructions
        os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0")
    _share_programs()
    if config.getoption("numprocesses", None):
        return  # the tests run in workers, which come here too
    import jax
    from jaxtyping import install_import_hook

    # a conftest.py of a folder is read before
    assert "slipperjax" not in sys.modules, "the package is imported before its annotations can be checked"
    from . import shapes  # noqa: F401  (the hook finds it by its name)

    assert jax.config.jax_compilation_cache_dir == os.environ[CACHE]
    # what broadcasts silently is mostly a mistake
    jax.config.update("jax_numpy_rank_promotion", "raise")
    with install_import_hook("slipperjax", "tests.shapes.typechecked"):
        import slipperjax

        # all of them now, because the package imports its rooms at their first use, when the hook is gone
        for module in pkgutil.walk_packages(slipperjax.__path__, "slipperjax."):
            importlib.import_module(module.name)


def _share_programs():
    """Gives one cache to this process and those that it starts, by variables that JAX reads when it is imported."""
    if CACHE not in os.environ:
        os.environ[CACHE] = str(_folder())
    os.environ["SLIPPERJAX_CACHE"] = str(Path(os.environ[CACHE], "whole"))
    os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    os.environ["JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"] = "-1"
    # XLA logs an error for each program that it takes from the cache on processors with AVX-512 (jax #38445)
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")


def _folder() -> Path:
    """A folder for this kind of processor, whose programs may not run on another one; made where it can be."""
    features = platform.processor()
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()  # Linux
        features += "".join(sorted({line for line in lines if line.startswith(("flags", "Features", "model name"))}))
    folder = Path(platformdirs.user_cache_dir("slipperjax"), f"tests-{zlib.crc32(features.encode()):x}")
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if sum(file.stat().st_size for file in folder.rglob("*")) > MOST:
            shutil.rmtree(folder)
            folder.mkdir(mode=0o700)
    except OSError:
        return Path(tempfile.mkdtemp(prefix="slipperjax_tests_"))
    return folder


@pytest.fixture(autouse=True, scope="module")
def _few_programs():
    """Lets compiled programs go after a module, before they are too many for one process."""
    import jax

    from slipperjax.tools.kept import forget

    yield
    with contextlib.suppress(OSError):
        # Linux
        mappings = Path("/proc/self/maps").read_bytes().count(b"\n")
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        if mappings > MOST_MAPPINGS or pages > MOST_PAGES:
            jax.clear_caches()
            forget()


@pytest.fixture(autouse=True)
def _nothing_kept_of_what_is_changed(request):
    """Programs of a package that a test has changed are not those of its source."""
    if "monkeypatch" not in request.fixturenames:
        yield
        return
    from slipperjax.tools.cache import keep_in, kept_folder

    folder = kept_folder()
    keep_in(None)
    yield
    keep_in(folder)


@pytest.fixture
def own_cache(monkeypatch):
    """For tests of the cache itself: no folder of the session, neither here nor in processes that are started."""
    import jax
    from jax.experimental.compilation_cache.compilation_cache import reset_cache

    from slipperjax.tools.cache import Chosen

    folder = jax.config.jax_compilation_cache_dir
    monkeypatch.delenv(CACHE, raising=False)
    monkeypatch.setenv("SLIPPERJAX_CACHE", "off")
    jax.config.update("jax_compilation_cache_dir", None)
    # which stays in use where it was used before
    reset_cache()
    for name, value in (("is_known", False), ("path", None)):
        monkeypatch.setattr(Chosen, name, value)
    yield
    jax.config.update("jax_compilation_cache_dir", folder)
    reset_cache()
