"""A sled on several slippers, written anew from the equations with NumPy and SciPy, to test slipperjax with.

It shares no code with slipperjax, and differs from it where it can: time is the independent variable, not distance;
the attitude is the nine numbers of a rotation matrix; vectors across the rail are complex numbers y + i z; an
adaptive method of eighth order stops wherever a contact begins, ends or is clamped. SI units.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import DOP853
from scipy.optimize import brentq

CORNERS = np.array(  # Table 1, y + i z, of A to J
    [
        0.03 + 0.013j,
        0.048 + 0.0055j,
        0.048 - 0.0145j,
        0.0445 - 0.0249j,
        0.029 - 0.029j,
        -0.029 - 0.029j,
        -0.0445 - 0.0249j,
        -0.048 - 0.0145j,
        -0.048 + 0.0055j,
        -0.03 + 0.013j,
    ]
)
MATE = np.array([9, 2, 1, 4, 3, 6, 5, 8, 7, 0])  # the other corner of each point's face
# -i times the way from a point to its mate is at right angles to their face; 1 where that points out of the rail head
OUTWARD = np.sign((-1j * (CORNERS[MATE] - CORNERS) * np.conj(CORNERS[MATE] + CORNERS - 2 * CORNERS.mean())).real)
SLOWEST = 1e-3  # least approach rate that is remembered
SAMPLING = 1e-5  # longest time between instants at which gaps and forces are looked at
TOGETHER = 1e-13  # events closer to each other than this are one
# where in the state: y + i z as two numbers, their rates, spins about the body's axes, rows of the rotation matrix;
# then the modes' amplitudes, and their rates
PLACE, VELOCITY, SPIN, TURN, MODES = slice(0, 2), slice(2, 4), slice(4, 7), slice(7, 16), slice(16, None)
# to which the tolerance is relative: millimetres, metres per second, ...
SIZES = np.concatenate([[1e-3] * 2, [1.0] * 2, [10.0] * 3, [1e-2] * 9])


@dataclass
class Rail:
    """Sums of sines: amplitudes and phases of lateral and vertical displacement and of roll, each (waves, 3)."""

    wavelengths: np.ndarray
    amplitudes: np.ndarray
    phases: np.ndarray


@dataclass
class Slipper:
    """Where a slipper is on the body, the number of its rail, its length, and the play of each face."""

    place: tuple = (0.0, 0.0, 0.0)
    rail: int = 0
    length: float = 0.2
    play: float = 0.5e-3


@dataclass
class Modes:
    """Elastic modes of the free body, of unit modal mass; shapes: of the slippers, (modes, slippers, 3)."""

    frequency: np.ndarray = field(default_factory=lambda: np.zeros(0))  # [Hz]
    damping: np.ndarray = field(default_factory=lambda: np.zeros(0))  # ratios
    shapes: np.ndarray | None = None


@dataclass
class Case:
    """A body on slippers at constant speed. Its centre of mass is half a `length` behind the distance travelled."""

    speed: float
    mass: float
    inertia: tuple
    slippers: list
    rails: list
    stiffness: float = 1e8
    restitution: float = 0.9
    gravity: float = 0.0
    length: float = 0.2
    modes: Modes = field(default_factory=Modes)

    def __post_init__(self):
        # two nodes a slipper, ten points a node
        slippers = [slipper for slipper in self.slippers for _ in range(2)]
        half = np.array([s.length / 2 * (1, -1)[k % 2] for k, s in enumerate(slippers)])
        places = np.array([s.place for s in slippers], float)
        self.node_x = places[:, 0] + half
        self.axis = (places[:, 1] + 1j * places[:, 2])[:, None]
        self.length_of_node = 2 * np.abs(half)[:, None]
        self.waves = np.array([2 * np.pi / np.asarray(self.rails[s.rail].wavelengths) for s in slippers])
        sines = [np.asarray(r.amplitudes) * np.exp(1j * np.asarray(r.phases)) for r in self.rails]
        self.sines = np.array([sines[s.rail] for s in slippers])  # (nodes, waves, channels)
        outward = -1j * OUTWARD * (CORNERS[MATE] - CORNERS)
        outward /= np.abs(outward)
        play = np.array([s.play for s in slippers])[:, None]
        self.on_rail = CORNERS - play * outward  # (nodes, points), from the rail's axis
        across = self.axis + CORNERS
        self.on_body = np.stack([self.node_x[:, None] + 0 * across.real, across.real, across.imag], axis=-1)
        self.on_body = self.on_body.reshape(-1, 3)
        self.points = len(self.on_body)
        self.factor = 8 * (1 - self.restitution) / (5 * self.restitution)
        count = len(self.modes.frequency)
        shapes = np.zeros((0, len(self.slippers), 3)) if count == 0 else np.asarray(self.modes.shapes, float)
        self.shapes = np.repeat(shapes, 20, axis=1)  # (modes, points, 3)
        self.omega = 2 * np.pi * np.asarray(self.modes.frequency)
        self.sizes = np.concatenate([SIZES, np.full(count, 1e-3), np.full(count, 1.0)])

    def start(self, *, y=0.0, z=0.0, v_y=0.0, v_z=0.0, spin=(0.0, 0.0, 0.0)):
        """A state that is level, without deflection."""
        return np.concatenate([[y, z, v_y, v_z], spin, np.eye(3).ravel(), np.zeros(2 * len(self.omega))])

    def track(self, times):
        """The rail at instants: its points, their velocities (less the travel's), and normals as x and y + i z.

        All of shape (instants, points).
        """
        distance = self.speed * times[:, None] - self.length / 2 + self.node_x
        circle = np.exp(1j * self.waves * distance[..., None])
        sum_of = lambda sines: np.einsum("tnw,nwc->tnc", circle, sines).imag[..., None]
        moved, rates = sum_of(self.sines), self.speed * sum_of(1j * self.waves[..., None] * self.sines)
        turn = np.exp(1j * moved[:, :, 2])
        arm = turn * self.on_rail
        head = moved[:, :, 0] + 1j * moved[:, :, 1] + self.axis + arm
        velocity = rates[:, :, 0] + 1j * rates[:, :, 1] + 1j * rates[:, :, 2] * arm
        # Eq. (4): the cross product of the way to the mate, and of the way from the rear node to the front one
        to_mate = OUTWARD * (head[..., MATE] - head)
        lengthwise = np.repeat(head[:, ::2] - head[:, 1::2], 2, axis=1)
        along = (np.conj(to_mate) * lengthwise).imag / self.length_of_node
        size = np.sqrt(along**2 + np.abs(to_mate) ** 2)
        flat = lambda a: a.reshape(len(times), -1)
        return flat(head), flat(velocity), flat(along / size), flat(-1j * to_mate / size)

    def geometry(self, times, states):
        """Gaps and their rates, normals and arms as x and y + i z, and the rotation matrix with its rate."""
        head, velocity, n_x, n = self.track(times)
        turn = states[:, TURN].reshape(-1, 3, 3)
        w_x, w_y, w_z = states[:, SPIN].T
        zero = 0 * w_x
        spin = np.array([[zero, -w_z, w_y], [w_z, zero, -w_x], [-w_y, w_x, zero]]).transpose(2, 0, 1)
        turning = turn @ spin
        arm, moving = (self.on_body @ m.transpose(0, 2, 1) for m in (turn, turning))
        arm_x, arm = arm[..., 0], arm[..., 1] + 1j * arm[..., 2]
        centre = states[:, 0] + 1j * states[:, 1]
        centre_velocity = states[:, 2] + 1j * states[:, 3]
        away = centre[:, None] + arm - head
        approach = centre_velocity[:, None] + moving[..., 1] + 1j * moving[..., 2] - velocity
        gap = n_x * (arm_x - np.repeat(self.node_x, 10)) + (np.conj(n) * away).real
        rate = n_x * moving[..., 0] + (np.conj(n) * approach).real
        if len(self.omega):
            normal = np.stack([n_x, n.real, n.imag], axis=-1)
            by_mode = np.einsum("tpc,mpc->tpm", normal, self.shapes)
            q, q_rate = np.split(states[:, MODES], 2, axis=1)
            gap = gap + np.einsum("tpm,tm->tp", by_mode, q)
            rate = rate + np.einsum("tpm,tm->tp", by_mode, q_rate)
        return gap, rate, (n_x, n), (arm_x, arm), turn, turning

    def damped(self, rate, began):
        """What Eq. (12) multiplies the elastic force by; `began`: rates at touchdown, zero of open points."""
        return 1 + self.factor * np.where(began < 0, rate / np.where(began < 0, began, 1.0), 0.0)

    def forces(self, gap, rate, began, clamped):
        """Eq. (12)."""
        acts = (began < 0) & ~clamped
        return np.where(acts, self.stiffness * np.maximum(-gap, 0.0) ** 1.5 * self.damped(rate, began), 0.0)

    def net(self, times, states, began, clamped):
        """Of each slipper's contacts the force along y and z, and the moment about its middle, body's axes."""
        gap, rate, (n_x, n), (arm_x, arm), turn, _ = self.geometry(times, states)
        vectors = lambda x, across: np.stack([x, across.real, across.imag], axis=-1)
        force = self.forces(gap, rate, began, clamped)[..., None] * vectors(n_x, n)
        middle = np.repeat([s.place for s in self.slippers], 20, axis=0) @ turn.transpose(0, 2, 1)
        moment = np.cross(vectors(arm_x, arm) - middle, force) @ turn
        of_slippers = lambda a: a.reshape(len(times), len(self.slippers), 20, 3).sum(2)
        return np.concatenate([of_slippers(force)[..., 1:], of_slippers(moment)], axis=-1)

    def signs(self, times, states, began, clamped):
        """Numbers that become negative where points close or open, then those where clamps begin or end; also gaps
        and their rates."""
        gap, rate, *_ = self.geometry(times, states)
        switches = np.where(began < 0, -gap, gap)
        clamps = np.where(clamped, -1, 1) * self.damped(rate, began)
        return np.concatenate([switches, clamps], axis=1), gap, rate

    def rates(self, time, state, began, clamped):
        """Derivative of the state."""
        gap, rate, (n_x, n), (arm_x, arm), turn, turning = self.geometry(np.array([time]), state[None])
        force = self.forces(gap, rate, began, clamped)[0]
        n_x, n, arm_x, arm = n_x[0], n[0], arm_x[0], arm[0]
        total = force @ n
        about_x = force @ (np.conj(arm) * n).imag
        across = 1j * (force @ (arm_x * n - n_x * arm))
        moment = np.array([about_x, across.real, across.imag]) @ turn[0]
        (j_x, j_y, j_z), (w_x, w_y, w_z) = self.inertia, state[SPIN]
        gyroscopic = np.array([(j_y - j_z) * w_y * w_z, (j_z - j_x) * w_z * w_x, (j_x - j_y) * w_x * w_y])
        parts = [
            state[VELOCITY],
            [total.real / self.mass, total.imag / self.mass - self.gravity],
            (moment + gyroscopic) / self.inertia,
            turning[0].ravel(),
        ]
        if len(self.omega):
            q, q_rate = np.split(state[MODES], 2)
            pressed = force[:, None] * np.stack([n_x, n.real, n.imag], axis=-1)
            drive = np.einsum("pc,mpc->m", pressed, self.shapes)
            parts += [q_rate, drive - 2 * self.modes.damping * self.omega * q_rate - self.omega**2 * q]
        return np.concatenate(parts)


@dataclass
class Result:
    """What a run leaves: of points an array (slippers, ends, 10) each, and the state at its end."""

    peaks: np.ndarray  # highest forces
    net: np.ndarray  # loads of `Case.net` of greatest magnitude, (slippers, 5)
    when: np.ndarray  # their instants
    touchdowns: np.ndarray
    state: np.ndarray
    steps: int
    shortest: float  # time from an event of a point to its next one
    least: float  # approach rate at a touchdown, before SLOWEST
    clamps: int  # how often a force was clamped

    def euler(self):
        """Roll, pitch and yaw at the end."""
        turn = self.state[TURN].reshape(3, 3)
        return np.arctan2(turn[2, 1], turn[2, 2]), np.arcsin(-turn[2, 0]), np.arctan2(turn[1, 0], turn[0, 0])


def run(case, start, distance, *, tolerance=1e-10, longest=1e-3):
    """Runs over a distance from a state at which all points must be open."""
    state, time, until = np.array(start, float), 0.0, distance / case.speed
    began, clamped = np.zeros(case.points), np.zeros(case.points, bool)
    peaks, touchdowns = np.zeros(case.points), np.zeros(case.points, int)
    net, when = np.zeros((2, len(case.slippers), 5))
    switched = np.full(case.points, -np.inf)
    shortest, least, steps, clamps = np.inf, np.inf, 0, 0
    assert np.all(case.geometry(np.zeros(1), state[None])[0] > 0)
    while time < until:
        solver = DOP853(
            lambda t, y, began=began, clamped=clamped: case.rates(t, y, began, clamped),
            time,
            state,
            until,
            rtol=1e-13 + 1e-3 * tolerance,
            atol=tolerance * case.sizes,
            max_step=longest,
        )
        events = np.zeros(0, int)
        while not len(events) and solver.status == "running":
            solver.step()
            assert solver.status != "failed"
            steps += 1
            path = solver.dense_output()
            instants = np.linspace(solver.t_old, solver.t, 5 + int((solver.t - solver.t_old) / SAMPLING))
            signs = lambda times, path=path, now=(began, clamped): case.signs(times, path(times).T, *now)
            values, gap, rate = signs(instants)
            # at the beginning of a step they are only known to a rounding error
            crossed = np.flatnonzero(np.any(values[1:] < 0, axis=1))
            time, state = solver.t, solver.y
            if len(crossed):
                j = crossed[0]
                found = np.flatnonzero(values[j + 1] < 0)
                roots = np.array([_root(signs, instants[j : j + 2], values[j, k], k) for k in found])
                time = roots.min()
                state = path(time)
                events = found[roots <= time + TOGETHER]
                instants = np.linspace(solver.t_old, time, len(instants))
                _, gap, rate = signs(instants)
            peaks = np.maximum(peaks, _highest(case.forces(gap, rate, began, clamped))[0])
            load = case.net(instants, path(instants).T, began, clamped)
            for sign in (1, -1):
                most, place = _highest(sign * load)
                farther = most > np.abs(net)
                net = np.where(farther, sign * most, net)
                when = np.where(farther, instants[0] + place * (instants[1] - instants[0]), when)
        began, clamped = began.copy(), clamped.copy()
        for event in events:
            k = event % case.points
            if event >= case.points:
                clamped[k] = ~clamped[k]
                clamps += int(clamped[k])
                continue
            shortest, switched[k] = min(shortest, time - switched[k]), time
            clamped[k] = False
            if began[k] < 0:
                began[k] = 0.0
            else:
                least = min(least, -rate[-1, k])
                began[k] = min(rate[-1, k], -SLOWEST)
                touchdowns[k] += 1
    by_end = lambda a: a.reshape(-1, 2, 10)
    return Result(by_end(peaks), net, when, by_end(touchdowns), state, steps, shortest, least, clamps)


def _root(signs, between, first, k):
    """The instant at which number `k` of `signs` is zero, `first` at the first of two instants."""
    if first <= 0:  # at once
        return between[0]
    return brentq(lambda t: signs(np.array([t]))[0][0, k], *between, xtol=1e-17, rtol=1e-15)


def _highest(force):
    """Highest values of equally spaced samples along the first axis, by parabolas through three of them, and the
    places where they are [samples]."""
    middle = np.clip(np.argmax(force, axis=0), 1, len(force) - 2)[None]
    before, here, after = (np.take_along_axis(force, middle + shift, axis=0)[0] for shift in (-1, 0, 1))
    rise, bend = (after - before) / 2, before + after - 2 * here
    x = np.clip(-rise / np.where(bend < 0, bend, -np.inf), -1, 1)
    return np.maximum(here + x * rise + x**2 * bend / 2, force.max(axis=0)), middle[0] + x
