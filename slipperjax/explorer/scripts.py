"""The script that computes the numbers on a page."""

import diffrax
import equinox as eqx
import numpy as np

from ..model.dang2024 import paper_scene
from ..model.dynamics import State
from ..model.kinematics import Motion
from ..model.scene import Scene
from ..model.scene_files import scene_to_json
from .session import PERIODS, SLIDERS, Session, sweep_options


def python_of(session: Session) -> str:
    """Return a script that computes the contents of the page: the map or the run, and the case."""
    case = session.case
    lines = ["import jax.numpy as jnp", "import numpy as np", "import slipperjax as sj", ""]
    lines += [*_left(session), "", "# the case that was looked at"]
    # a steady motion, or a window of a run
    if case.window is None:
        lines.append(f"scene = {scene_text(case.scene)}")
        more = _arguments(start=case.start, **case.options, saves_per_period=case.saves)
        call = f"{PERIODS}{more}"
    else:
        scene, periods, begin = session.passage(case)
        lines += [*_state_at(session, begin), f"scene = {scene_text(scene)}"]
        more = _arguments(begin=begin, **case.options, saves_per_period=case.steps)
        call = f"{periods}, start=start{more}"
    lines += [f"run = sj.simulate(scene, {call})", "run.plot()"]
    return "\n".join(lines) + "\n"


def _left(session: Session) -> list[str]:
    """Return the lines that make the map or the run."""
    view = session.view
    if not view.grid:
        # otherwise the source with which the page was opened
        source = "ds" if view.source is None else repr(str(view.source))
        return [f"given = sj.load({source})", "scene = given.scene" * view.is_run, "given.plot()"]
    grid = ", ".join(f"{name!r}: {_axis(values)}" for name, values in view.grid.items())
    call = f"map = sj.sweep(scene, {{{grid}}}{_arguments(**sweep_options(view))})"
    return [f"scene = {scene_text(view.scene)}", call, "map.plot()"]


def _state_at(session: Session, distance: float) -> list[str]:
    """Return the lines that compute the result of `Session.state_at`."""
    kept, begin = session.last_state(distance)
    start = "given" if kept in session.run["stretch"] else "given.start"
    # the run kept its state there
    if kept == begin:
        return [f"start = {start}"]
    more = _arguments(begin=kept, **session.run_options)
    return [f"start = sj.run(scene, length={begin - kept!r}, start={start}{more})"]


def _arguments(**values: object) -> str:
    """Return arguments of a call, each after a comma, without arguments that are None, the default."""
    text = ""
    for name, value in values.items():
        if isinstance(value, diffrax.AbstractSolver):  # by its name, without its settings
            value = type(value).__name__
        if value is not None:
            text += f", {name}={start_text(value) if name == 'start' else repr(value)}"
    return text


def _axis(values: np.ndarray) -> str:
    ends = float(values[0]), float(values[-1])
    # as short as possible without changing a bit
    if np.array_equal(values, np.linspace(*ends, len(values))):
        return f"np.linspace({ends[0]!r}, {ends[1]!r}, {len(values)})"
    return f"np.array({values.tolist()})"


def scene_text(scene: Scene) -> str:
    """Return a scene as an expression: with the paper's few numbers where these are enough, otherwise as JSON."""
    content = scene_to_json(scene)
    try:
        numbers = {name: float(scene.value(name)) for name in SLIDERS}
    except ValueError:  # the scene lacks one of these numbers
        numbers = {}
    if scene_to_json(paper_scene(**numbers)) == content:
        return f"sj.paper_scene({', '.join(f'{name}={value!r}' for name, value in numbers.items())})"
    return f"sj.model.scene_from_json({content!r})"


def start_text(start: object) -> str:
    """Return a motion or state, or a part of it, as an expression, exact to the last bit."""
    if isinstance(start, eqx.Module):
        # numbers that are zero are left out
        parts = [f"{k}={start_text(v)}" for k, v in vars(start).items() if isinstance(v, eqx.Module) or np.any(v)]
        room = "sj" if isinstance(start, State) or type(start) is Motion else "sj.model"
        return f"{room}.{type(start).__name__}({', '.join(parts)})"
    # floats in full digits
    return f"jnp.array({np.asarray(start).tolist()})" if np.ndim(start) else repr(float(start))
