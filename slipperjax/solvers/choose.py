"""Choice of a solver for a scene, and checks of a requested solver."""

from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp

from ..model.contact import SmoothSwitch
from ..model.dynamics import LatchedField, vector_field
from ..model.scene import Scene, check_scene
from ..model.step_size import default_steps_per_period, impacts_per_period, settle_memory
from ..tools.checks import brief
from .explicit import RK4, Tsit5
from .latching import AbstractLatchingSolver, Latching, estimates_error
from .rosenbrock import ROS34PW2, Rodas3, Rodas4
from .simplified_newton import with_root_finder
from .twostep import TwoStep

OWN = {kind.__name__: kind for kind in (RK4, Tsit5, Rodas3, Rodas4, ROS34PW2, TwoStep)}
"""The solvers of this package by name."""
STABLE = 2.5
"""Greatest product of step and decay rate for RK4, a little below its stability limit of 2.79."""


class Choice(NamedTuple):
    """A solver, and the reason for it."""

    solver: diffrax.AbstractSolver
    reason: str


def choose_solver(scene: Scene) -> Choice:
    """The solver for `solver="auto"`, and the reason.

    Steps must resolve each impact with any solver. At `default_steps_per_period` explicit methods are then stable,
    too, and cheapest; only a memory that relaxes within a step of that length makes a scene stiff.

    **Arguments:** `scene`: one case, not traced.

    **Raises:** `ValueError` for a traced scene.
    """
    steps = default_steps_per_period(check_scene(scene))
    period = float(scene.period)
    impact = f"an impact lasts {1 / float(impacts_per_period(scene)):.3g} of a period, {steps} steps resolve it"
    if scene.contact.has_memory and isinstance(scene.memory, SmoothSwitch):
        relaxation = settle_memory(scene).memory.relaxation
        stretch = period / steps / float(relaxation)
        if stretch > STABLE:
            return Choice(ROS34PW2(), f"{impact}, but the memory relaxes {stretch:.3g} times per step: implicit")
        return Choice(RK4(), f"{impact}, and the memory relaxes {stretch:.3g} times per step: explicit")
    return Choice(RK4(), f"{impact}, and the contact memory changes at touchdowns only: explicit")


def solver_named(name: str) -> diffrax.AbstractSolver:
    """A solver by its name: of slipperjax, or else of diffrax; diffrax.Tsit5 is diffrax's where both have one.

    **Raises:** `ValueError` for a name that is no solver's, or one that needs arguments.
    """
    package, _, plain = name.rpartition(".")
    kind = OWN.get(name) if not package else None
    kind = getattr(diffrax, plain, None) if kind is None and package in ("", "diffrax") else kind
    if not (isinstance(kind, type) and issubclass(kind, diffrax.AbstractSolver)) or plain.startswith("Abstract"):
        raise ValueError(
            f"Argument `solver` must be auto, one of {', '.join(OWN)}, or a solver of diffrax such as Kvaerno5, but "
            f"is {brief(name)}."
        )
    try:
        return kind()
    except TypeError:
        raise ValueError(
            f"Argument `solver` must be a solver that needs no arguments, but is {brief(name)}."
        ) from None


def resolve_solver(scene: Scene, solver: diffrax.AbstractSolver | str | None) -> diffrax.AbstractSolver:
    """The solver to use: None is `RK4()`; one of diffrax is wrapped in `Latching` if the scene latches touchdowns.

    A text is "auto", see `choose_solver`, or a name, see `solver_named`.

    **Raises:** `ValueError` for an object that is not a solver, or a solver that cannot be latched.
    """
    if solver is None:
        return RK4()
    if isinstance(solver, str):
        solver = choose_solver(scene).solver if solver == "auto" else solver_named(solver)
    if isinstance(solver, type):
        raise ValueError(f"Argument `solver` must be a solver, as in {solver.__name__}(), but is the class.")
    if not isinstance(solver, diffrax.AbstractSolver):
        raise ValueError(f"Argument `solver` must be a diffrax solver or the name of one, but is {brief(solver)}.")
    if isinstance(solver, AbstractLatchingSolver):
        return solver
    return Latching(solver) if isinstance(vector_field(scene), LatchedField) else with_root_finder(solver)


def resolve_controller(controller: Any) -> diffrax.AbstractStepSizeController | None:
    """The step size controller, None for constant steps; floats become arrays: new values need no compilation.

    **Raises:** `ValueError` for an object that is not a controller.
    """
    if controller is None or isinstance(controller, diffrax.ConstantStepSize):
        return None
    if not isinstance(controller, diffrax.AbstractStepSizeController):
        raise ValueError(f"Argument `stepsize_controller` must be a diffrax controller, but is {controller!r}.")
    return jax.tree.map(lambda leaf: jnp.asarray(leaf) if isinstance(leaf, float) else leaf, controller)


def check_error_estimate(solver: diffrax.AbstractSolver, controller: Any) -> None:
    """Raises `ValueError` for an adaptive controller with a solver that has no error estimate."""
    if isinstance(controller, diffrax.AbstractAdaptiveStepSizeController) and not estimates_error(solver):
        raise ValueError(
            f"Argument `solver` must be one with an error estimate for adaptive steps (Tsit5, ROS34PW2, Dopri8), "
            f"but is {type(solver).__name__}."
        )
