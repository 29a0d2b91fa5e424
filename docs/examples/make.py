"""Writes the tables that the pages use: surveys, a history of speeds, thrust, a section and modes.

They are made up: rails of a published sled track's spectrum with joints every 52 in, thrust of 200 m/s^2 to 900 m/s,
and coasting. Run it in this folder: `python make.py`.
"""

import numpy as np

FOOT = 0.3048
INCH = 0.0254


def waves(rng: np.random.Generator, x: np.ndarray) -> np.ndarray:
    """Return waves of 0.6 to 50 m [m] at places `x` [m], of the density A k^-2.085 [m^2 per cycle/m]."""
    k = np.arange(1, 1024) / 600.0
    k = k[(k > 1 / 50) & (k < 1 / 0.6)]
    size = np.sqrt(2 * 6.76e-10 * k**-2.085 / 600.0)
    size = size * rng.normal(size=k.size)
    phase = rng.uniform(0, 2 * np.pi, (k.size, 1))
    return size @ np.cos(2 * np.pi * k[:, None] * x + phase)


def survey() -> str:
    """Return the survey of 600 ft of rail, with a remark at each joint."""
    rng = np.random.default_rng(5)
    chainage = np.arange(0.0, 600.1, 0.25)
    x = chainage * FOOT
    # a joint dips by 8 thousandths of an inch over a foot either way
    since = (x + 0.4) % (52 * INCH)
    away = np.minimum(since, 52 * INCH - since)
    joints = -8e-3 * INCH * np.exp(-((away / 0.12) ** 2))
    rows = [
        "Sled track, rail B, survey of the alignment",
        "",
        "Chainage [ft], Lateral [in], Vertical [in], Remark",
    ]
    for at, y, z, near in zip(
        chainage, waves(rng, x) / INCH, (waves(rng, x) + joints) / INCH, away, strict=True
    ):
        rows.append(f"{at:.2f}, {y:.5f}, {z:.5f}, {'joint' if near < 0.038 else ''}")
    return "\n".join(rows) + "\n"


def both_rails() -> str:
    """Return the survey of 300 ft of two rails, each from its own line, which have most of their waves in common."""
    rng = np.random.default_rng(7)
    chainage = np.arange(0.0, 300.1, 0.5)
    lateral, vertical = (waves(rng, chainage * FOOT) / INCH for _ in range(2))
    rows = [
        "Chainage [ft], Left lateral [in], Left vertical [in], Right lateral [in], Right vertical [in]"
    ]
    own = [waves(rng, chainage * FOOT) / INCH for _ in range(4)]
    shares = zip((lateral, vertical, lateral, vertical), own, strict=True)
    columns = [0.95 * common + 0.3 * alone for common, alone in shares]
    for at, *numbers in zip(chainage, *columns, strict=True):
        rows.append(", ".join([f"{at:.1f}", *(f"{number:.5f}" for number in numbers)]))
    return "\n".join(rows) + "\n"


def history() -> str:
    """Return speeds from a standstill of half a second to 900 m/s and 1.5 s of coasting, at 100 Hz."""
    rng = np.random.default_rng(6)
    time = np.arange(0.0, 6.5 + 1e-9, 0.01)
    speed = np.clip(200.0 * (time - 0.5), 0.0, 900.0)
    coasting = time > 5.0
    # drag by the square of the speed
    speed[coasting] = 900.0 / (1 + 900.0 * 1.2e-4 * (time[coasting] - 5.0))
    speed[time < 0.5] = rng.normal(0.0, 0.03, int(np.sum(time < 0.5)))
    rows = ["time [s]; velocity [ft/s]"]
    rows += [f"{t:.2f}; {v / FOOT:.3f}" for t, v in zip(time, speed, strict=True)]
    return "\n".join(rows) + "\n"


SECTION = """point, y [mm], z [mm]
# two corners of each face, clockwise with y to the right
J, -30, 13
A, 30, 13
B, 48, 5.5
C, 48, -14.5
D, 44.5, -24.9
E, 29, -29
F, -29, -29
G, -44.5, -24.9
H, -48, -14.5
I, -48, 5.5
"""

THRUST = """time [s], thrust [lbf], moment_y [ft lbf]
# of a motor, for 1.9 s; it acts 2 in above the centre of mass
0.00, 0, 0
0.05, 15200, 2530
0.60, 16900, 2820
1.80, 14100, 2350
1.90, 0, 0
"""

MODES = """frequency [Hz], damping, left1 x, left1 y, left1 z, left2 x, left2 y, left2 z, \
right1 x, right1 y, right1 z, right2 x, right2 y, right2 z
# torsion, bending up and down, bending to the sides; modal mass 1 kg
31.2, 0.02, 0, 0.006, 0.071, 0, -0.006, -0.070, 0, 0.006, -0.071, 0, -0.006, 0.070
48.5, 0.02, 0, 0, 0.052, 0, 0, 0.053, 0, 0, 0.052, 0, 0, 0.053
77.0, 0.03, 0, 0.049, 0.004, 0, 0.050, 0.004, 0, 0.049, -0.004, 0, 0.050, -0.004
"""

if __name__ == "__main__":
    for name, text in (
        ("survey.csv", survey()),
        ("rails.csv", both_rails()),
        ("velocity.csv", history()),
        ("thrust.csv", THRUST),
        ("section.csv", SECTION),
        ("modes.csv", MODES),
    ):
        with open(name, "w") as file:
            file.write(text)
