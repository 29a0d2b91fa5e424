"""A run of a slipper over a rail, written anew from the equations with NumPy and SciPy, to test slipperjax with.

It shares no code with slipperjax, and differs from it where it can: time is the independent variable, not distance;
attitudes are Euler angles; an adaptive method of eighth order stops at every touchdown and every lift-off, and where
an approach becomes the fastest of its contact, or slower again; work and impulse are states of the differential
equation. SI units.
"""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

POINTS = 20  # A to J of the front section, then of the rear section
CORNERS = np.array(  # Table 1, y and z
    [
        [0.03, 0.013],
        [0.048, 0.0055],
        [0.048, -0.0145],
        [0.0445, -0.0249],
        [0.029, -0.029],
        [-0.029, -0.029],
        [-0.0445, -0.0249],
        [-0.048, -0.0145],
        [-0.048, 0.0055],
        [-0.03, 0.013],
    ]
)
MATE = np.array([9, 2, 1, 4, 3, 6, 5, 8, 7, 0])  # the other corner of each point's face
SLOWEST = 1e-3  # least approach rate that is remembered
STEP = 1e-7  # for the slopes of rates
SAMPLING = 1e-5  # between instants at which forces are looked at, about 1 % of the time of a contact
# where in the state: y, z, roll, pitch, yaw, v_y, v_z, w_x, w_y, w_z, then integrals over time
MOTION = slice(0, 10)
HEAT, IMPULSE, WORK = slice(10, 30), slice(30, 50), 50
# to which the tolerance is relative: millimetres, hundredths of a radian, ..., newton seconds and joules
SIZES = np.concatenate([[1e-3] * 2, [1e-2] * 3, [1.0] * 2, [10.0] * 3, [1e2] * 20, [10.0] * 20, [1e4]])


def outward_normals():
    """The faces' unit normals (y, z) out of the rail head, of A to J."""
    normals = []
    for k, mate in enumerate(MATE):
        along = CORNERS[mate] - CORNERS[k]
        normal = np.array([along[1], -along[0]]) / np.hypot(*along)
        middle = (CORNERS[mate] + CORNERS[k]) / 2 - CORNERS.mean(axis=0)
        normals.append(normal if normal @ middle > 0 else -normal)
    return np.array(normals)


def cross(a, b):
    """Cross products of rows: np.cross is slow for few of them."""
    (a_x, a_y, a_z), (b_x, b_y, b_z) = a.T, b.T
    return np.array([a_y * b_z - a_z * b_y, a_z * b_x - a_x * b_z, a_x * b_y - a_y * b_x]).T


def slipper_rotation(roll, pitch, yaw):
    """Eq. (2): Rz(yaw) Ry(pitch) Rx(roll)."""
    (s, c), (sp, cp), (sy, cy) = ((np.sin(angle), np.cos(angle)) for angle in (roll, pitch, yaw))
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_x = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    return about_z @ about_y @ about_x


class Programme:
    """Speed and travel over time, with one acceleration from each place to the next."""

    def __init__(self, places, speeds):
        self.places, self.speeds = np.asarray(places, float), np.asarray(speeds, float)
        self.accelerations = np.diff(self.speeds**2) / (2 * np.diff(self.places))
        self.times = np.append(0.0, np.cumsum(2 * np.diff(self.places) / (self.speeds[1:] + self.speeds[:-1])))

    def when(self, distance):
        """Time at which a distance is reached."""
        k = min(np.searchsorted(self.places, distance, side="right") - 1, len(self.accelerations) - 1)
        v, a, way = self.speeds[k], self.accelerations[k], distance - self.places[k]
        return self.times[k] + 2 * way / (v + np.sqrt(v**2 + 2 * a * way))

    def at(self, k, time):
        """Travel, speed and acceleration at a time in part `k`."""
        since, v, a = time - self.times[k], self.speeds[k], self.accelerations[k]
        return self.places[k] + v * since + a * since**2 / 2, v + a * since, a


