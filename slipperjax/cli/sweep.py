"""The commands that run many cases, and the commands for stores of cases."""

import json
import math
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from ..analysis.attractor import MIN_TEST
from ..model.parameters import PARAMETERS, STARTS, parameter
from ..model.scene import Scene
from ..tools.checks import require
from .files import Outputs, keeping, kept_in, make_folder, said
from .interrupts import on_thread
from .options import (
    COUNT,
    FILE,
    FROM_ZERO,
    LOST,
    VALUE,
    Adds,
    Case,
    app,
    begin,
    defaults,
    flag,
    of_module,
    option,
    parameters_of,
    result,
    shown_value,
    takes_case,
)

if TYPE_CHECKING:
    from ..results.result import Result
    from ..sweeps.store import Store

Axis = tuple[str, float | str, float | str, int]
"""Parameter, first and last value in the unit of `shown_value` or as texts with a unit, number of values."""
SWEEP = "sweeps.sweep.sweep"
LYAPUNOV_SWEEP = "sweeps.sweep.lyapunov_sweep"
PERIODS = {
    "exponents": lambda: defaults(LYAPUNOV_SWEEP)["periods"],
    "orbits": lambda: defaults("sweeps.sweep.orbit_sweep")["period"],
    "motion": lambda: MIN_TEST,
}
"""Default of --periods by the record; for other records the default of `sweep`."""


def axis(name: str, text: str, **more: Any) -> Adds:
    """Return an option that takes a parameter and the values over which it is varied."""
    return option(name, (str, VALUE, VALUE, COUNT), text, metavar="NAME FIRST LAST COUNT", **more)


over = axis(
    "--over",
    f"Parameter, first and last value, number of values. {parameters_of(PARAMETERS | STARTS)}",
    required=True,
)
log = option(
    "--log", str, "Space this parameter of --over or --by logarithmically; repeat for several.", multiple=True
)


transient = option("--transient", FROM_ZERO, "Forcing periods simulated before recording.")
show = option("--show", str, "Variable to draw; default: what suits the record.")


@app.command(of=SWEEP)
@over
@log
@transient
@option("--periods", COUNT, "Forcing periods to record.")
@begin
@result("bifurcation")
@takes_case
def bifurcation(case: Case, over: Axis, log: tuple[str, ...], out: Sequence[Path], **options) -> int:
    """Draw the five bifurcation diagrams over a parameter, from Poincare sections as in the paper's Fig. 5."""
    from ..sweeps.sweep import sweep as run

    grid = make_grid(case.scene, over, log=log)
    return _swept(run, case, grid, Outputs(out), **options)


@app.command(of=LYAPUNOV_SWEEP)
@over
@axis("--by", "Second parameter, like --over: draws a regime map.")
@log
@option("--count", COUNT, "Number of exponents to compute, the largest first.")
@transient
@option("--periods", COUNT, "Forcing periods over which exponents are averaged.")
@begin
@option("--certify/--no-certify", None, "Check every exponent by independent estimates.")
@option("--orbits/--no-orbits", None, "Replace exponents of periodic cases by those of their orbits.")
@result("lyapunov")
@takes_case
def lyapunov(case: Case, over: Axis, by: Axis | None, log: tuple[str, ...], out: Sequence[Path], **options) -> int:
    """Compute the largest Lyapunov exponents over one parameter, or over two as a regime map."""
    from ..sweeps.sweep import lyapunov_sweep

    grid = make_grid(case.scene, *filter(None, (over, by)), log=log)
    return _swept(lyapunov_sweep, case, grid, Outputs(out), **options)


