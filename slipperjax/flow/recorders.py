"""What is kept of the forcing periods: inside the compiled program, on the host, and as labelled arrays."""

import abc
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..model.dynamics import Args, State, reactions
from ..model.kinematics import Motion, euler_angles
from ..model.quantities import ACCELERATIONS, COORDINATES, LOADS, REACTIONS, SECTIONS, Quantity
from ..model.scene import Scene
from ..tools.compile import jit
from .loads import Loads, contact_loads, over_periods
from .poincare import Crossings, section_crossings

Labelled = tuple[dict[str, Any], dict[str, Any]]
"""Data variables and coordinates of a dataset, as xarray takes them."""


STROBE_VALUES = 10
"""Numbers of a state once per period."""
LOAD_VALUES = 100
"""Numbers of a period's contact loads: five of each of twenty points."""
RECORDED = 2.7
"""What a period costs whose inside is recorded, in plain ones: measured 2.6 (sections) and 2.8 (history)."""


class AbstractRecorder(abc.ABC):
    """One way to keep periods. Subclasses are frozen dataclasses: equal ones share a compiled program."""

    @property
    def inside(self) -> bool:
        """Whether states inside periods are needed; otherwise the state at the end of each period is kept."""
        return True

    @property
    def name(self) -> str:
        """What datasets have as their attribute `record`."""
        return type(self).__name__.lower()

    @property
    def cost(self) -> float:
        """What a recorded period costs, in plain ones."""
        return RECORDED if self.inside else 1.0

    @property
    def tangents(self) -> bool:
        """Whether derivatives are taken after the recorded stretch."""
        return False

    def later(self, periods: int) -> float:
        """What follows after a recorded stretch of so many periods costs, in plain ones."""
        return 0.0

    def kept(self, periods: int) -> int:
        """How many numbers are kept of so many periods of one case, about."""
        return self.values * periods

    def check(self, scene: Scene, periods: int, steps: int, taken: Collection[str] = ()) -> None:  # noqa: B027
        """Raises `ValueError` where it does not suit a run.

        **Arguments:** `periods`: recorded; `steps`: in each, at least; `taken`: names that the dataset has already.
        """

    def begin(self, scene: Scene, state: State) -> Any:
        """What is carried through the periods, of no period; None where nothing is.

        **Arguments:** `scene`, `state`: of one case; shapes count, numbers do not.
        """
        return None

    def add(self, carried: Any, states: State, args: Args, steps: Any, rates: Motion | None = None) -> Any:
        """What is carried after one period more, inside the compiled program; other arguments as of the call."""
        return carried

    def __call__(self, states: State, args: Args, steps: Any, rates: Motion | None = None) -> Any:
        """What is kept of one period, inside the compiled program.

        **Arguments:** `states`: at both ends of every step, leading axis `most` + 1, of which the first `steps` + 1
        count (the others repeat the start); `args`: scene and epoch; `steps`: integration steps per period, an `int`
        or traced; `rates`: derivatives of the motion at the same instants [per forcing period], where they are known.
        """
        raise NotImplementedError(f"{type(self).__name__} keeps ends of periods only.")

    @property
    @abc.abstractmethod
    def values(self) -> int:
        """How many numbers are kept of one period, about."""

    @abc.abstractmethod
    def collect(self, kept: Any) -> Any:
        """The compiled program's result as a record: arrays (cases, samples, ...), samples in the order of time."""

    @abc.abstractmethod
    def label(self, scene: Scene, dims: tuple[str, ...], record: Any) -> Labelled:
        """Data variables and coordinates of a dataset, from a record of arrays (*grid, samples, ...)."""


class StrobeRecord(NamedTuple):
    """The state once per forcing period."""

    strobe: Float[np.ndarray, "*cases periods 10"]
    """In the order of `slipperjax.model.COORDINATES`."""


