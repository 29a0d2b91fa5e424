"""Scenes from easy to hard, and the methods to integrate them, which the benchmark compares.

A method is a row of `METHODS`: a solver, the memory of the contacts, and the numbers of steps or tolerances to try.
To compare one more solver, add a row.
"""

from typing import NamedTuple

import diffrax

from slipperjax.model.contact import AbstractMemory, EventLatch, SmoothSwitch
from slipperjax.model.dang2024 import paper_scene, table_2_start
from slipperjax.model.kinematics import Motion
from slipperjax.model.scene import Scene
from slipperjax.model.step_size import default_steps_per_period
from slipperjax.solvers.explicit import RK4, Tsit5
from slipperjax.solvers.impulse import ImpulseRK4
from slipperjax.solvers.latching import Latching
from slipperjax.solvers.rosenbrock import ROS34PW2, Rodas4
from slipperjax.solvers.simplified_newton import with_root_finder
from slipperjax.solvers.twostep import TwoStep


class Case(NamedTuple):
    """A scene of the benchmark."""

    name: str
    scene: Scene
    periods: int
    """Number of forcing periods over which errors are taken; few where neighbouring motions separate quickly."""
    start: Motion


def all_cases() -> list[Case]:
    """Return the scenes, from easy to hard. All but the last have the same structure, and so share programs."""
    weightless = lambda **options: paper_scene(**options).replace(gravity=0.0)
    # straight rails, on which the slipper comes to rest
    still = dict(amplitude=0.0, roll_amplitude=0.0)
    resting = Motion(z=-5e-4, v_z=-1e-3, w_x=1e-2, w_y=1e-2)
    start = table_2_start()
    return [
        Case("nominal", weightless(), 6, start),
        Case("V = 2300 m/s", weightless(speed=2300.0), 6, start),
        Case("C = 4 mm", weightless(clearance=4e-3), 6, start),
        Case("K = 1e10", weightless(stiffness=1e10), 2, start),
        Case("K = 1e12", weightless(stiffness=1e12), 2, start),
        Case("resting", paper_scene(**still).replace(gravity=9.81), 6, resting),
        Case("two waves", weightless(speed=1500.0, wavelengths=(10.0, 12.0)), 6, start),
    ]


class Method(NamedTuple):
    """Solver with a memory of the contacts, and the settings to try."""

    name: str
    solver: diffrax.AbstractSolver
    memory: AbstractMemory = EventLatch()
    settings: tuple[float, ...] = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
    """Steps per period as multiples of the scene's default; if `adaptive`, tolerances of `AdaptiveSteps`."""
    adaptive: bool = False
    quick: bool = False
    """True if it is part of the quick run."""

    def setting(self, case: Case, value: float) -> float:
        """Return steps per period, or the tolerance, for one of `settings`."""
        # a tolerance does not depend on the scene
        if self.adaptive:
            return value
        return float(max(1, round(value * default_steps_per_period(case.scene))))

    def label(self, case: Case, value: float) -> str:
        """Return the name of a setting in the table."""
        return f"tolerance {value:.0e}" if self.adaptive else f"{self.setting(case, value):.0f} steps"


_SMOOTH = SmoothSwitch()
_KVAERNO5 = with_root_finder(diffrax.Kvaerno5())
METHODS = [
    Method("RK4", RK4(), quick=True),
    Method("ImpulseRK4", ImpulseRK4(), quick=True),
    Method("Tsit5", Tsit5()),
    Method("Tsit5, adaptive", Tsit5(), EventLatch(), (1e-3, 1e-4, 1e-5, 1e-6), adaptive=True),
    Method("diffrax Dopri8", Latching(diffrax.Dopri8()), settings=(0.5, 1.0, 2.0, 4.0, 8.0)),
    Method("Rodas4", Rodas4()),
    Method("ROS34PW2", ROS34PW2(), quick=True),
    Method("paper's two-step", TwoStep()),
    Method("diffrax Kvaerno5", Latching(diffrax.Kvaerno5()), settings=(0.5, 1.0, 2.0)),
    Method("smooth: RK4", RK4(), _SMOOTH, quick=True),
    Method("smooth: ROS34PW2", ROS34PW2(), _SMOOTH),
    Method("smooth: diffrax Tsit5, adaptive", diffrax.Tsit5(), _SMOOTH, (1e-3, 1e-4, 1e-5, 1e-6), adaptive=True),
    Method("smooth: diffrax Kvaerno3", with_root_finder(diffrax.Kvaerno3()), _SMOOTH, (0.5, 1.0, 2.0)),
    Method("smooth: diffrax Kvaerno5", _KVAERNO5, _SMOOTH, (0.5, 1.0, 2.0)),
    Method("smooth: diffrax Kvaerno5, adaptive", _KVAERNO5, _SMOOTH, (1e-3, 1e-4, 1e-5), adaptive=True),
    Method(
        "smooth: diffrax implicit Euler", with_root_finder(diffrax.ImplicitEuler()), _SMOOTH, (0.5, 1.0, 2.0, 4.0)
    ),
]
"""The methods compared, with the event latch unless named smooth. diffrax's KenCarp methods are left out: they need a
splitting into a stiff and a non-stiff part, which contact does not have."""
