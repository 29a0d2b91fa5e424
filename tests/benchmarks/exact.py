"""Motions with impacts in 100 decimal digits: closed forms between the impacts, whose instants are roots of them.

Derivatives by the numbers relative to their values are central differences with steps of 1e-25, whose error is below
1e-40. Each function takes two numbers and returns the outputs of the problem with its name in `gradients.py`.
"""

import decimal
import functools
import itertools
from collections.abc import Callable, Iterator
from decimal import Decimal
from typing import NamedTuple

import numpy as np

CONTEXT = decimal.Context(prec=100)
STEP = Decimal("1e-25")
SCAN = Decimal("0.02")
"""Steps of time in which a crossing is looked for."""
GRAVITY, BALL_END = Decimal("9.81"), Decimal("2.7")
DAMPING, FREQUENCY, GAP, REBOUND, STOP_END = map(Decimal, ("0.1", "2.2", "0.15", "0.8", "12.5"))
SOFT, SLOW, PLAY, SPRING, PLAY_END = map(Decimal, ("0.05", "0.8", "0.5", "10", "20"))
TABLE_REBOUND, TABLE_END = Decimal("0.7"), Decimal("16")
LOWER, BALLS_REBOUND, BALLS_END = map(Decimal, ("0.5", "0.9", "1.6"))

Numbers = list[Decimal]
Motion = Callable[[Decimal], tuple[Decimal, Decimal]]
"""Place and speed after a time."""


class Exact(NamedTuple):
    """Outputs of a problem, and their derivatives by its numbers relative to their values."""

    value: np.ndarray
    first: np.ndarray  # (outputs, 2)
    second: np.ndarray  # (outputs, 2, 2)


def central(function: Callable[..., np.ndarray], step: float | Decimal) -> Exact:
    """Return central differences; `function` gets the numbers of steps along both numbers."""
    at = {(i, k): function(i, k) for i, k in itertools.product((-1, 0, 1), repeat=2)}
    first = [at[1, 0] - at[-1, 0], at[0, 1] - at[0, -1]]
    along = [at[1, 0] - 2 * at[0, 0] + at[-1, 0], at[0, 1] - 2 * at[0, 0] + at[0, -1]]
    mixed = (at[1, 1] - at[1, -1] - at[-1, 1] + at[-1, -1]) / 4
    second = np.array([[along[0], mixed], [mixed, along[1]]]) / step**2
    return Exact(at[0, 0], np.array(first).T / (2 * step), second.transpose(2, 0, 1))


def exact(function: Callable[..., Numbers], at: tuple[float, float]) -> Exact:
    """Return a problem's answers at two numbers; a float is meant as it is written."""
    a, b = (Decimal(repr(number)) for number in at)
    with decimal.localcontext(CONTEXT):
        found = central(lambda i, k: np.array(function(a * (1 + i * STEP), b * (1 + k * STEP))), STEP)
    return Exact(*(part.astype(float) for part in found))


@functools.lru_cache(maxsize=4096)
def cos_sin(x: Decimal) -> tuple[Decimal, Decimal]:
    """Return cosine and sine by their series."""
    sums, term = [Decimal(1), Decimal(0)], Decimal(1)
    for k in itertools.count(1):
        term *= x / k
        sums[k % 2] += term if k % 4 < 2 else -term
        if abs(term) < Decimal("1e-98") and k > abs(x):
            return sums[0], sums[1]


def first_crossing(motion: Motion, most: Decimal) -> Decimal | None:
    """Return when a gap, given with its rate, falls to zero; None if it does not within the time `most`."""
    until = SCAN
    while motion(min(until, most))[0] > 0:
        if until >= most:
            return None
        until += SCAN
    low, high = until - SCAN, min(until, most)
    for _ in range(12):
        middle = (low + high) / 2
        low, high = (middle, high) if motion(middle)[0] > 0 else (low, middle)
    for _ in range(7):  # the error is squared by each
        gap, rate = motion(high)
        high -= gap / rate
    return high


def oscillation(damping, stiffness, offset, force, frequency, start, x, v) -> Motion:
    """Return the motion of x'' + 2 damping x' + stiffness x = offset + force cos(frequency t) from a time on."""
    detuned, loss = stiffness - frequency**2, 2 * damping * frequency
    across = force / (detuned**2 + loss**2)
    root = (stiffness - damping**2).sqrt()

    def steady(t):
        cosine, sine = cos_sin(frequency * t)
        place = across * (detuned * cosine + loss * sine) + offset / stiffness
        return place, across * frequency * (loss * cosine - detuned * sine)

    place, speed = steady(start)
    y, z = x - place, v - speed

    def motion(span):
        cosine, sine = cos_sin(root * span)
        sine, fade, (place, speed) = sine / root, (-damping * span).exp(), steady(start + span)
        return (
            place + fade * (y * cosine + (z + damping * y) * sine),
            speed + fade * (z * cosine - (damping * z + stiffness * y) * sine),
        )

    return motion


