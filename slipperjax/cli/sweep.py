"""The command that runs grids of any size, and those that look after its stores."""

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import Annotated, Any, get_args

import typer

from ..tools.cache import compile_cache
from ..tools.checks import whole
from .commands import Once, app, exit_if_lost, flagged_cases, steps_text
from .files import Outputs
from .interrupts import on_thread
from .options import Case, GridAxis, Log, Over, Steps, axis_of, make_folder, make_grid, takes_case, without

stores = typer.Typer(help="Look after stores that `sweep` made.", rich_markup_mode=None)
app.add_typer(stores, name="store")

PERIODS = {"exponents": 500, "orbits": 1, "motion": 64}
"""Forcing periods by default, where they are not 10."""
FOLLOWED = {"--by": 4}
"""Options that can be repeated, and by how many words each is followed."""
ALONE = ("exponents", "orbits")
"""Records that are no part of a run's: they have functions of their own."""

OverOrNone = Annotated[GridAxis | None, *get_args(Over)[1:]]
ByEach = Annotated[
    list[str] | None,
    typer.Option(
        "--by",
        metavar="NAME FIRST LAST COUNT",
        help="A further parameter, like --over; repeat for more: every combination is a case.",
        show_default=False,
    ),
]
Record = Annotated[
    list[str] | None,
    typer.Option(
        help="What to keep of each case: sections, strobe, history, or numbers such as motion, peak_force, rms; "
        "repeat for several numbers. Alone: exponents, or orbits. Default: sections.",
        show_default=False,
    ),
]
StorePath = Annotated[
    Path | None,
    typer.Option(help="A zarr store to write, NAME.zarr; the same command goes on where the last one ended."),
]
Quantity = Annotated[str | None, typer.Option(help="Draw this variable; default what suits the record.")]


