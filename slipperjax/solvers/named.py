"""Solvers by their names, and checks of a requested solver and step size controller."""

import diffrax
import jax
import jax.numpy as jnp

from ..model.scene import Scene
from ..tools.checks import brief, instance, require
from .explicit import RK4, Tsit5
from .impulse import ImpulseRK4, knows_contacts
from .latching import AbstractLatchingSolver, Latching
from .rosenbrock import ROS34PW2, Rodas4
from .simplified_newton import with_root_finder
from .twostep import TwoStep

OWN_SOLVERS = {kind.__name__: kind for kind in (RK4, ImpulseRK4, Tsit5, Rodas4, ROS34PW2, TwoStep)}
"""The solvers of this package by name."""


BENDING = "be ImpulseRK4 for a rail that bends"
"""Why a scene with a beam needs its solver."""


def solver_named(name: str) -> diffrax.AbstractSolver:
    """Return a solver by its name, of slipperjax or else of diffrax; "diffrax.Tsit5" is always diffrax's.

    **Raises:** `ValueError` for a name that is no solver's name, or for a solver that needs arguments.
    """
    package, _, plain = name.rpartition(".")
    # where both have the name, the solver of slipperjax
    named = {"": vars(diffrax) | OWN_SOLVERS, "diffrax": vars(diffrax)}.get(package, {})
    is_solver = lambda kind: isinstance(kind, type) and issubclass(kind, diffrax.AbstractSolver)
    solvers = {name: kind for name, kind in named.items() if is_solver(kind) and not name.startswith("Abstract")}
    need = f"be one of {', '.join(OWN_SOLVERS)}, or a solver of diffrax such as Kvaerno5"
    require(plain in solvers, "solver", need, name, names=solvers or OWN_SOLVERS)
    try:
        # such as HalfSolver, which needs an inner solver
        return solvers[plain]()
    except TypeError:
        raise ValueError(
            f"Argument `solver` must be a solver that needs no arguments, but is {brief(name)}."
        ) from None


def resolve_solver(
    scene: Scene,
    solver: diffrax.AbstractSolver | str | None,
) -> diffrax.AbstractSolver:
    """Return the solver to use; `Latching` wraps a solver of diffrax if the scene latches touchdowns.

    None is `ImpulseRK4()`, or `RK4()` for contacts that `ImpulseRK4` cannot integrate, such as with `SmoothSwitch`.

    A text is a name, see `solver_named`.

    **Raises:** `ValueError` for an object that is no solver, or a solver that cannot be latched.
    """
    if scene.beam is not None:
        require(solver in (None, "ImpulseRK4") or isinstance(solver, ImpulseRK4), "solver", BENDING, solver)
        require(knows_contacts(scene), "memory", "be a latch for a rail that bends", scene.contact_memory)
    if solver is None:
        return ImpulseRK4() if knows_contacts(scene) else RK4()
    if isinstance(solver, str):
        solver = solver_named(solver)
    if isinstance(solver, type):
        raise ValueError(f"Argument `solver` must be a solver, as in {solver.__name__}(), but is the class.")
    instance("solver", solver, diffrax.AbstractSolver, "a diffrax solver or the name of one")
    if isinstance(solver, AbstractLatchingSolver):
        return solver
    return Latching(solver) if scene.latches_memory else with_root_finder(solver)


def resolve_controller(
    controller: object,
    solver: diffrax.AbstractSolver,
) -> diffrax.AbstractStepSizeController | None:
    """Return the step size controller, None for constant steps, with arrays in place of floats: no new compilation.

    **Raises:** `ValueError` for an object that is no controller, or an adaptive controller with a solver that has no
    error estimate.
    """
    if controller is None or isinstance(controller, diffrax.ConstantStepSize):
        return None
    instance(
        "stepsize_controller",
        controller,
        diffrax.AbstractStepSizeController,
        "a diffrax controller",
    )
    # `Latching` has an error estimate where its inner solver has one
    inner = solver.solver if isinstance(solver, Latching) else solver
    adaptive = isinstance(controller, diffrax.AbstractAdaptiveStepSizeController)
    if adaptive and not isinstance(inner, diffrax.AbstractAdaptiveSolver):
        raise ValueError(
            f"Argument `solver` must be one with an error estimate for adaptive steps (Tsit5, ROS34PW2, Dopri8), "
            f"but is {type(solver).__name__}."
        )
    return jax.tree.map(lambda leaf: jnp.asarray(leaf) if isinstance(leaf, float) else leaf, controller)