@dataclass(frozen=True)
class Strobe(AbstractRecorder):
    """The state at the end of each forcing period. Nothing is stored inside periods."""

    @property
    def inside(self) -> bool:
        return False

    @property
    def values(self) -> int:
        return STROBE_VALUES

    def collect(self, kept: State) -> StrobeRecord:
        return StrobeRecord(coordinates(kept))

    def label(self, scene: Scene, dims: tuple[str, ...], record: StrobeRecord) -> Labelled:
        data = {
            name: ((*dims, "period"), record.strobe[..., k], q.attributes)
            for k, (name, q) in enumerate(COORDINATES.items())
        }
        return data, {"period": _period_numbers(record.strobe.shape[-2], "recorded")}


class SectionRecord(NamedTuple):
    """Poincare sections by upward zero crossings, and the state once per forcing period."""

    time: Float[np.ndarray, "*cases crossings 5"]
    """Instants of the crossings [forcing periods], NaN where a case has fewer."""
    velocity: Float[np.ndarray, "*cases crossings 5"]
    """Velocities there [m/s], [rad/s], in the order of `slipperjax.model.SECTIONS`."""
    strobe: Float[np.ndarray, "*cases periods 10"]
    loads: Loads | None
    """Contact loads of each period, arrays (*cases, periods, ...); None where switched off."""


@dataclass(frozen=True)
class Sections(AbstractRecorder):
    """Velocities at upward zero crossings, contact loads, and the state once per period to classify attractors by."""

    loads: bool = True

    def __call__(
        self, states: State, args: Args, steps: Any, rates: Motion | None = None
    ) -> tuple[Crossings, State, Loads | None]:
        last = jax.tree.map(lambda a: a[steps if isinstance(steps, int) else jnp.asarray(steps, int)], states)
        loads = contact_loads(states, args, steps) if self.loads else None
        return section_crossings(states, args, steps, rates), last, loads

    @property
    def values(self) -> int:
        return 3 * STROBE_VALUES + self.loads * LOAD_VALUES  # two crossings of each section

    def collect(self, kept: tuple[Crossings, State, Loads | None]) -> SectionRecord:
        # (lanes, periods, sections, steps) -> (lanes, crossings, sections), cut to the most crossings of any case
        crossings, ends, loads = kept
        time, velocity = (np.asarray(a) for a in crossings)
        flat = lambda a: np.moveaxis(a, 2, 1).reshape(a.shape[0], a.shape[2], -1)
        time, velocity = (np.moveaxis(a, -1, 1) for a in _packed(flat(time), flat(velocity)))
        return SectionRecord(time, velocity, coordinates(ends), _on_host(loads))

    def label(self, scene: Scene, dims: tuple[str, ...], record: SectionRecord) -> Labelled:
        time, velocity = _packed(*(np.moveaxis(a, -1, -2) for a in (record.time, record.velocity)))
        data = {}
        for k, (name, coordinate) in enumerate(SECTIONS.items()):
            q, across = COORDINATES[name], f"at upward zero crossings of {COORDINATES[coordinate].long_name}"
            data[name] = ((*dims, "crossing"), velocity[..., k, :], attributes(q.unit, f"{q.long_name} {across}"))
            text = f"forcing periods passed {across}"
            data[f"{name}_period"] = ((*dims, "crossing"), time[..., k, :], attributes("1", text))
        text = "; ".join(f"{name} [{q.unit}]" for name, q in COORDINATES.items())
        long_name = {"long_name": f"state once per period: {text}"}
        data["strobe"] = ((*dims, "period", "coordinate"), record.strobe, long_name)
        coords = {
            "coordinate": list(COORDINATES),
            "period": _period_numbers(record.strobe.shape[-2], "since the start"),
        }
        return _with_loads(scene, dims, record.loads, data, coords)


