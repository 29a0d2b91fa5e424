"""What a sweep keeps of its periods, and how that is labelled."""

import abc
import functools
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from .analysis.poincare import SECTIONS, section_crossings
from .dynamics import Args, reactions
from .kinematics import euler_angles
from .labels import ACCELERATIONS, OUTPUTS, attributes
from .scene import Scene
from .simulate import Record

Labelled = tuple[dict[str, Any], dict[str, Any]]


class AbstractKeep(abc.ABC):
    """One way to keep a period."""

    strobes: ClassVar[bool] = False
    """Whether the last of the collected arrays is `outputs` once per period, and wanted of the transient too."""

    @abc.abstractmethod
    def make(self, stride: int) -> Record | None:
        """What runs inside the compiled program; `stride`: integration steps between saves."""

    @abc.abstractmethod
    def collect(self, kept: Any) -> list[np.ndarray]:
        """The compiled program's result as arrays (cases, samples, ...), samples in the order of time."""

    @abc.abstractmethod
    def label(self, scene: Scene, dims: tuple[str, ...], kept: list[np.ndarray]) -> Labelled:
        """Data variables and coordinates of a dataset, from arrays (*grid, samples, ...)."""


class Sections(AbstractKeep):
    """Velocities at upward zero crossings, and the state once per period, from which an attractor is told."""

    strobes = True

    def make(self, stride):
        return _sections

    def collect(self, kept):
        # (lanes, periods, sections, steps) -> (lanes, hits, sections), and only as many hits as some case has:
        # nearly all of the steps have none
        crossings, ends = kept
        time, velocity = (np.asarray(a) for a in crossings)
        lanes, _, sections, _ = velocity.shape
        flat = lambda a: np.moveaxis(a, 2, 1).reshape(lanes, sections, -1)
        packed = _pack(flat(time), flat(velocity))
        return [*(np.moveaxis(a, -1, 1) for a in packed), outputs(ends)]

    def label(self, scene, dims, kept):
        *crossings, strobe = kept
        time, velocity = _pack(*(np.moveaxis(a, -1, -2) for a in crossings))
        data = {}
        for k, (name, coordinate) in enumerate(SECTIONS.items()):
            unit, text = OUTPUTS[name]
            across = f"at upward zero crossings of {OUTPUTS[coordinate][1]}"
            data[name] = ((*dims, "crossing"), velocity[..., k, :], attributes(unit, f"{text} {across}"))
            data[f"{name}_period"] = (
                (*dims, "crossing"),
                time[..., k, :],
                attributes("1", f"forcing periods passed {across}"),
            )
        text = "; ".join(f"{name} [{unit}]" for name, (unit, _) in OUTPUTS.items())
        data["strobe"] = ((*dims, "period", "coordinate"), strobe, {"long_name": f"state once per period: {text}"})
        coords = {"coordinate": list(OUTPUTS), "period": _periods(strobe.shape[-2], "since the start")}
        return data, coords


def _pack(time, velocity):
    """Crossings moved to the front of the last axis, which is cut to the most that any case has."""
    absent = np.isnan(velocity)
    most = max(int(np.max(np.sum(~absent, axis=-1))), 1)
    order = np.argsort(absent, axis=-1, kind="stable")[..., :most]
    return [np.take_along_axis(a, order, axis=-1) for a in (time, velocity)]


def _sections(states, args: Args, steps: int):
    return section_crossings(states, args, steps), jax.tree.map(lambda a: a[-1], states)


def _periods(count: int, since: str):
    return "period", np.arange(1, count + 1), attributes("1", f"forcing periods {since}")


class Strobe(AbstractKeep):
    """The state once per forcing period."""

    def make(self, stride):
        return None

    def collect(self, kept):
        return [outputs(kept)]

    def label(self, scene, dims, kept):
        (strobe,) = kept
        data = {
            name: ((*dims, "period"), strobe[..., k], attributes(*OUTPUTS[name])) for k, name in enumerate(OUTPUTS)
        }
        return data, {"period": _periods(strobe.shape[-2], "recorded")}


class History(AbstractKeep):
    """States, accelerations and contact forces at constant intervals."""

    def make(self, stride):
        return _history(stride)

    def collect(self, kept):
        return [np.asarray(a).reshape(a.shape[0], -1, *a.shape[3:]) for a in kept]

    def label(self, scene, dims, kept):
        *series, period, acceleration, force = kept
        data = {
            name: ((*dims, "time"), values, attributes(*OUTPUTS[name]))
            for name, values in zip(OUTPUTS, series, strict=True)
        }
        for k, (name, label) in enumerate(ACCELERATIONS.items()):
            data[name] = ((*dims, "time"), acceleration[..., k], attributes(*label))
        unit = attributes("N", "normal contact force on the slipper")
        data["contact_force"] = ((*dims, "time", "end", "point"), force, unit)
        period = period.reshape(-1, period.shape[-1])[0]
        coords: dict = {
            "period": ("time", period, attributes("1", "time in forcing periods")),
            "end": ["front", "rear"],
            "point": list(scene.section.names),
        }
        return data, coords


KEEPS: dict[str, AbstractKeep] = {"sections": Sections(), "strobe": Strobe(), "history": History()}
"""The ways to keep a period, by the name that `sweep(..., record=...)` knows them by."""


def _outputs(state) -> list:
    m = state.motion
    return [m.y, m.z, *euler_angles(m), m.v_y, m.v_z, m.w_x, m.w_y, m.w_z]


_stacked = jax.jit(lambda state: jnp.stack(_outputs(state), axis=-1))


def outputs(states: Any) -> np.ndarray:
    """The ten coordinates and velocities of `OUTPUTS`, from states (*batch), as an array (*batch, 10)."""
    return np.asarray(_stacked(states))


@functools.cache
def _history(stride: int) -> Record:
    def record(states, args: Args, steps: int):
        saved = jax.tree.map(lambda a: a[stride::stride], states)
        period = jnp.arange(stride, steps + 1, stride) / steps
        series = jax.vmap(_outputs)(saved)
        now = jax.vmap(lambda t, s: reactions(t, s, args))(period, saved)
        return [*series, period + args.epoch, now.acceleration, now.contact_force]

    return record
