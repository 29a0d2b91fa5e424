"""Courses of made-up curves."""

from typing import Any

import jax.numpy as jnp
import numpy as np

import slipperjax as sj
from slipperjax.flow.course import Course, Crossings, StepCubics, contact_loads

STEPS = 64


def wave(amplitude: float, shift: float = 0.0, turns: int = 1, phase: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """amplitude (sin(2 pi turns t + phase) + shift) at the ends of steps, and its slopes per step."""
    angle = 2 * np.pi * turns * np.arange(STEPS + 1) / STEPS + phase
    return amplitude * (np.sin(angle) + shift), amplitude * 2 * np.pi * turns / STEPS * np.cos(angle)


class MadeUp(Course):
    """A course whose quantities are given."""

    capacity = STEPS  # pyright: ignore[reportIncompatibleMethodOverride, reportAssignmentType]


def made_up_course(steps: int = STEPS, capacity: int | None = None, **given: Any) -> Course:
    """A course of the paper's scene with curves of values and slopes by name, or `crossings`."""
    course = MadeUp(None, None, sj.model.Args(sj.paper_scene(), 0.0), steps)  # pyright: ignore[reportArgumentType]
    course.capacity = steps if capacity is None else capacity
    for name, parts in given.items():
        if name == "crossings":
            course.crossings = Crossings(*parts)
        else:
            setattr(course, name, StepCubics(*map(jnp.asarray, parts), course=course))
    if {"force", "gap"} <= set(given):
        course.loads = contact_loads(
            course.force.values, course.gap.values, jnp.zeros(steps + 1), jnp.zeros(steps + 1), course.args, steps
        )
    return course