@app.command(of=SWEEP)
@over
@axis("--by", "Further parameter, like --over; every combination is a case; repeat for more.", multiple=True)
@log
@option(
    "--sample",
    COUNT,
    "Number of points of a Sobol sample of the box of --over and --by, in place of every combination.",
)
@option(
    "--record",
    str,
    "Record of each case: sections, strobe, history, exponents, orbits, or numbers such as motion, "
    "peak_force, rms, or one of yours, my_module.name; repeat for several.",
    multiple=True,
)
@transient
@option(
    "--periods",
    COUNT,
    "Forcing periods to record; for orbits, their period. Default: 10, motion 200, exponents 500, orbits 1.",
    default=None,
)
@begin
@option(
    "--store", FILE, "Zarr store to write, such as map.zarr; the same command resumes where the last command ended."
)
@option("--tile", COUNT, "Number of cases that are computed and written together.")
@flag("--fresh", "Delete the contents of the store, and start again.")
@option("--share", str, "Compute only share I of N of the store, for the jobs of an array.", metavar="I/N")
@option("--processes", COUNT, "Number of processes that share the work; default: threads of one process.")
@option("--cluster", str, "Address of a dask scheduler, such as tcp://host:8786.")
@flag("--explain", "Print the time, memory and disk space that the sweep will need, and stop.")
@show
@result(None, " Default: sweep, or the name of the store, which is written as a picture alone.")
@takes_case
def sweep(
    case: Case,
    over: Axis,
    by,
    log,
    sample,
    record,
    periods,
    begin,
    store,
    explain,
    show,
    out: Sequence[Path],
    transient,
    **storing,
) -> int:
    """Simulate every combination of parameters, or a sample, into a file, or into a store that can be resumed."""
    from ..sweeps.explain import explain as estimate
    from ..sweeps.orbits import NearestOrbit
    from ..sweeps.sweep import sweep as run

    # the first record with its own default decides about the periods
    usual = next((PERIODS[name] for name in record if name in PERIODS), lambda: defaults(SWEEP)["periods"])
    periods = periods or usual()
    own = lambda name: of_module("--record", name) if "." in name else name
    # a single record is passed alone, as in scripts
    records = own(record[0]) if len(record) == 1 else list(map(own, record))
    if records == "orbits":
        records = NearestOrbit(periods)
    options = dict(transient=transient, periods=periods, record=records, begin=begin, product=sample is None)
    grid = make_grid(case.scene, over, *by, log=log, sample=sample)
    kept = target(store, **storing)
    if explain:
        options |= case.options
        print(on_thread(lambda: estimate(run, case.scene, grid, store=kept, **options)))
        return 0
    with _executor(storing["processes"], storing["cluster"]) as executor:
        if store is None:
            files = Outputs(out or [Path("sweep")])
        else:
            options |= dict(store=kept, executor=executor)
            # a share of a store is not drawn
            files = _of_store(store, out) if storing["share"] is None else None
        return _swept(run, case, grid, files, show, **options)


@app.command(of="sweeps.basins.basins")
@over
@axis("--start", "Coordinate of the start, like --over; repeat for more.", multiple=True)
@option("--count", COUNT, "Number of random starts within the values of --start, in place of every combination.")
@option("--seed", FROM_ZERO, "Seed of the random starts.")
@transient
@result("basins")
@takes_case
def basins(case: Case, over: Axis, start: Sequence[Axis], out: Sequence[Path], **options) -> int:
    """Find which share of starts leads to each attractor, over a parameter."""
    from ..sweeps.basins import basins as run

    grid = make_grid(case.scene, over, *start)
    starts = {name: grid[name] for name in grid if name in STARTS}
    rest = {name: grid[name] for name in grid if name not in STARTS}
    return _swept(lambda scene, _, **more: run(scene, starts, rest, **more), case, grid, Outputs(out), **options)


def make_grid(scene: Scene, *axes: Axis, log: Sequence[str] = (), sample: int | None = None) -> dict[str, np.ndarray]:
    """Return values in SI units by parameter name, logarithmically spaced for the names in `log`.

    **Arguments:** `axes`: of `--over` and of each `--by`; `sample`: number of points spread over the box of these
    axes, in place of every combination.

    **Raises:** `ValueError` that names the wrong option.
    """
    from ..sweeps.estimate import Estimate
    from ..sweeps.grid import sample_box

    grid = {}
    for name, first, last, count in axes:
        option = "--by" if grid else "--over"
        # coordinates of the start are no parameters of the scene
        quantity = STARTS.get(name) or parameter(name, scene)
        low = shown_value(quantity, first)
        high = shown_value(quantity, last)
        require(name not in grid, "--by", "name another parameter than --over", name)
        need = f"have values above zero where --log names {name}"
        require(name not in log or min(low, high) > 0, option, need, shown=f"{min(low, high):g}")
        quantity.check(quantity.from_shown(np.array([low, high])))
        count = count if sample is None else 2  # the sides of a box
        cases = count * math.prod(map(len, grid.values()))
        Estimate.counted(cases, 40, 0, " of one forcing period at least").check()  # before the grid takes the memory
        spread = np.geomspace if name in log else np.linspace
        grid[name] = quantity.from_shown(spread(low, high, count))
    for name in log:
        require(name in grid, "--log", "name a parameter of --over or --by", name)
    if sample is None:
        return grid
    box = {name: (values.min(), values.max()) for name, values in grid.items()}
    return sample_box(box, sample, log=log, scene=scene)


def target(
    store: Path | None,
    *,
    share: str | None,
    tile: int | None = None,
    fresh: bool = False,
    **engines: int | str | None,
) -> "Store | None":
    """Return the store that options describe; None without --store."""
    from ..sweeps.store import Store

    if store is None:
        for name, value in dict(share=share, tile=tile, fresh=fresh, **engines).items():
            require(not value, f"--{name}", "come with --store", value)
        return None
    # processes of this machine, or those of a cluster
    alone = not engines or None in engines.values()
    require(alone, "--cluster", "not be given with --processes", engines.get("cluster"))
    make_folder(store.parent, store)
    numbers = None
    if share is not None:
        # any other text gives fewer numbers than two
        numbers = tuple(int(part) for part in share.split("/") if part.isdigit())
        require(len(numbers) == 2, "--share", "be I/N, as 3/16", share)
    return Store(store, tile=tile, fresh=fresh, share=numbers)


