"""How accurate the waves of a `Beam` are: `pytest -m benchmark -s tests/benchmarks/test_waves.py`."""

import numpy as np
import pytest

import slipperjax as sj
from slipperjax.tools.files import table_lines

pytestmark = pytest.mark.benchmark


def rails(bed):
    """Crane rails by the wave number up to which modes are even, and by the damping of waves."""
    of = lambda even, absorbed: type("Rail", (sj.Beam,), dict(even=even, absorbed=absorbed)).crane_rail(bed=bed)
    kinds = {"evenly spaced": of(1e4, 5.0), "default": sj.Beam.crane_rail(bed=bed)}
    others = ((3.0, 4.0), (3.0, 5.0), (4.0, 5.0))
    return kinds | {f"even to {even:g}, damping {one:g}": of(even, one) for even, one in others}


def exact(rail, direction, rates, speed, place):
    """Deflection behind a load that travels [m/N], by residues."""
    stiffness, bed, damping = (float(of[direction]) for of in (rail.bending_stiffness, rail.bed, rail.damping))
    mass, found = float(rail.mass), []
    for s in rates:
        of_wave = [
            stiffness,
            0,
            -mass * speed**2,
            -1j * speed * (2 * mass * s + damping),
            mass * s**2 + damping * s + bed,
        ]
        waves = np.roots(of_wave)
        waves = waves[waves.imag < 0]
        found.append(-1j * np.sum(np.exp(1j * waves * place) / np.polyval(np.polyder(of_wave), waves)))
    return np.array(found)


def test_waves_beside_residues():
    """Errors of the deflection under and behind a load, RMS over frequencies of 50 to 2400 Hz and five speeds."""
    circular = np.geomspace(300.0, 15_000.0, 40)
    rates, rows = 0.02 * circular + 1j * circular, []
    for bed in (1e8, 1e9):
        for name, rail in rails(bed).items():
            row = {"bed [N/m^2]": f"{bed:.0e}", "modes": f"{name}, {len(rail.wave_numbers)}"}
            for place in (0.0, -0.2, -2.0):
                errors = []
                for speed in (1.0, 600.0, 1000.0, 1500.0, 2000.0):
                    found = rail.compliance(np.ones((1, 2)), np.array([place, 0.0]), speed, rates)[:, :, 0, 1]
                    for direction in range(2):
                        want = exact(rail, direction, rates, speed, place)
                        error = np.abs(found[:, direction] - want) ** 2
                        errors.append(np.mean(error) / np.mean(np.abs(want) ** 2))
                row[f"{-place:g} m behind [%]"] = f"{100 * np.sqrt(np.mean(errors)):.1f}"
            rows.append(row)
    print("\n" + "\n".join(table_lines(rows)))