@dataclass
class Case:
    """A slipper on a rail that is a sum of sines, equal along y and z and in roll.

    With `fastest` the damping refers to the fastest approach since touchdown, and not to that at touchdown.
    """

    programme: Programme
    wavelengths: tuple = (8.0,)
    amplitude: float = 1e-3
    roll_amplitude: float = np.radians(0.2)
    mass: float = 14.0
    inertia: tuple = (0.051, 0.060, 0.086)
    length: float = 0.2
    clearance: float = 1e-3
    stiffness: float = 1e8
    restitution: float = 0.9
    gravity: float = 0.0
    friction: float = 0.0
    force_by_square: tuple = (0.0, 0.0, 0.0)
    moment_by_square: tuple = (0.0, 0.0, 0.0)
    fastest: bool = False

    def __post_init__(self):
        side = np.repeat([0.5, -0.5], 10) * self.length
        self.on_slipper = np.column_stack([side, np.tile(CORNERS, (2, 1))])  # in the slipper's frame
        self.plain_normals = np.tile(np.column_stack([np.zeros(10), outward_normals()]), (2, 1))
        self.on_track = self.on_slipper - self.clearance / 2 * self.plain_normals
        self.on_track[:, 0] = 0.0  # in the frame of the point's node
        self.factor = 8 * (1 - self.restitution) / (5 * self.restitution)

    def rail(self, distance):
        """Displacements along y and z, roll, and the slopes of these, at a distance."""
        waves = [2 * np.pi / length for length in self.wavelengths]
        height, slope = sum(np.sin(k * distance) for k in waves), sum(k * np.cos(k * distance) for k in waves)
        sizes = np.array([self.amplitude, self.amplitude, self.roll_amplitude])
        return (*(sizes * height), *(sizes * slope))

    def track(self, travel, speed):
        """Positions, velocities (less the travel's) and normals of the rail's points."""
        positions, velocities, normals = [], [], []
        for node in range(2):
            lateral, vertical, roll, *slopes = self.rail(travel - node * self.length)
            v_y, v_z, spin = (slope * speed for slope in slopes)
            s, c = np.sin(roll), np.cos(roll)
            turn = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
            arm = self.on_track[10 * node : 10 * node + 10] @ turn.T
            positions.append(np.array([(0.5 - node) * self.length, lateral, vertical]) + arm)
            velocities.append(np.array([0, v_y, v_z]) + spin * cross(np.array([1.0, 0, 0]), arm))
            normals.append(self.plain_normals[:10] @ turn.T)
        across = np.concatenate([place[MATE] - place for place in positions])
        lengthwise = positions[1] - positions[0]
        normal = cross(across, np.concatenate([lengthwise, lengthwise]))  # Eq. (4)
        normal /= np.sqrt(np.sum(normal**2, axis=1, keepdims=True))
        normal *= np.sign(np.sum(normal * np.concatenate(normals), axis=1, keepdims=True))
        return np.concatenate(positions), np.concatenate(velocities), normal

    @property
    def sizes(self):
        """Numbers of the state to which the tolerance is relative."""
        return SIZES

    def bends(self, state, travel, speed):
        """Deflections of a rail that bends at the points, and their rates; normals stay those of the rigid rail."""
        return 0.0, 0.0

    def geometry(self, state, travel, speed):
        """Gaps, their rates, normals, arms about the centre, velocities (less the travel's) and attitude."""
        place, velocity, normal = self.track(travel, speed)
        deflection, its_rate = self.bends(state, travel, speed)
        place, velocity = place + deflection, velocity + its_rate
        turn = slipper_rotation(*state[2:5])
        arm = self.on_slipper @ turn.T
        moving = np.array([0.0, state[5], state[6]]) + cross(turn @ state[7:10], arm)
        gap = np.sum(normal * (arm + np.array([0.0, state[0], state[1]]) - place), axis=1)
        rate = np.sum(normal * (moving - velocity), axis=1)
        return gap, rate, normal, arm, moving, turn

    def forces(self, gap, rate, began, leads):
        """Eq. (12), from reference rates `began`, which are zero of open points, and 1 where a rate `leads` them."""
        closed = began < 0
        ratio = np.where(leads, 1.0, np.where(closed, rate, 0.0) / np.where(closed, began, 1.0))
        force = self.stiffness * np.maximum(-gap, 0.0) ** 1.5 * (1 + self.factor * ratio)
        return np.where(closed, np.maximum(force, 0.0), 0.0)

    def rates(self, state, began, leads, travel, speed, acceleration):
        """Derivative of the state with its integrals."""
        gap, rate, normal, arm, moving, turn = self.geometry(state, travel, speed)
        force = self.forces(gap, rate, began, leads)
        sliding = moving + np.array([speed, 0.0, 0.0])
        sliding = sliding - np.sum(sliding * normal, axis=1, keepdims=True) * normal
        slip = np.linalg.norm(sliding, axis=1)
        pressed = force[:, None] * normal - (self.friction * force / slip)[:, None] * sliding
        load = speed**2 * np.array(self.force_by_square)
        total = np.sum(pressed, axis=0) + load - [0.0, 0.0, self.mass * self.gravity]
        moment = turn.T @ np.sum(cross(arm, pressed), axis=0) + speed**2 * np.array(self.moment_by_square)
        inertia, w = np.array(self.inertia), state[7:10]
        w_x, w_y, w_z = w
        (s, c), pitch = (np.sin(state[2]), np.cos(state[2])), state[3]
        turning = s * w_y + c * w_z
        drive = self.mass * acceleration - total[0]
        return np.concatenate(
            [
                state[5:7],
                [w_x + turning * np.tan(pitch), c * w_y - s * w_z, turning / np.cos(pitch)],
                total[1:] / self.mass,
                (moment - cross(w, inertia * w)) / inertia,
                self.friction * force * slip,
                force,
                [drive * speed],
            ]
        )


