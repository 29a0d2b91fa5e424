"""The command that runs a scene over a length of rail, and reports what a track test would measure."""

from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np

from ..flow.status import Status
from ..model.scene import Scene
from ..tools.units import STANDARD_GRAVITY
from .files import Outputs, keeping, step_error
from .options import FILE, LOST, Case, app, begin, given, result, takes_case

if TYPE_CHECKING:
    import xarray


@app.command()
@begin
@result("run")
@takes_case
@click.argument("scene", metavar="FILE", type=FILE)
def run(case: Case, begin: float | None, out: Path) -> int:
    """Run the scene of FILE along a length of rail, at a speed that may change, as its table [run] says.

    FILE: a TOML file with a table [run], which has a length, such as length = "5 km".
    """
    from ..flow.datasets import load_run
    from ..sweeps.runs import run as over_rail

    table = load_run(click.get_current_context().params["scene"])
    # options that the user gave override the file
    of_file = {name: value for name, value in table.items() if not given(name)}
    options = case.options | {"begin": begin} | of_file
    files = Outputs(out, ".nc", ".png")
    with keeping(lambda ds: files.write(ds, partial=True)):
        ds = over_rail(case.scene, **options, probe=3, progress=True)
    print(files.write(ds))
    print(f"{case.text()}\n{report(ds, case.scene)}")
    return LOST if int(ds["status"]) == Status.NOT_FINITE else 0


def report(ds: "xarray.Dataset", scene: Scene) -> str:
    """Return a run in words, a line for each result that it has."""
    from ..model.quantities import ACCELERATIONS
    from ..plots.runs import edges_of

    speed = ds["speed"].values
    seconds = float(ds["seconds"][-1])
    edges = edges_of(ds, "stretch")
    status = Status(int(ds["status"]))
    # one speed where it does not change
    speeds = dict.fromkeys((f"{speed.min():.4g}", f"{speed.max():.4g}"))
    lines = [f"{edges[0]:.6g} to {edges[-1]:.6g} m in {seconds:.4g} s, speed {' to '.join(speeds)} m/s"]
    lines += _peak(ds, scene)
    # numbers of a lost run mean nothing
    if status != Status.NOT_FINITE:
        impacts = float(ds["impacts"].sum())
        lines.append(f"{impacts:.0f} impacts, {impacts / seconds:.4g} per second")
        most = [f"{name} {_with_g(float(ds[f'peak_{name}'].max()), q.unit)}" for name, q in ACCELERATIONS.items()]
        lines.append(f"greatest accelerations: {', '.join(most)}")
        # recorded only where the scene has friction
        if "friction_work" in ds:
            lines.append(f"friction work {float(ds['friction_work'].sum()) / 1e3:.4g} kJ")
        percentile = ds["peak_force_percentile"].sel(percentile=99).values / 1e3
        lines.append(_worst("99th percentile of the windows' highest forces", percentile, "kN", edges))
        lines.append(_worst("RMS of a_z", ds["rms_a_z"].values, "m/s^2", edges))
        if "probe_error" in ds:
            lines.append(step_error(scene, ds["probe_error"].values))
    return "\n".join([*lines, f"status: {status}"])


def _peak(ds: "xarray.Dataset", scene: Scene) -> list[str]:
    """Return the highest contact force and where it was as one line, or none without contact."""
    from ..plots.runs import peak_of

    at = peak_of(ds)
    peak = float(at["peak_force"])
    # NaN, too, is no peak
    if not peak > 0:
        return []
    speed = float(at["speed"])
    place = f"{at['name'].item()} ({at['end'].item()}), {float(at['peak_distance']):.6g} m and {speed:.4g} m/s"
    # how much harder than at rest; without gravity and load nothing to compare with
    static = static_load(scene, speed)
    times = f": {peak / static:.3g} times the static load of {static / 1e3:.4g} kN" if static > 0 else ""
    return [f"highest contact force {peak / 1e3:.4g} kN at {place}{times}"]


def _worst(words: str, values: np.ndarray, unit: str, edges: np.ndarray) -> str:
    """Return in words the largest of the stretches' values, and that stretch."""
    k = int(values.argmax())
    return f"worst {words}: {_with_g(values[k], unit)} from {edges[k]:.6g} to {edges[k + 1]:.6g} m"


def _with_g(value: float, unit: str) -> str:
    """Return a value with its unit; an acceleration also in g."""
    return f"{value:.4g} {unit}" + (f" ({value / STANDARD_GRAVITY:.3g} g)" if unit == "m/s^2" else "")


def static_load(scene: Scene, speed: float) -> float:
    """Return the resultant of weight and applied load across the rail at a speed [N]."""
    from ..model.dynamics import driven_mass

    # gravity pulls downward, a load in any direction
    y = z = 0.0
    if scene.load is not None:
        force, _ = scene.load.wrench(speed)
        y, z = float(force[1]), float(force[2])
    weight = 0.0 if scene.gravity is None else float(driven_mass(scene) * scene.gravity)
    return float(np.hypot(y, z - weight))