def ball(height, restitution) -> Numbers:
    """A ball falls from a height [m] on a floor: height [m], velocity [m/s] and last impact [s] at the end."""
    speed = (2 * GRAVITY * height).sqrt()
    last, following = Decimal(0), speed / GRAVITY
    while following < BALL_END:
        last, speed = following, restitution * speed
        following = last + 2 * speed / GRAVITY
    since = BALL_END - last
    return [speed * since - GRAVITY * since**2 / 2, speed - GRAVITY * since, last]


def stop(start, force) -> Numbers:
    """An oscillator below a rigid stop, from rest at `start`: place, velocity and last impact at the end."""
    x, v, last = start, Decimal(0), Decimal(0)
    while True:
        arc = oscillation(DAMPING, Decimal(1), Decimal(0), force, FREQUENCY, last, x, v)
        gap = lambda span, arc=arc: (GAP - arc(span)[0], -arc(span)[1])
        span = first_crossing(gap, STOP_END - last)
        if span is None:
            return [*arc(STOP_END - last), last]
        x, v, last = GAP, -REBOUND * arc(span)[1], last + span


def play(start, force) -> Numbers:
    """An oscillator between two springs with play: place, velocity, and the time in contact until the end."""
    x, v, side, time, contact = start, Decimal(0), 0, Decimal(0), Decimal(0)
    while True:
        arc = oscillation(SOFT, 1 + abs(side) * SPRING, side * SPRING * PLAY, force, SLOW, time, x, v)
        # a spring is left, or one of two is reached
        inside = 1 if side == 0 else -1

        def room(k, span, arc=arc, inside=inside):
            x, v = arc(span)
            return inside * (PLAY - k * x), -inside * k * v

        spans = {
            k: first_crossing(functools.partial(room, k), PLAY_END - time) for k in ((side,) if side else (-1, 1))
        }
        span, k = min(((span, k) for k, span in spans.items() if span is not None), default=(PLAY_END - time, None))
        contact += abs(side) * span
        x, v = arc(span)
        if k is None:
            return [x, v, contact]
        side, time = k - side, time + span


def table(height, amplitude) -> Numbers:
    """A ball on a table that moves as a sine, in units of g = 1 and its frequency: height, velocity, last impact."""
    y, v, last = height, Decimal(0), Decimal(0)
    while True:

        def gap(span, y=y, v=v, last=last):
            cosine, sine = cos_sin(last + span)
            return y + v * span - span**2 / 2 - amplitude * sine, v - span - amplitude * cosine

        span = first_crossing(gap, TABLE_END - last)
        if span is None:
            since = TABLE_END - last
            return [y + v * since - since**2 / 2, v - since, last]
        last += span
        cosine, sine = cos_sin(last)
        y, v = amplitude * sine, amplitude * cosine - TABLE_REBOUND * gap(span)[1]


def flights(upper, share) -> Iterator[tuple[Decimal, Numbers, Numbers]]:
    """Two balls fall, the lower one from `LOWER`: instants of impacts, heights and velocities after them."""
    heights, speeds, time = [LOWER, upper], [Decimal(0)] * 2, Decimal(0)
    while True:
        yield time, heights, speeds
        (low, high), (down, up) = heights, speeds
        floor = (down + (down**2 + 2 * GRAVITY * low).sqrt()) / GRAVITY
        meeting = (high - low) / (down - up) if down > up else Decimal("Infinity")
        span = min(floor, meeting)
        time += span
        heights = [h + v * span - GRAVITY * span**2 / 2 for h, v in zip(heights, speeds, strict=True)]
        down, up = (v - GRAVITY * span for v in speeds)
        if floor < meeting:
            heights[0], down = Decimal(0), -BALLS_REBOUND * down
        else:
            # masses 1 and `share`
            change = (1 + BALLS_REBOUND) * (down - up) / (1 + share)
            heights[1], down, up = heights[0], down - share * change, up + change
        speeds = [down, up]


def balls(upper, share) -> Numbers:
    """Two balls above each other, by the height of the upper one [m] and its mass over the other's.

    Heights [m], velocities [m/s], the last impact [s].
    """
    *_, (last, heights, speeds) = itertools.takewhile(lambda flight: flight[0] < BALLS_END, flights(upper, share))
    since = BALLS_END - last
    ends = [h + v * since - GRAVITY * since**2 / 2 for h, v in zip(heights, speeds, strict=True)]
    return [*ends, *(v - GRAVITY * since for v in speeds), last]
