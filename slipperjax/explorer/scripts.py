"""The script that computes the numbers which a page shows."""

from typing import Any

import jax
import numpy as np

from ..model.dang2024 import paper_scene
from ..model.scene import Scene, scene_to_toml
from ..model.scene_files import scene_to_json
from .session import PERIODS, SAVES, SLIDERS, Session, View


def python_of(session: Session) -> str:
    """The script: the map, the case, its orbit and its branch, as far as they are there."""
    lines = ["import numpy as np", "import slipperjax as sj", ""]
    lines += _map(session.view)
    case, shown = session.case, session.shown
    if case is not None:
        lines += ["", f"# the case that was looked at, from {case.origin}", f"scene = {scene_text(case.scene)}"]
        options = "".join(f", {name}={_option(value)}" for name, value in case.options.items())
        start = "" if case.start is None else f", start={start_text(case.start)}"
        saves = f", saves_per_period={SAVES}" if case.steps is not None and case.steps % SAVES == 0 else ""
        lines += [f"run = sj.simulate(scene, {PERIODS}{start}{options}{saves})", "ds = run.to_xarray()"]
        lines.append("sj.plots.overview(ds)")
        if session.orbit is not None and shown is not None:
            lines.append(f"orbit = sj.periodic_orbit(scene, {session.orbit.period}, start=run.end{options})")
        if session.branch is not None:
            name = session.branch.parameter.name
            bounds = ", ".join(f"{float(end)!r}" for end in session.branch_bounds(name))
            orbit = "start=orbit.state, period=orbit.period"
            lines.append(f"branch = sj.continue_orbit(scene, {name!r}, ({bounds}), {orbit})")
            lines.append("sj.plots.branches(branch)")
    text = "\n".join(lines) + "\n"
    return f"import jax.numpy as jnp\n{text}" if "jnp." in text else text


def _map(view: View) -> list[str]:
    if view.grid is None:
        if view.source is None:
            return ["# the map is a dataset of the session that opened the page"]
        return [f"map = sj.flow.dataset_of({str(view.source)!r})"]
    options = Session.sweep_options(view)
    given = ", ".join(f"{k}={start_text(v) if k == 'start' else repr(v)}" for k, v in options.items())
    grid = ", ".join(f"{name!r}: {_axis(values)}" for name, values in view.grid.items())
    draw = "sj.plots.attractor_map(map)" if len(view.grid) == 2 else "sj.plots.bifurcation(map, 'v_z')"
    return [f"scene = {scene_text(view.scene)}", f"map = sj.sweep(scene, {{{grid}}}, {given})", draw]


def _axis(values: np.ndarray) -> str:
    ends = f"{float(values[0])!r}, {float(values[-1])!r}, {len(values)}"
    even = np.array_equal(values, np.linspace(values[0], values[-1], len(values)))
    return f"np.linspace({ends})" if even else f"np.array({values.tolist()})"


def scene_text(scene: Scene) -> str:
    """A scene as an expression: by the paper's few numbers where these suffice, else as TOML or JSON."""
    if all(_number(scene, name) is not None for name in SLIDERS):
        values = {name: _number(scene, name) for name in SLIDERS}
        if scene_to_json(paper_scene(**values)) == scene_to_json(scene):
            return f"sj.paper_scene({', '.join(f'{name}={value!r}' for name, value in values.items())})"
    try:
        return f'sj.model.scene_from_toml("""\n{scene_to_toml(scene)}""").scene'
    except ValueError:  # for parts that TOML cannot hold
        return f"sj.model.scene_from_json({scene_to_json(scene)!r})"


def _number(scene: Scene, name: str) -> float | None:
    try:
        return float(scene.value(name))
    except ValueError:
        return None


def start_text(start: Any) -> str:
    """A motion or state as an expression, exact to the last bit."""
    if hasattr(start, "motion"):
        memory = "None" if start.memory is None else f"jnp.array({np.asarray(start.memory).tolist()})"
        return f"sj.State({start_text(start.motion)}, {memory})"
    numbers = jax.tree.map(float, vars(start))
    return f"sj.{type(start).__name__}({', '.join(f'{k}={v!r}' for k, v in numbers.items() if v)})"


def _option(value: Any) -> str:
    """A number of steps, or a solver by its name where it has no settings of its own."""
    return repr(value) if isinstance(value, int) else repr(type(value).__name__)
