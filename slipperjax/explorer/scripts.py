"""The script that computes the numbers which a page shows."""

from typing import Any

import diffrax
import jax
import numpy as np

from ..model.dang2024 import paper_scene
from ..model.scene import Scene, scene_to_toml
from ..model.scene_files import scene_to_json
from .session import PERIODS, SAVES, SLIDERS, Session


def python_of(session: Session) -> str:
    """The script: the map or the run, the case, its orbit and its branch, as far as they are there."""
    case, orbit, branch = session.case, session.orbit, session.branch
    lines = ["import numpy as np", "import slipperjax as sj", "", *_left(session), ""]
    if case.window is None:
        lines += [f"# the case that was looked at, from {case.origin}", f"scene = {scene_text(case.scene)}"]
        saves = SAVES if case.steps is not None and case.steps % SAVES == 0 else None
        call = f"{PERIODS}{_arguments(start=case.start, **case.options, saves_per_period=saves)}"
    else:
        scene, periods, begin = session.passage(case)
        lines += ["# the window that was looked at", *_state_at(session, begin)]
        lines += [f"scene = {scene_text(scene)}"] * (scene is not case.scene)
        call = f"{periods}, start=start{_arguments(begin=begin, **case.options, saves_per_period=case.steps)}"
    lines += [f"run = sj.simulate(scene, {call})", "sj.plots.overview(run)"]
    if orbit is not None:
        lines.append(f"orbit = sj.periodic_orbit(scene, {orbit.period}, start=run.end{_arguments(**case.options)})")
    if branch is not None:
        name = branch.parameter.name
        given = f"{name!r}, {session.branch_bounds(name)}, start=orbit.state, period=orbit.period"
        lines += [f"branch = sj.continue_orbit(scene, {given})", "sj.plots.branches(branch)"]
    text = "\n".join(lines) + "\n"
    return f"import jax.numpy as jnp\n{text}" if "jnp." in text else text


def _left(session: Session) -> list[str]:
    view = session.view
    if view.grid is not None:
        grid = ", ".join(f"{name!r}: {_axis(values)}" for name, values in view.grid.items())
        draw = "sj.plots.attractor_map(map)" if len(view.grid) == 2 else "sj.plots.bifurcation(map, 'v_z')"
        call = f"map = sj.sweep(scene, {{{grid}}}{_arguments(**Session.sweep_options(view))})"
        return [f"scene = {scene_text(view.scene)}", call, draw]
    source = "ds  # that with which the page was opened"
    source = source if view.source is None else f"sj.flow.dataset_of({str(view.source)!r})"
    if not view.is_run:
        return [f"map = {source}", "sj.plots.plot(map)"]
    lines = [f"given = {source}", "scene = sj.load_scene(given)"]
    if view.span is None or (window := session.finer(view.span)) is None:
        return [*lines, "sj.plots.run_overview(given)"]
    begin = session.way(view.span[0])[1]
    more = _arguments(begin=begin, window=window, **session.run_options)
    call = f"part = sj.run(scene, length={view.span[1] - begin!r}, start=start{more})"
    return [*lines, *_state_at(session, begin), call, "sj.plots.run_overview(part)"]


def _state_at(session: Session, distance: float) -> list[str]:
    """As `Session.state_at`."""
    kept, begin = session.way(distance)
    start = "given" if kept in session.run["stretch"] else "sj.load_start(given)"
    if kept == begin:
        return [f"start = {start}"]
    more = _arguments(begin=kept, window=float(session.run.attrs["window [m]"]), **session.run_options)
    return [f"start = sj.run(scene, length={begin - kept!r}, start={start}{more})"]


def _arguments(**values: Any) -> str:
    """Those arguments of a call that are not None, each after a comma."""
    text = {name: start_text(v) if name == "start" else _option(v) for name, v in values.items() if v is not None}
    return "".join(f", {name}={value}" for name, value in text.items())


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
        toml = scene_to_toml(scene)
    except ValueError:  # for parts that TOML cannot hold
        return f"sj.model.scene_from_json({scene_to_json(scene)!r})"
    toml = toml.replace("\\", "\\\\").replace('"""', '\\"\\"\\"')
    return f'sj.model.scene_from_toml("""\n{toml}""").scene'


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
    """An option as it is written, and a solver by its name where it has no settings of its own."""
    return repr(type(value).__name__ if isinstance(value, diffrax.AbstractSolver) else value)