class _Axes(Once):
    """A command with options that are followed by a name and numbers, and can be repeated."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, list(_joined(args)))


def _joined(args: Sequence[str]) -> Iterator[str]:
    at = 0
    while at < len(args):
        word, at = args[at], at + 1
        yield word
        if word in FOLLOWED:
            words = list(takewhile(lambda text: not text.startswith("--"), args[at : at + FOLLOWED[word]]))
            yield " ".join(words)
            at += len(words)


@app.command(cls=_Axes)
@takes_case
def sweep(
    case: Case,
    over: OverOrNone = None,
    by: ByEach = None,
    log: Log = None,
    sample: Annotated[
        int | None,
        typer.Option(
            help="Instead of every combination, so many points spread over the box that --over and --by span (Sobol)."
        ),
    ] = None,
    record: Record = None,
    transient: Annotated[int, typer.Option(help="Forcing periods to pass before.")] = 300,
    periods: Annotated[
        int | None,
        typer.Option(help="Forcing periods to record; default 10, motion 64, exponents 500, orbits 1."),
    ] = None,
    steps_per_period: Steps = None,
    store: StorePath = None,
    tile: Annotated[int | None, typer.Option(help="Cases that are computed and written as one.")] = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Delete what the store holds, and start over.")] = False,
    chunk: Annotated[
        str | None,
        typer.Option(metavar="I/N", help="Compute the I-th of N shares of the store, as a job array does."),
    ] = None,
    processes: Annotated[int | None, typer.Option(help="Processes that share the work; default threads.")] = None,
    cluster: Annotated[str | None, typer.Option(help="Address of a dask scheduler, as tcp://host:8786.")] = None,
    explain: Annotated[bool, typer.Option("--explain", help="Say what it will take, and stop.")] = False,
    show: Quantity = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Where to write: OUT.png, and without a store OUT.nc; default sweep, or the store's name."),
    ] = None,
):
    """Run every combination of some parameters, or a sample, into a file or a store that survives anything."""
    from ..sweeps.explain import explain as estimate
    from ..sweeps.stores.archive import open_store, store_status

    function, options = _asked(record, transient, periods)
    options |= dict(steps_per_period=steps_per_period, solver=case.solver, start=case.start)
    grid = _grid(case, over, by, log, sample)
    options["product"] = sample is None
    target = _target(store, tile, fresh, chunk, processes, cluster)
    base = (
        without(".nc", ".png")(out) if out is not None else Path("sweep") if store is None else store.with_suffix("")
    )
    if explain:
        print(on_thread(lambda: estimate(function, case.scene, grid, store=target, **options)))
        return
    files = Outputs(base, *([".nc", ".png"] if store is None else [".png"]))
    draw, begin = partial(picture, show=show), time.perf_counter()
    with files.keeping(draw) if store is None else _kept(store), _executor(processes, cluster) as executor:
        more: dict[str, Any] = {} if target is None else dict(store=target, executor=executor)
        ds = function(case.scene, grid=grid, progress=True, **options, **more)
    seconds = time.perf_counter() - begin
    if chunk is not None:
        print(f"share {chunk}: {seconds:.1f} s; {store_status(store)}")
        return
    if store is None:
        files.write(ds, draw)
    else:
        _draw(open_store(store), draw, files)
    flagged, meanings = flagged_cases(ds)
    print(
        f"{ds['status'].size} cases, {steps_text(ds)} steps per period: {seconds:.1f} s; {flagged} flagged{meanings}"
    )
    exit_if_lost(ds)


def _asked(
    record: list[str] | None, transient: int, periods: int | None
) -> tuple[Callable[..., Any], dict[str, Any]]:
    """The function that makes a record, and its arguments."""
    from ..sweeps.exponents import lyapunov_sweep
    from ..sweeps.orbits import orbit_sweep
    from ..sweeps.sweep import sweep as run

    names = record or ["sections"]
    alone = [name for name in names if name in ALONE]
    if alone and len(names) > 1:
        raise ValueError(f"Option --record {alone[0]} must stand alone, but is given with others.")
    usual = next((PERIODS[name] for name in names if name in PERIODS), 10)
    count = usual if periods is None else whole("periods", periods, 1)
    whole("transient", transient, 0)
    if names == ["orbits"]:
        return orbit_sweep, dict(transient=transient, period=count)
    if names == ["exponents"]:
        return lyapunov_sweep, dict(transient=transient, periods=count)
    return run, dict(transient=transient, periods=count, record=names[0] if len(names) == 1 else names)


def _grid(case: Case, over: Any, by: list[str] | None, log: Any, sample: int | None) -> dict[str, Any]:
    """Values by name, of every combination or of a sample."""
    from ..sweeps.grid import sample_box

    if over is None:
        raise ValueError("Option --over must be given.")
    axes = [over, *(axis_of("--by", text) for text in by or ())]
    if sample is None:
        return make_grid(*axes, log=log)
    ends = make_grid(*((name, min(first, last), max(first, last), 2) for name, first, last, _ in axes))
    return sample_box({n: tuple(v) for n, v in ends.items()}, sample, log=log or (), scene=case.scene)


def _target(store: Path | None, tile: Any, fresh: bool, chunk: Any, *engines: Any) -> Any:
    """The store that options describe."""
    from ..sweeps.stores.target import Store

    if store is None:
        names = ("tile", "fresh", "chunk", "processes", "cluster")
        for name, value in zip(names, (tile, fresh, chunk, *engines), strict=True):
            if value:
                raise ValueError(f"Option --{name} needs --store.")
        return None
    if all(engine is not None for engine in engines):
        raise ValueError("Option --cluster must not be given with --processes.")
    make_folder(store.parent, store)
    return Store(store, tile=tile, fresh=fresh, share=None if chunk is None else _share(chunk))


def _share(text: str) -> tuple[int, int]:
    i, _, n = text.partition("/")
    if not (i.isdigit() and n.isdigit() and 1 <= int(i) <= int(n)):
        raise ValueError(f"Option --chunk must be I/N with I from 1 to N, as 3/16, but is {text!r}.")
    return int(i), int(n)


@contextmanager
def _executor(count: int | None, address: str | None) -> Iterator[Any]:
    """What computes tiles, or None for threads of this process."""
    from ..sweeps.stores.processes import processes

    if address is not None:
        try:
            from distributed import Client
        except ImportError:
            raise ValueError("Option --cluster needs dask: pip install 'slipperjax[cluster]'.") from None
        try:
            client = Client(address, timeout=10)
        except OSError as error:
            raise ValueError(
                f"Option --cluster must be the address of a dask scheduler, but {address}: {error}"
            ) from None
        with client:
            client.run(compile_cache)
            yield client
    else:
        with nullcontext() if count is None else processes(count) as pool:
            yield pool


@contextmanager
def _kept(store: Path) -> Iterator[None]:
    """Around a sweep into a store: says after an interrupt what it holds."""
    from ..flow.status import Interrupted

    try:
        yield
    except Interrupted as stop:
        if stop.result is None:
            print("nothing is stored yet", file=sys.stderr)
        else:
            kept = f"{stop.finished} of {stop.of} cases are in {store}; the same command goes on"
            print(kept, file=sys.stderr)
        raise


def picture(ds: Any, show: str | None = None) -> Any:
    """What suits a dataset: a named variable, exponents, bifurcation diagrams, motions or peak forces."""
    from ..plots.bifurcations import bifurcations
    from ..plots.maps import attractor_map, exponents, quantity_map, regime_map

    dims = len(ds["status"].dims)
    if show is not None:
        return quantity_map(ds, show)
    if "regime" in ds and dims <= 2:
        return (exponents if dims == 1 else regime_map)(ds)
    if "v_z_period" in ds and dims == 1 and ds["status"].dims != ("case",):
        return bifurcations(ds)
    if {"kind", "period"} <= set(ds) and dims == 2:
        return attractor_map(ds)
    over = set(ds["status"].dims)
    numbers = [str(n) for n, v in ds.data_vars.items() if over <= set(v.dims) and v.dtype.kind == "f"]
    return quantity_map(ds, "peak_force" if "peak_force" in ds else (numbers or ["steps_per_period"])[0])


def _draw(ds: Any, draw: Callable[[Any], Any], files: Outputs) -> None:
    """Writes a picture, where there are few enough parameters for one."""
    if len(ds["status"].dims) > 2:
        print(f"no picture of {len(ds['status'].dims)} parameters: take a part of the store, and quantity_map")
    else:
        files.draw(ds, draw)


Path_ = Annotated[Path, typer.Argument(help="The store, NAME.zarr.")]


@stores.command(cls=Once)
def status(path: Path_):
    """Say how far a store is; it may still be growing."""
    from ..sweeps.stores.archive import store_status

    print(store_status(path))


@stores.command(cls=Once)
def check(
    path: Path_,
    repair: Annotated[
        bool, typer.Option("--repair", help="Make damaged tiles absent, so that the next run computes them.")
    ] = False,
):
    """Read all of a store, and say what is damaged; exit code 1 where something is."""
    from ..sweeps.stores.archive import check_store, store_status

    lines = check_store(path, repair=repair)
    print("\n".join(lines) if lines else f"nothing is damaged: {store_status(path)}")
    if lines:
        raise typer.Exit(1)


@stores.command(cls=Once)
def draw(
    path: Path_,
    show: Quantity = None,
    out: Annotated[Path | None, typer.Option(help="The picture is OUT.png; default the store's name.")] = None,
):
    """Draw a store, which may still be growing."""
    from ..sweeps.stores.archive import open_store, store_status

    base = path.with_suffix("") if out is None else without(".png")(out)
    files = Outputs(base, ".png")
    _draw(open_store(path), partial(picture, show=show), files)
    print(store_status(path))
