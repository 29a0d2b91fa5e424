"""Derivatives of the slipper's motion by landed.cpp: tests/data/gradients.json.

    python -m tests.benchmarks.landed  # some minutes; needs g++

The state after some periods is computed on Chebyshev points of both numbers, the start's v_y and the speed, and its
derivatives are those of the polynomial through them.
"""

import itertools
import json
import subprocess
import tempfile
from pathlib import Path

import numpy as np

STORED = Path(__file__).parents[1] / "data" / "gradients.json"
SCENE = "1e-3 0.2 1e8 0.9 1e-3 0.003490658503988659 8 0"
"""The paper's clearance, length, stiffness, restitution, amplitude, roll amplitude and wavelength [SI units]."""
AT, WIDTHS = np.array([0.5, 1250.0]), np.array([2e-3, 5e-4])
"""The start's v_y [m/s] and the speed [m/s], and the relative half widths of the grid."""
COLUMNS = {"y": 0, "z": 1, "v_y": 5, "v_z": 6}
PERIODS, STEPS, POINTS = (3, 30), 4000, 5


def built(folder: str) -> Path:
    """Compile the program."""
    program = Path(folder) / "landed"
    source = Path(__file__).with_name("landed.cpp")
    subprocess.run(["g++", "-O3", "-march=native", "-w", str(source), "-o", str(program)], check=True)
    return program


def states(program: Path, v_y: float, speed: float, steps: int = STEPS, periods: int = PERIODS[-1]) -> np.ndarray:
    """Return the states after each period, (periods, 4)."""
    command = [str(program), str(speed), *SCENE.split(), str(periods), str(steps), str(v_y)]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return np.array([line.split()[1:] for line in printed.splitlines()], float)[:, list(COLUMNS.values())]


def derivatives(values: np.ndarray, nodes: np.ndarray) -> dict[str, list]:
    """Return value, first and second derivatives by relative changes, from values (points, points, outputs)."""
    inverse = np.linalg.inv(np.vander(nodes, increasing=True))
    c = np.einsum("ai,bj,ijm->abm", inverse, inverse, values)
    first = np.stack([c[1, 0], c[0, 1]], axis=-1) / WIDTHS
    second = np.array([[2 * c[2, 0], c[1, 1]], [c[1, 1], 2 * c[0, 2]]]) / np.multiply.outer(WIDTHS, WIDTHS)[..., None]
    return {"value": c[0, 0].tolist(), "first": first.tolist(), "second": np.moveaxis(second, -1, 0).tolist()}


def main() -> None:
    """Write the answers."""
    nodes = np.cos(np.pi * (np.arange(POINTS) + 0.5) / POINTS)
    with tempfile.TemporaryDirectory() as folder:
        program = built(folder)
        numbers = [AT * (1 + WIDTHS * pair) for pair in itertools.product(nodes, nodes)]
        found = np.array([states(program, *map(float, pair)) for pair in numbers]).reshape(POINTS, POINTS, -1, 4)
    periods = {str(n): derivatives(found[:, :, n - 1], nodes) for n in PERIODS}
    about = f"{', '.join(COLUMNS)} after some periods by tests/benchmarks/landed.py; by relative v_y and speed"
    STORED.write_text(json.dumps({"about": about, "periods": periods}, indent=1) + "\n")


if __name__ == "__main__":
    main()
