"""Other codes that integrate the same model, for comparison: a scalar C++ program, and SciPy on plain NumPy.

They share no code with the package.
"""

import math
import re
import shutil
import statistics
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import slipperjax as sj

from ..bench.methods import Case
from .timing import seconds

Run = tuple[str, np.ndarray, tuple[float, float], np.ndarray]
"""Setting, states (cases, periods, 10), best and median seconds per trajectory, and which of the speeds they are."""


def plain_numbers(case: Case) -> dict[str, float] | None:
    """The scene as plain numbers; None where these codes lack something that it has."""
    scene, track = case.scene, case.scene.track
    # parts that a slipper alone has not, such as elastic modes, are None
    given = lambda start: {name: float(value) for name, value in vars(start).items() if value is not None}
    other_start = given(case.start) != given(sj.table_2_start())
    if not isinstance(track, sj.HarmonicTrack) or len(track.wavelengths) > 2 or other_start:
        return None
    if scene.gravity is not None and float(scene.gravity) != 0:
        return None
    names = ("clearance", "length", "stiffness", "restitution", "amplitude", "roll_amplitude")
    waves = [*map(float, track.wavelengths), 0.0]
    return {name: float(scene.value(name)) for name in names} | dict(wave=waves[0], wave2=waves[1])


class CppProgram:
    """peer.cpp, compiled into a folder; skips the test where g++ is not installed."""

    def __init__(self, folder: Path):
        if shutil.which("g++") is None:
            pytest.skip("g++ is not installed, so the C++ peer cannot be built")
        self.path = folder / "peer"
        source = Path(__file__).with_name("peer.cpp")
        subprocess.run(["g++", "-O3", "-march=native", str(source), "-o", str(self.path)], check=True)

    def __call__(self, speed: float, numbers: dict[str, float], periods: int, steps: int) -> tuple[np.ndarray, float]:
        """The states after each period (periods, 10) from Table 2's start, and microseconds per step."""
        command = [str(self.path), *map(str, [speed, *numbers.values(), periods, steps])]
        *rows, last = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
        states = np.array([[float(x) for x in row.split()[1:11]] for row in rows])
        return states, float(re.findall(r"([\d.]+) us", last)[0])


class CppPeer:
    """The scalar C++ program, RK4 with the event latch."""

    name = "C++ scalar, RK4, event latch"
    steps = (50, 100, 200, 400, 800, 1600, 3200)

    def runs(self, case: Case, speeds: np.ndarray) -> Iterator[Run]:
        """Runs a scene of the benchmark at some of the speeds [m/s]; nothing where it cannot."""
        numbers = plain_numbers(case)
        if numbers is None:
            return
        picked = np.unique(np.linspace(0, len(speeds) - 1, min(15, len(speeds))).round().astype(int))
        least = min(self.steps) if numbers["stiffness"] < 1e9 else 200
        with tempfile.TemporaryDirectory() as folder:
            program = CppProgram(Path(folder))
            for steps in (n for n in self.steps if n >= least):
                found = [program(speed, numbers, case.periods, steps) for speed in speeds[picked]]
                taken = [1e-6 * each * steps * case.periods for _, each in found]
                states = np.array([states for states, _ in found])
                yield f"{steps} steps", states, (min(taken), statistics.median(taken)), picked


_Y = np.array([0.03, 0.048, 0.048, 0.0445, 0.029, -0.029, -0.0445, -0.048, -0.048, -0.03])
_Z = np.array([0.013, 0.0055, -0.0145, -0.0249, -0.029, -0.029, -0.0249, -0.0145, 0.0055, 0.013])
_CORNERS = ((0, 9), (1, 2), (3, 4), (5, 6), (7, 8))
_MASS, _INERTIA = 14.0, np.array([0.051, 0.060, 0.086])