class HistoryRecord(NamedTuple):
    """States, accelerations, contact forces, gaps and drive force at constant intervals."""

    states: Float[np.ndarray, "*cases samples 10"]
    """In the order of `slipperjax.model.COORDINATES`."""
    period: Float[np.ndarray, "*cases samples"]
    """Time [forcing periods]."""
    acceleration: Float[np.ndarray, "*cases samples 5"]
    """In the order of `slipperjax.model.ACCELERATIONS`."""
    contact_force: Float[np.ndarray, "*cases samples 2 points"]
    """Normal forces at the front and the rear points [N]."""
    gap: Float[np.ndarray, "*cases samples 2 points"]
    """Gaps there, negative where penetrating [m]."""
    drive_force: Float[np.ndarray, "*cases samples"]
    """Force along x that keeps the speed constant [N]."""
    loads: Loads | None
    """Contact loads of each period, arrays (*cases, periods, ...); None where switched off."""


@dataclass(frozen=True)
class History(AbstractRecorder):
    """States, accelerations, contact forces, gaps and drive force `saves` times per period, and loads."""

    saves: int
    loads: bool = True

    def __call__(self, states: State, args: Args, steps: Any, rates: Motion | None = None) -> HistoryRecord:
        saved = samples(states, self.saves, steps)
        period = jnp.arange(1, self.saves + 1) / self.saves
        now = jax.vmap(lambda t, s: reactions(t, s, args))(period, saved)
        loads = contact_loads(states, args, steps) if self.loads else None
        forces = now.contact_force, now.gap, now.drive_force
        return HistoryRecord(stacked(saved), period + args.epoch, now.acceleration, *forces, loads)

    @property
    def values(self) -> int:
        return 57 * self.saves + self.loads * LOAD_VALUES

    def collect(self, kept: HistoryRecord) -> HistoryRecord:
        in_time = lambda a: np.asarray(a).reshape(a.shape[0], -1, *a.shape[3:])
        loads = _on_host(kept.loads)
        return HistoryRecord(*map(in_time, kept[:-1]), loads)  # pyright: ignore[reportCallIssue]

    def label(self, scene: Scene, dims: tuple[str, ...], record: HistoryRecord) -> Labelled:
        data: dict[str, Any] = {}
        for quantities, values in ((COORDINATES, record.states), (ACCELERATIONS, record.acceleration)):
            for k, (name, q) in enumerate(quantities.items()):
                data[name] = ((*dims, "time"), values[..., k], q.attributes)
        at_points = ("end", "point")
        for name, inner in (("contact_force", at_points), ("gap", at_points), ("drive_force", ())):
            data[name] = ((*dims, "time", *inner), getattr(record, name), REACTIONS[name].attributes)
        # the same for all cases, but NaN for those that were not run
        period = np.fmin.reduce(record.period.reshape(-1, record.period.shape[-1]))
        coords: dict[str, Any] = {
            "period": ("time", period, attributes("1", "time in forcing periods")),
        }
        return _with_loads(scene, dims, record.loads, data, coords | places(scene))


@dataclass(frozen=True)
class Samples(AbstractRecorder):
    """The states `saves` times per period, as they are, and loads if wanted: for `simulate`."""

    saves: int
    loads: bool = True

    def __call__(
        self, states: State, args: Args, steps: Any, rates: Motion | None = None
    ) -> tuple[State, Loads | None]:
        return samples(states, self.saves, steps), (contact_loads(states, args, steps) if self.loads else None)

    @property
    def values(self) -> int:
        return 100 * self.saves + self.loads * LOAD_VALUES  # with the forces that follow from them

    def collect(self, kept: tuple[State, Loads | None]) -> tuple[State, Loads | None]:
        saved, loads = kept
        return jax.tree.map(lambda a: a.reshape(-1, *a.shape[2:]), saved), loads

    def label(self, scene: Scene, dims: tuple[str, ...], record: Any) -> Labelled:
        raise NotImplementedError("Trajectories are labelled by slipperjax.flow.datasets.")