def _executor(count: int | None, address: str | None) -> AbstractContextManager:
    """Return a context that yields the executor of tiles, or None for threads of this process."""
    from ..sweeps.store import processes

    if address is None:
        return nullcontext() if count is None else processes(count)
    _show_dask()
    try:
        from distributed import Client
    except ImportError:
        raise ValueError("Option --cluster needs dask: pip install 'slipperjax[cluster]'.") from None
    try:
        client = Client(address, timeout=10)
    except OSError as error:
        need = "be the address of a dask scheduler"
        raise ValueError(f"Option --cluster must {need}, but {address}: {error}") from None
    return client


def hide_dask() -> None:
    """Make dask count as not installed in this process, until --cluster needs it.

    Where dask is installed, xarray imports it with the first dataset, which takes half as long as importing JAX.
    """
    # xarray asks once whether dask is installed
    if "xarray" not in sys.modules:
        # with this entry Python finds no such module
        sys.modules.setdefault("dask", None)  # type: ignore[arg-type]


def _show_dask() -> None:
    """Make dask available again."""
    if sys.modules.get("dask", sys) is None:
        del sys.modules["dask"]


def _of_store(store: Path, out: Sequence[Path]) -> Outputs:
    """Return the files of a store, by default a picture with the store's name."""
    return Outputs(out or [store.with_suffix("")], usual=(".png",))


def _swept(
    function: "Callable[..., Result]",
    case: Case,
    grid: dict[str, np.ndarray],
    files: Outputs | None,
    show: str | None = None,
    **options,
) -> int:
    """Run a sweep, write and draw it, print a summary, and return the exit code; keep what an interrupt leaves.

    **Arguments:** `files`: None for a share of a store, which is not drawn; `options`: of `function`.
    """
    from ..flow.status import is_lost
    from ..sweeps.store import store_status

    store = options.get("store")
    path = None if store is None else store.path

    def keep(found: "Result") -> str:
        # a store has already written finished results
        if store is not None or files is None:
            return kept_in(path)
        return files.keep(found, drawn=_is_drawn(found))

    before = time.perf_counter()
    with keeping(keep, path):
        found = function(case.scene, grid, progress=True, **case.options, **options)
    seconds = time.perf_counter() - before
    keep_units(found, case)
    if files is None:
        assert store is not None
        said(f"share {store.share[0]}/{store.share[1]}: {store_status(store.path)}")
        return 0
    _write(found, files, show)
    said(case.text(grid), *found.summary(), f"{seconds:.1f} s with compiling")
    # one case with valid numbers gives a result
    return LOST if is_lost(found["status"].values).all() else 0


def keep_units(found: "Result", case: Case) -> None:
    """Add the units of the scene's file, if any, to a result, so that its pictures and later reports use them."""
    from ..plots.style import UNITS

    if case.file is not None:
        found.attrs[UNITS] = json.dumps(case.file.units)


def _is_drawn(found: "Result") -> bool:
    """Return whether a sweep has a picture; a sweep over more than two parameters has none."""
    if "share" in found.ds:
        # shares over one parameter, or a map of starts
        return 2 in {found.ds[name].ndim for name in ("share", "basin")}
    return found["status"].ndim <= 2


def _write(found: "Result", files: Outputs, show: str | None) -> None:
    """Write those files of a sweep that it can have."""
    drawn = _is_drawn(found)
    if not drawn:
        said(f"no picture of {found['status'].ndim} parameters: take a part of the data, and quantity_map")
    # a store without a picture needs no further file
    shown = {} if show is None else {"show": show}
    said(*filter(None, [files.write(found, drawn=drawn, **shown)]))


@app.group(no_args_is_help=False)
def store() -> None:
    """Inspect, check and draw stores that `sweep` wrote."""


path = click.argument("path", type=FILE)


@store.command()
@path
def status(path: Path) -> None:
    """Print how much of the store PATH is finished; it may still be growing."""
    from ..sweeps.store import store_status

    print(store_status(path))


@store.command()
@path
def check(path: Path) -> int:
    """Read the whole store PATH, and mark damaged tiles as missing, so that the next sweep computes them again.

    The exit code is 1 where tiles were damaged.
    """
    from ..sweeps.store import check_store, store_status

    damaged = check_store(path)
    print(f"damaged tiles: {damaged or 'none'}; {store_status(path)}")
    return 1 if damaged else 0


@store.command()
@path
@show
@result(None, " Default: a picture with the name of the store.")
def draw(path: Path, show: str | None, out: Sequence[Path]) -> None:
    """Draw the store PATH, which may still be growing."""
    from ..sweeps.loading import load
    from ..sweeps.store import store_status

    found = load(path)
    try:
        _write(found, _of_store(path, out), show)
    except RuntimeError as error:  # error of a checksum
        raise ValueError(f"{path} is damaged, see `slipperjax store check {path}`: {error}") from None
    said(str(store_status(path)))