class NumpyModel:
    """The paper's equations in plain NumPy with Euler angles; touchdowns and lift-offs are events.

    State: y, z, roll, pitch, yaw, v_y, v_z and the spin w in the slipper's frame.
    """

    def __init__(self, speed: float, numbers: dict[str, float]):
        self.speed, self.numbers = speed, numbers
        self.damping = 8 * (1 - numbers["restitution"]) / (5 * numbers["restitution"])
        normals = np.zeros((10, 2))
        for a, b in _CORNERS:
            dy, dz = _Y[b] - _Y[a], _Z[b] - _Z[a]
            n = np.array([-dz, dy]) / math.hypot(dy, dz)
            outside = n[0] * (_Y[a] + _Y[b]) + n[1] * (_Z[a] + _Z[b] + 0.01)
            normals[[a, b]] = n if outside > 0 else -n
        self.n_y, self.n_z = normals.T
        self.t_y = _Y - numbers["clearance"] / 2 * self.n_y
        self.t_z = _Z - numbers["clearance"] / 2 * self.n_z
        self.arm = np.stack([np.repeat([0.5, -0.5], 10) * numbers["length"], np.tile(_Y, 2), np.tile(_Z, 2)])
        self.closed = np.zeros(20, bool)
        self.began = np.full(20, -1.0)
        self._last: tuple[float, bytes, tuple] | None = None

    def contacts(self, t: float, s: np.ndarray) -> tuple:
        """Gap [m], its rate [m/s], normals (3, 20), arms (3, 20) and the attitude matrix at time t [s]."""
        key = s.tobytes()
        if self._last is not None and self._last[0] == t and self._last[1] == key:
            return self._last[2]
        p = self.numbers
        times = np.array([t, t - p["length"] / self.speed])
        waves = [2 * math.pi * self.speed / w for w in (p["wave"], p["wave2"]) if w > 0]
        shape = np.sum([np.sin(w * times) for w in waves], axis=0)
        rate = np.sum([w * np.cos(w * times) for w in waves], axis=0)
        c, d = np.cos(p["roll_amplitude"] * shape)[:, None], np.sin(p["roll_amplitude"] * shape)[:, None]
        n_y, n_z = c * self.n_y - d * self.n_z, d * self.n_y + c * self.n_z
        rail_y, rail_z = c * self.t_y - d * self.t_z, d * self.t_y + c * self.t_z
        lift, speed, turn = (a[:, None] for a in (p["amplitude"] * shape, p["amplitude"] * rate, rate))
        turn = p["roll_amplitude"] * turn
        v_y, v_z = speed - turn * rail_z, speed + turn * rail_y
        rail_y, rail_z = rail_y + lift, rail_z + lift
        n_x = (n_y * (rail_y[1] - rail_y[0]) + n_z * (rail_z[1] - rail_z[0])) / p["length"]
        n = np.stack([n_x, n_y, n_z]).reshape(3, 20) / np.sqrt(1 + n_x.ravel() ** 2)
        (cr, cp, cy), (sr, sp, sy) = np.cos(s[2:5]), np.sin(s[2:5])
        turn_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
        turn_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
        turn_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
        attitude = turn_z @ turn_y @ turn_x
        r = attitude @ self.arm
        w = (attitude @ s[7:])[:, None]
        gap = (
            n[0] * (r[0] - self.arm[0])
            + n[1] * (s[0] + r[1] - rail_y.ravel())
            + n[2] * (s[1] + r[2] - rail_z.ravel())
        )
        v = np.stack([w[1] * r[2] - w[2] * r[1], w[2] * r[0] - w[0] * r[2], w[0] * r[1] - w[1] * r[0]])
        gap_rate = n[0] * v[0] + n[1] * (s[5] + v[1] - v_y.ravel()) + n[2] * (s[6] + v[2] - v_z.ravel())
        found = gap, gap_rate, n, r, attitude
        self._last = t, key, found
        return found

    def __call__(self, t: float, s: np.ndarray) -> np.ndarray:
        """Derivative of the state [per second]."""
        gap, rate, n, r, attitude = self.contacts(t, s)
        depth = np.maximum(-gap, 0.0)
        ratio = np.where(self.closed, rate / self.began, 1.0)
        force = np.maximum(self.numbers["stiffness"] * depth * np.sqrt(depth) * (1 + self.damping * ratio), 0.0)
        total = n @ force
        moment = np.stack([r[1] * n[2] - r[2] * n[1], r[2] * n[0] - r[0] * n[2], r[0] * n[1] - r[1] * n[0]]) @ force
        w = s[7:]
        spin = (attitude.T @ moment - np.cross(w, _INERTIA * w)) / _INERTIA
        c, d = math.cos(s[2]), math.sin(s[2])
        q = (w[1] * d + w[2] * c) / math.cos(s[3])
        angles = [w[0] + q * math.sin(s[3]), w[1] * c - w[2] * d, q]
        return np.array([s[5], s[6], *angles, total[1] / _MASS, total[2] / _MASS, *spin])

    def event(self, k: int):
        """An event function that falls through zero where point k touches down, or lifts off if it is closed."""

        def value(t, s):
            gap = self.contacts(t, s)[0][k]
            return -gap if self.closed[k] else gap

        value.terminal, value.direction = True, -1.0
        return value


class SciPyPeer:
    """`scipy.integrate.solve_ivp`, stopped and started again at every touchdown and lift-off. One trajectory."""

    def __init__(self, method: str, tolerances: tuple[float, ...] = (1e-3, 1e-5, 1e-7)):
        self.name = f"SciPy {method} with events"
        self.method, self.tolerances = method, tolerances

    def runs(self, case: Case, speeds: np.ndarray) -> Iterator[Run]:
        """Runs a scene of the benchmark at the middle one of the speeds [m/s]; nothing where it cannot."""
        numbers = plain_numbers(case)
        if numbers is None:
            return
        picked = np.array([len(speeds) // 2])
        for tolerance in self.tolerances:
            speed = speeds[picked[0]]
            states, taken = seconds(
                lambda speed=speed, rtol=tolerance: self.integrate(speed, numbers, case.periods, rtol)
            )
            if states is None:
                print(f"{self.name} left out at rtol {tolerance:.0e}: more than 10,000 events")
            else:
                yield f"rtol {tolerance:.0e}", states[None], (taken, taken), picked

    def integrate(self, speed: float, numbers: dict[str, float], periods: int, tolerance: float) -> np.ndarray | None:
        """States (periods, 10) from Table 2's start; None where it stops at more than 10,000 events."""
        model = NumpyModel(speed, numbers)
        events = [model.event(k) for k in range(20)]
        period = numbers["wave"] / speed
        t, s = 0.0, np.array([0, 0, 0, 0, 0, 0.5, 0.5, 0.2, 0.3, 0.4])
        ends, count = [], 0
        options = dict(method=self.method, rtol=tolerance, atol=1e-3 * tolerance, events=events)
        while len(ends) < periods:
            end = (len(ends) + 1) * period
            found = solve_ivp(model, (t, end), s, **options)
            t, s = found.t[-1], found.y[:, -1]
            if found.status == 0:
                ends.append(s)
                t = end
                continue
            count += 1
            if found.status < 0 or count > 10_000:
                return None
            rate = model.contacts(t, s)[1]
            for k, times in enumerate(found.t_events):
                if len(times):
                    model.closed[k] = not model.closed[k]
                    model.began[k] = min(rate[k], -1e-9)
        return np.array(ends)


PEERS = (CppPeer(), SciPyPeer("DOP853"), SciPyPeer("Radau"))
"""The codes compared with."""