@dataclass
class Result:
    """What a run leaves: arrays (windows, 20) or (windows,), and the motion at its end."""

    time: np.ndarray  # at the windows' ends
    peaks: np.ndarray  # highest forces
    heat: np.ndarray  # of friction
    impulse: np.ndarray
    touchdowns: np.ndarray
    drive: np.ndarray  # mean force over distance
    motion: np.ndarray


def run(case, start, windows, *, window=1.0, tolerance=1e-8, longest=1e-4, sampling=SAMPLING):
    """Runs over a number of windows from ten numbers of motion, from which all points must be open."""
    programme = case.programme
    ends = np.array([programme.when(window * (k + 1)) for k in range(windows)])
    knots = [t for t in programme.times[1:] if t < ends[-1]]
    size = len(case.sizes)
    state, time, began, leads = np.zeros(size), 0.0, np.zeros(POINTS), np.zeros(POINTS, bool)
    state[MOTION] = start
    assert np.all(case.geometry(state, *programme.at(0, 0.0)[:2])[0] > 0)
    totals, peaks = np.zeros((windows + 1, size)), np.zeros((windows, POINTS))
    touchdowns = np.zeros((windows, POINTS), int)
    part = 0
    while time < ends[-1]:
        until = knots[0] if knots else ends[-1]
        found = {}

        def points(t, y, part=part):
            return case.geometry(y, *programme.at(part, t)[:2])[:2]

        def flow(t, y, part=part, began=began, leads=leads):
            return case.rates(y, began, leads, *programme.at(part, t))

        def seen(t, y, points=points, flow=flow, found=found):
            """Gaps, their rates, and the slopes of these."""
            if found.get("at") != t or not np.array_equal(found["y"], y):
                slope = np.zeros(POINTS)
                if case.fastest:
                    later, before = (points(t + h, y + h * flow(t, y))[1] for h in (STEP, -STEP))
                    slope = (later - before) / (2 * STEP)
                found.update(at=t, y=y.copy(), seen=(*points(t, y), slope))
            return found["seen"]

        events, points_of = [], []
        for k in range(POINTS):
            of_gap = lambda t, y, k=k: seen(t, y)[0][k]
            passing = lambda t, y, k=k, rate=began[k]: seen(t, y)[1][k] - rate
            turning = lambda t, y, k=k: seen(t, y)[2][k]
            # a point that touches down, one that opens or passes its fastest rate, one that does not gain any more
            kinds = [(turning, 1)] if leads[k] else [(of_gap, 1 if began[k] < 0 else -1)]
            if case.fastest and began[k] < 0 and not leads[k]:
                kinds.append((passing, -1))
            for event, event.direction in kinds:
                event.terminal = True
                events.append(event)
                points_of.append((k, event))
        solution = solve_ivp(
            flow,
            (time, until),
            state,
            "DOP853",
            rtol=1e-14 + 1e-3 * tolerance,
            atol=tolerance * case.sizes,
            max_step=longest,
            events=events,
            dense_output=True,
        )
        assert solution.success, solution.message
        stop = solution.t[-1]
        inside = (ends > time) & (ends <= stop)
        if np.any(inside):
            totals[1:][inside] = solution.sol(ends[inside]).T
        instants = np.concatenate([np.linspace(time, stop, 2 + int((stop - time) / sampling)), ends[inside]])
        for t in instants:
            travel, speed, _ = programme.at(part, t)
            gap, rate, *_ = case.geometry(solution.sol(t), travel, speed)
            force = case.forces(gap, rate, began, leads)
            # both windows have their common end
            for k in {int(travel / window - 1e-9), int(travel / window + 1e-9)} & set(range(windows)):
                peaks[k] = np.maximum(peaks[k], force)
        time, state = stop, solution.y[:, -1]
        if solution.status == 1:
            travel, speed, _ = programme.at(part, time)
            gap, rate, slope = seen(time, state)
            began, leads = began.copy(), leads.copy()
            for (k, event), times in zip(points_of, solution.t_events, strict=True):
                if not len(times):
                    continue
                if leads[k]:
                    began[k], leads[k] = rate[k], False
                elif began[k] == 0:
                    began[k] = min(rate[k], -SLOWEST)
                    leads[k] = case.fastest and rate[k] < -SLOWEST and slope[k] < 0
                    touchdowns[min(int(travel / window), windows - 1), k] += 1
                elif event.direction == 1:
                    began[k] = 0.0
                elif slope[k] < 0:
                    leads[k] = True
                else:
                    # a touchdown's own rate, which rounding passes at once though the approach slows down
                    began[k] -= 1e-12
        elif knots:
            knots.pop(0)
            part += 1
    gained = np.diff(totals, axis=0)
    drive = gained[:, WORK] / window
    return Result(ends, peaks, gained[:, HEAT], gained[:, IMPULSE], touchdowns, drive, state[MOTION])
