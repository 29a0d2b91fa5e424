"""The command that shows results in the browser."""

import time
from pathlib import Path

import click

from ..tools.files import listed
from .options import CASE, FILE, FROM_ZERO, Case, app, flag, given, option, takes_case
from .sweep import Axis, axis, make_grid


@app.command(of="explorer.launch.explore")
@axis(
    "--over",
    "Horizontal axis of a map to compute: parameter, first value, last value, number of values.",
)
@axis("--by", "Vertical axis, likewise; without it a bifurcation diagram is computed.")
@option("--port", FROM_ZERO, "Port at which this machine serves the page; 0: any free port.")
@flag("--no-browser", "Print the address without opening a browser.")
@takes_case
@click.argument("source", metavar="[STORE|FILE|SCENE]", type=FILE, required=False)
def explore(case: Case, over: Axis | None, by: Axis | None, port: int, no_browser: bool, source: Path | None) -> int:
    """Look at a map in the browser: click a point to see the motion of this slipper, drag a box to compute it finer.

    STORE or FILE: a store or a netCDF file that sweep, bifurcation, lyapunov or run wrote. SCENE: a TOML file, for
    which a map is computed. To change a scene by options such as --mass, give it with --scene instead.
    """
    from ..explorer.launch import explore as serve

    # a result has its own scene, which options cannot change
    if source is not None and (of_case := given(*CASE)):
        raise ValueError(f"Argument {source} must not be given with {listed(of_case)}, which change --scene.")
    if without_effect := given("solver", "steps_per_period"):
        raise ValueError(f"Option {without_effect[0]} must not be given: the page takes the scene's own.")
    if by is not None and over is None:
        raise ValueError("Option --by needs --over.")
    grid = None if over is None else make_grid(case.scene, *filter(None, (by, over)))
    try:
        page = serve(case.scene if source is None else source, grid, start=case.start, port=port)
    except ImportError as error:  # its text says how to install Bokeh
        raise ValueError(str(error)) from None
    print(f"{page.url}  (Ctrl-C ends it)", flush=True)
    if not no_browser:
        page.open_browser()
    # the server has its own thread; this thread waits for Ctrl-C
    while True:
        time.sleep(1.0)
