"""The command that runs a scene over a length of rail, and says in words what a test would ask."""

import contextlib
from collections.abc import Iterator, Mapping
from typing import Any

import click

from ..tools.units import STANDARD_GRAVITY, unit_factor, unit_in
from .files import Outputs, keeping, step_error
from .options import FILE, LOST, Case, app, begin, given, result, takes_case


def _page(ds: Any) -> Any:
    # imported when it draws: compiling need not wait for it
    from ..plots.runs import run_overview

    return run_overview(ds)


@app.command()
@begin
@result("run")
@takes_case
@click.argument("scene", metavar="FILE", type=FILE)
def run(case: Case, begin: float | None, out: Any) -> int:
    """Run the scene of FILE over a length of rail, as its table [run] says, at a speed that may change.

    FILE: a TOML file with a table [run], as in length = "5 km".
    """
    from ..flow.datasets import load_run
    from ..flow.status import Status
    from ..sweeps.runs import run as over_rail

    table = load_run(click.get_current_context().params["scene"])
    options = case.options | {"begin": begin} | {name: value for name, value in table.items() if not given(name)}
    files = Outputs(out, ".nc", ".png")
    with keeping(lambda ds: files.write(ds, _page, partial=True)):
        ds = over_rail(case.scene, **options, probe=PROBES, progress=True)
    print(files.write(ds, _page))
    print(f"{case.text()}\n{report(ds, case.scene, units_of(click.get_current_context().params['scene']))}")
    return LOST if int(ds["status"]) == Status.NOT_FINITE else 0


PROBES = 3
"""Places of a run where its error is measured by half the step."""
UNITS = {"m": "m", "m/s": "m/s", "N": "kN"}
"""Units of distances, speeds and forces by the SI unit, where a file has none."""


def units_of(file: Any) -> dict[str, str]:
    """Units of distances, speeds and forces, those of the tables [run], [speed] and [load] of a file: see `UNITS`."""
    import tomllib
    from pathlib import Path

    tables = tomllib.loads(Path(file).read_text(encoding="utf-8-sig"))
    asked = {"m": tables["run"], "m/s": tables.get("speed"), "N": tables.get("load")}
    return {si: next(_units_in(table, si), UNITS[si]) for si, table in asked.items()}


def _units_in(value: Any, si: str) -> Iterator[str]:
    """The units of a kind in the texts of a table, such as "900 km/h" or unit = "lbf", in their order."""
    if isinstance(value, dict | list):
        for part in value.values() if isinstance(value, dict) else value:
            yield from _units_in(part, si)
    elif isinstance(value, str):
        unit = unit_in(value)
        with contextlib.suppress(ValueError):
            unit_factor("unit", unit, si)
            yield unit


def report(ds: Any, scene: Any, units: Mapping[str, str] = UNITS) -> str:
    """A run in words, a line for each answer, in units by the SI unit; what is not known is left out."""
    import numpy as np

    from ..flow.status import Status
    from ..model.quantities import ACCELERATIONS
    from ..plots.runs import edges_of, peak_of

    # rounded first, because large numbers would be written as powers of ten
    rounded = lambda value, si, digits: float(f"{value / unit_factor('', units[si], si):.{digits}g}")
    number = lambda value, si, digits=4: f"{rounded(value, si, digits):.12g}"
    in_words = lambda value, si, digits=4: f"{number(value, si, digits)} {units[si]}"
    speed, seconds = ds["speed"].values, float(ds["seconds"][-1])
    edges, at, status = edges_of(ds, "stretch"), peak_of(ds), Status(int(ds["status"]))
    from_to = lambda low, high: f"{number(low, 'm', 6)} to {in_words(high, 'm', 6)}"
    speeds = dict.fromkeys(number(value, "m/s") for value in (speed.min(), speed.max()))
    lines = [f"{from_to(edges[0], edges[-1])} in {seconds:.4g} s, speed {' to '.join(speeds)} {units['m/s']}"]
    if (peak := float(at["peak_force"])) > 0:
        place, there = float(at["peak_distance"]), float(at["speed"])
        where = f"{at['name'].item()} ({at['end'].item()}), {in_words(place, 'm', 6)} and {in_words(there, 'm/s')}"
        static = static_load(scene, there)
        times = f": {peak / static:.3g} times the static load of {in_words(static, 'N')}" if static > 0 else ""
        lines.append(f"highest contact force {in_words(peak, 'N')} at {where}{times}")
    if status != Status.NOT_FINITE:
        impacts = float(ds["impacts"].sum())
        lines.append(f"{impacts:.0f} impacts, {impacts / seconds:.4g} per second")
        most = [(f"{name} ", float(ds[f"peak_{name}"].max()), q.unit) for name, q in ACCELERATIONS.items()]
        lines.append(f"greatest accelerations: {', '.join(name + _with_g(*value) for name, *value in most)}")
        if "friction_work" in ds:
            lines.append(f"friction work {float(ds['friction_work'].sum()) / 1e3:.4g} kJ")
        percentile, rms = ds["peak_force_percentile"].sel(percentile=99).values, ds["rms_a_z"].values
        for values, words, in_unit in (
            (percentile, "99th percentile of the windows' highest forces", lambda value: in_words(value, "N")),
            (rms, "RMS of a_z", lambda value: _with_g(value, "m/s^2")),
        ):
            k = int(np.argmax(values))
            lines.append(f"worst {words}: {in_unit(values[k])} from {from_to(edges[k], edges[k + 1])}")
        if "probe_error" in ds:
            lines.append(step_error(scene, ds["probe_error"].values))
    return "\n".join([*lines, f"status: {status}"])


def _with_g(value: float, unit: str) -> str:
    """An acceleration, a linear one in multiples of standard gravity, too."""
    return f"{value:.4g} {unit}" + (f" ({value / STANDARD_GRAVITY:.3g} g)" if unit == "m/s^2" else "")


def static_load(scene: Any, speed: float) -> float:
    """Resultant across the rail of weight and load at a speed [N]."""
    import numpy as np

    from ..model.dynamics import driven_mass

    _, y, z = (0.0, 0.0, 0.0) if scene.load is None else map(float, scene.load.wrench(speed)[0])
    weight = 0.0 if scene.gravity is None else float(driven_mass(scene) * scene.gravity)
    return float(np.hypot(y, z - weight))
