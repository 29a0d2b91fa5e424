"""The script that computes the numbers which a page shows."""

from typing import Any

import diffrax
import jax
import numpy as np

from ..model.dang2024 import paper_scene
from ..model.scene import Scene
from ..model.scene_files import scene_to_json
from .session import PERIODS, SAVES, SLIDERS, Session


def python_of(session: Session) -> str:
    """Return the script: the map or the run, the case, its orbit and its branch, as far as they are there."""
    case, orbit, branch = session.case, session.orbit, session.branch
    lines = ["import jax.numpy as jnp", "import numpy as np", "import slipperjax as sj", "", *_left(session), ""]
    # a steady motion, or a window of a run
    if case.window is None:
        lines += [f"# the case that was looked at, from {case.origin}", f"scene = {scene_text(case.scene)}"]
        saves = None if case.steps is not None and case.steps % SAVES else SAVES
        call = f"{PERIODS}{_arguments(start=case.start, **case.options, saves_per_period=saves)}"
    else:
        scene, periods, begin = session.passage(case)
        lines += ["# the window that was looked at", *_state_at(session, begin), f"scene = {scene_text(scene)}"]
        call = f"{periods}, start=start{_arguments(begin=begin, **case.options, saves_per_period=case.steps)}"
    lines += [f"run = sj.simulate(scene, {call})", "sj.plots.overview(run)"]
    if orbit is not None:
        lines.append(f"orbit = sj.periodic_orbit(scene, {orbit.period}, start=run.end{_arguments(**case.options)})")
    if branch is not None:
        name = branch.parameter.name
        given = f"{name!r}, {session.branch_bounds(name)}, start=orbit.state, period=orbit.period"
        lines += [f"branch = sj.continue_orbit(scene, {given})", "sj.plots.branches(branch)"]
    return "\n".join(lines) + "\n"


def _left(session: Session) -> list[str]:
    """Return the lines of the map or the run."""
    view = session.view
    if view.grid is None:
        source = "ds  # that with which the page was opened"
        source = source if view.source is None else f"sj.flow.dataset_of({str(view.source)!r})"
        return [f"given = {source}", "scene = sj.load_scene(given)" * view.is_run, "sj.plots.plot(given)"]
    grid = ", ".join(f"{name!r}: {_axis(values)}" for name, values in view.grid.items())
    call = f"map = sj.sweep(scene, {{{grid}}}{_arguments(**Session.sweep_options(view))})"
    return [f"scene = {scene_text(view.scene)}", call, "sj.plots.plot(map)"]


def _state_at(session: Session, distance: float) -> list[str]:
    """Return the lines of `Session.state_at`."""
    kept, begin = session.way(distance)
    start = "given" if kept in session.run["stretch"] else "sj.load_start(given)"
    # the run kept its state there
    if kept == begin:
        return [f"start = {start}"]
    more = _arguments(begin=kept, **session.run_options)
    return [f"start = sj.run(scene, length={begin - kept!r}, start={start}{more})"]


def _arguments(**values: Any) -> str:
    """Return those arguments of a call that are not None, each after a comma."""
    text = ""
    # None is the default
    for name, value in values.items():
        if isinstance(value, diffrax.AbstractSolver):  # by its name, without settings of its own
            value = type(value).__name__
        if value is not None:
            text += f", {name}={start_text(value) if name == 'start' else repr(value)}"
    return text


def _axis(values: np.ndarray) -> str:
    if np.array_equal(values, np.linspace(values[0], values[-1], len(values))):
        return f"np.linspace({float(values[0])!r}, {float(values[-1])!r}, {len(values)})"
    return f"np.array({values.tolist()})"


def scene_text(scene: Scene) -> str:
    """Return a scene as an expression: by the paper's few numbers where these suffice, else as JSON."""
    content = scene_to_json(scene)
    try:
        numbers = {name: float(scene.value(name)) for name in SLIDERS}
        if scene_to_json(paper_scene(**numbers)) == content:
            return f"sj.paper_scene({', '.join(f'{name}={value!r}' for name, value in numbers.items())})"
    except ValueError:  # it lacks one of them
        pass
    return f"sj.model.scene_from_json({content!r})"


def start_text(start: Any) -> str:
    """Return a motion or state as an expression, exact to the last bit."""
    if hasattr(start, "motion"):
        memory = "None" if start.memory is None else f"jnp.array({np.asarray(start.memory).tolist()})"
        return f"sj.State({start_text(start.motion)}, {memory})"
    numbers = jax.tree.map(float, vars(start))
    return f"sj.{type(start).__name__}({', '.join(f'{k}={v!r}' for k, v in numbers.items() if v)})"
