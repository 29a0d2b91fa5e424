"""The command that shows results in the browser."""

import time
from typing import Any

import click

from ..tools.files import listed
from .options import CASE, FILE, FROM_ZERO, Case, app, flag, given, option, takes_case
from .sweep import axis, make_grid


@app.command()
@axis(
    "--over",
    "Parameter from left to right of a map that is computed: first and last value, and how many.",
)
@axis("--by", "Parameter upwards, likewise; without it a bifurcation diagram is computed.")
@option("--port", FROM_ZERO, "Port of the loopback address; 0 for one that is free.", default=0)
@flag("--no-browser", "Print the address, and open no browser.")
@takes_case
@click.argument("source", metavar="[STORE|FILE|SCENE]", type=FILE, required=False)
def explore(case: Case, over: Any, by: Any, port: int, no_browser: bool, source: Any) -> int:
    """Look at a map in the browser: click a point to see how that slipper moves, drag a box to compute it finer.

    STORE, FILE: a store or a netCDF file of sweep, bifurcation, lyapunov or run. SCENE: a TOML file, whose map is
    computed. Options that change the case go with --scene in place of it.
    """
    from ..explorer.launch import explore as serve

    if source is not None and (of_case := given(*CASE)):
        raise ValueError(f"Argument {source} must not be given with {listed(of_case)}, which change --scene.")
    if without_effect := given("solver", "steps_per_period"):
        raise ValueError(f"Option {without_effect[0]} must not be given: the page takes the scene's own.")
    if by is not None and over is None:
        raise ValueError("Option --by needs --over.")
    grid = make_grid(case.scene, *([] if by is None else [by]), over) if over is not None else None
    try:
        page = serve(case.scene if source is None else source, grid, start=case.start, port=port)
    except ImportError as error:
        raise ValueError(str(error)) from None
    print(f"{page.url}  (Ctrl-C ends it)", flush=True)
    if not no_browser:
        page.open_browser()
    while True:
        time.sleep(1.0)