@dataclass(frozen=True)
class OnlyLoads(AbstractRecorder):
    """Nothing but loads: for a look at whether a run can be trusted."""

    def __call__(self, states: State, args: Args, steps: Any, rates: Motion | None = None) -> Loads:
        return contact_loads(states, args, steps)

    @property
    def values(self) -> int:
        return LOAD_VALUES

    def collect(self, kept: Loads) -> Loads:
        return _on_host(kept)

    def label(self, scene: Scene, dims: tuple[str, ...], record: Loads) -> Labelled:
        return load_variables(dims, record), places(scene)


RECORDERS = ("sections", "strobe", "history")
"""The ways to keep periods, by the name that `sweep(..., record=...)` knows them by."""


def recorder_named(name: str, saves: int, loads: bool = True) -> AbstractRecorder:
    """The recorder of `RECORDERS` with this name; `saves`: per period, for a history; `loads`: with contact loads."""
    return {"sections": Sections(loads), "strobe": Strobe(), "history": History(saves, loads)}[name]


def samples(states: State, saves: int, steps: Any) -> State:
    """The states at the ends of `saves` equal parts of a period, from those at both ends of every step."""
    if isinstance(steps, int):
        stride = steps // saves
        return jax.tree.map(lambda a: a[stride : steps + 1 : stride], states)
    at = jnp.round(jnp.arange(1, saves + 1) * (steps / saves)).astype(int)
    return jax.tree.map(lambda a: a[at], states)


def stacked(state: State) -> Float[Array, "*batch 10"]:
    """The ten coordinates and velocities of a state (*batch), in the order of `slipperjax.model.COORDINATES`."""
    m = state.motion
    return jnp.stack([m.y, m.z, *euler_angles(m), m.v_y, m.v_z, m.w_x, m.w_y, m.w_z], axis=-1)


_stacked = jit(stacked)


def coordinates(states: State) -> Float[np.ndarray, "*batch 10"]:
    """`stacked` as a NumPy array."""
    return np.asarray(_stacked(states))


def joined_in_time(records: Sequence[Any]) -> Any:
    """Records of successive stretches as one."""
    return jax.tree.map(lambda *parts: np.concatenate(parts, axis=1), *records)


def load_variables(dims: tuple[str, ...], loads: Loads) -> dict[str, Any]:
    """Data variables of loads over all their periods, from arrays (*dims, periods, ...)."""
    total = _over_periods(loads, len(dims))
    return {
        name: ((*dims, "end", "point"), np.asarray(getattr(total, name)), q.attributes) for name, q in LOADS.items()
    }


_over_periods = jit(over_periods, static_argnums=(1,))


def _with_loads(
    scene: Scene, dims: tuple[str, ...], loads: Loads | None, data: dict[str, Any], coords: dict[str, Any]
) -> Labelled:
    """Data variables and coordinates with those of loads, if there are any."""
    return (data, coords) if loads is None else (data | load_variables(dims, loads), coords | places(scene))


def places(scene: Scene) -> dict[str, Any]:
    """Coordinates of what is given at each contact point."""
    return {"end": ["front", "rear"], "point": list(scene.section.names)}


def _on_host(tree: Any) -> Any:
    return jax.tree.map(np.asarray, tree)


def _packed(time: np.ndarray, velocity: np.ndarray) -> list[np.ndarray]:
    """Crossings moved to the front of the last axis, which is cut to the most that any case has."""
    absent = np.isnan(velocity)
    most = max(int(np.max(np.sum(~absent, axis=-1))), 1)
    order = np.argsort(absent, axis=-1, kind="stable")[..., :most]
    return [np.take_along_axis(a, order, axis=-1) for a in (time, velocity)]


def attributes(unit: str, long_name: str) -> dict[str, str]:
    """Those of a data variable."""
    return Quantity("", unit, long_name).attributes


def _period_numbers(count: int, since: str) -> tuple:
    return "period", np.arange(1, count + 1), attributes("1", f"forcing periods {since}")
