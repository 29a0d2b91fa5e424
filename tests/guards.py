"""Numbers that a change of the package's structure must not move.

    python tests/guards.py write [PART ...]    # computes the numbers of all parts, or some, and writes the table
    python tests/guards.py check [PART ...]    # computes them again and compares, in some four minutes

`check` prints one line per quantity: "equal bits", or the largest difference of a variable relative to its largest
magnitude, and the tolerance. The exit code is 1 where a tolerance is exceeded. Texts and whole numbers must be equal.
Chaotic motions and digests of programs are only reported.

Bits are comparable between runs on one processor with one version of JAX.
"""

import argparse
import dataclasses
import hashlib
import json
import re
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import diffrax
import jax
import numpy as np

import slipperjax as sj

TABLE = Path(__file__).parent / "data" / "guards.json"
# Tolerances: of texts; of one forcing period; of regular motions over tens of them; of what iterations find. A last
# bit of clearance and stiffness changes periods by 1e-13 (3e-13 in derivatives), runs by 1e-13, the last by 3e-12.
EQUAL, PERIOD, RUN, SOLVED, REPORTED = 0.0, 1e-12, 1e-11, 1e-8, np.inf
SCENE, STEPS = sj.paper_scene(), 100
SPEEDS, CHAOTIC = [1100.0, 1250.0, 1400.0, 1500.0, 1800.0], 2100.0  # the first five settle to period 1
SWEEP: dict[str, Any] = dict(transient=20, periods=4, steps_per_period=STEPS)
SETTLED: dict[str, Any] = dict(transient=200, steps_per_period=STEPS // 2)

Quantities = Iterator[tuple[str, float, dict[str, Any]]]
"""Names and tolerances with values by variable."""


def numbers(state: sj.State) -> dict[str, Any]:
    """The numbers of a state by name."""
    motion = {name: value for name, value in vars(state.motion).items() if value is not None}
    return motion | ({} if state.memory is None else {"memory": state.memory})


def spectrum(multipliers: Any) -> np.ndarray:
    """Multipliers as real and imaginary parts, in an order that rounding does not change."""
    ordered = np.sort_complex(np.asarray(multipliers))
    return np.stack([ordered.real, ordered.imag], axis=-1)


def variables(ds: Any) -> dict[str, Any]:
    """The variables of a dataset, without residuals, which are rounding errors."""
    found = {name: v.values for name, v in ds.data_vars.items() if name != "residual"}
    if "multiplier_real" in found:
        found["multiplier"] = spectrum(found.pop("multiplier_real") + 1j * found.pop("multiplier_imag"))
    return found


def layout(name: str, ds: Any) -> Quantities:
    """Dimensions, unit and kind of number of each variable and coordinate of a dataset."""
    text = lambda v: f"({', '.join(map(str, v.dims))}) [{v.attrs.get('units', '')}] {v.dtype.kind}"
    yield f"layout of {name}", EQUAL, {key: text(v) for key, v in ds.variables.items()}


def labelled(name: str, tolerance: float, ds: Any) -> Quantities:
    """A dataset's variables and layout."""
    yield name, tolerance, variables(ds)
    yield from layout(name, ds)


def after_period(clearance: Any, restitution: Any, solver: Any = None) -> dict[str, Any]:
    """The state one period after Table 2's start."""
    scene = SCENE.replace(clearance=clearance, restitution=restitution)
    return strobed(scene, solver)


def strobed(scene: sj.Scene, solver: Any = None) -> dict[str, Any]:
    """The state of a scene one period after Table 2's start."""
    start = sj.initial_state(scene, sj.table_2_start())
    return numbers(sj.period_map(scene, start, steps_per_period=STEPS, solver=solver))


def programs() -> Quantities:
    """Digests of lowered programs: the first part, as the sweep's is seen only while it is made."""
    functions: dict[str, Any] = {
        "period_map": after_period,
        "period_map, Rodas4": lambda clearance, restitution: after_period(
            clearance, restitution, sj.solvers.Rodas4()
        ),
        "period_map, jacfwd": jax.jacfwd(after_period, (0, 1)),
    }
    texts = {name: jax.jit(function).lower(1e-3, 0.9).as_text() for name, function in functions.items()}
    with tempfile.TemporaryDirectory() as folder:
        jax.config.update("jax_include_debug_info_in_dumps", False)
        jax.config.update("jax_dump_ir_to", folder)
        sj.sweep(SCENE, {"speed": SPEEDS}, **SWEEP)
        jax.config.update("jax_dump_ir_to", "")
        texts["sweep, its largest"] = max((file.read_text() for file in Path(folder).iterdir()), key=len)
    for name, text in texts.items():
        yield f"program of {name}", REPORTED, {"digest": digest(text)}


def digest(program: str) -> str:
    """A digest of StableHLO text in which names of functions do not count."""
    names: dict[str, str] = {}
    plain = re.sub(r"@[\w.]+", lambda found: names.setdefault(found[0], f"@{len(names)}"), program)
    return hashlib.sha256(plain.encode()).hexdigest()[:12]


def strobe() -> Quantities:
    """States after one period, over scenes and solvers."""
    law = lambda contact: dataclasses.replace(SCENE, contact=contact)
    switched = dataclasses.replace(SCENE, memory=sj.model.SmoothSwitch())
    scenes = {
        "paper": SCENE,
        "low restitution": SCENE.replace(restitution=0.3),
        "two wavelengths": sj.paper_scene(wavelengths=(8.0, 3.2)),
        "short, 0.8 mm": SCENE.replace(length=0.1, clearance=0.8e-3),
        "gravity": SCENE.replace(gravity=9.81),
        "HuntCrossley": law(sj.model.HuntCrossley(1e8, 0.9)),
        "LankaraniNikravesh": law(sj.model.LankaraniNikravesh(1e8, 0.9)),
        "ConstantDamping": law(sj.model.ConstantDamping(1e8, 0.2)),
        "SmoothSwitch": switched,
    }
    for name, scene in scenes.items():
        yield f"strobe, {name}", PERIOD, strobed(scene)
    for solver in (sj.solvers.Tsit5(), sj.solvers.Rodas4(), sj.solvers.TwoStep(), diffrax.Kvaerno5()):
        yield f"strobe, {type(solver).__name__}", PERIOD, strobed(SCENE, solver)
    yield "strobe, SmoothSwitch, Rodas4", PERIOD, strobed(switched, sj.solvers.Rodas4())


def derivatives() -> Quantities:
    """Derivatives of the state after one period, in both modes."""
    names, at = ("clearance", "restitution"), (1e-3, 0.9)
    forward = jax.jit(jax.jacfwd(after_period, (0, 1)))(*at)
    for k, name in enumerate(names):
        yield f"jacfwd by {name}", PERIOD, {variable: slopes[k] for variable, slopes in forward.items()}
    spin = lambda *values: after_period(*values)["w_x"]
    yield "grad of w_x", PERIOD, dict(zip(names, jax.jit(jax.grad(spin, (0, 1)))(*at), strict=True))


def runs() -> Quantities:
    """A trajectory, and sweeps with all kinds of records."""
    trajectory = sj.simulate(SCENE, 3, steps_per_period=STEPS, saves_per_period=5)
    yield from labelled("simulate", RUN, trajectory.ds)
    history = dict(record="history", periods=2, saves_per_period=4)
    of_periods = ["motion", "peak_force", "rms", "extremes", "impulse"]
    sweep = lambda count, **options: sj.sweep(SCENE, {"speed": SPEEDS[:count]}, **SWEEP | options)
    yield from labelled("sweep, sections", RUN, sweep(5))
    yield from labelled("sweep, strobe", RUN, sweep(5, record="strobe"))
    yield from labelled("sweep, history", RUN, sweep(2, **history))
    yield from labelled("sweep, numbers", RUN, sweep(5, record=of_periods, transient=200, periods=16))
    yield from labelled("follow", RUN, sj.follow(SCENE, {"speed": SPEEDS[:3]}, **SWEEP | dict(periods=2)))


def exponents() -> Quantities:
    """Lyapunov exponents of regular and chaotic motions."""
    for name, speed, tolerance in (("regular", 1250.0, SOLVED), ("chaotic", CHAOTIC, REPORTED)):
        found = sj.lyapunov_spectrum(SCENE.replace(speed=speed), 2, **SWEEP | dict(periods=20))
        values = dict(per_period=found.per_period, stderr=found.stderr, status=found.status)
        yield f"spectrum, {name}", tolerance, values
    ds = sj.lyapunov_sweep(SCENE, {"speed": [*SPEEDS[:3], CHAOTIC]}, periods=40, **SETTLED)
    yield "lyapunov_sweep, regular", SOLVED, variables(ds.isel(speed=slice(3)))
    yield "lyapunov_sweep, chaotic", REPORTED, variables(ds.isel(speed=3))
    yield from layout("lyapunov_sweep", ds)


def orbits() -> Quantities:
    """Periodic orbits, and a branch of them with a flip and a grazing."""
    for speed, period in ((1250.0, 1), (1080.0, 2)):
        orbit = sj.periodic_orbit(SCENE.replace(speed=speed), period, transient=200, steps_per_period=STEPS)
        values = numbers(orbit.state) | dict(multipliers=spectrum(orbit.multipliers), exponent=orbit.exponent)
        values |= {name: getattr(orbit, name) for name in ("status", "period", "iterations", "stable")}
        yield f"orbit, period {period}", SOLVED, values | dict(signature=" ".join(orbit.signature.points))
    yield from labelled("orbit_sweep", SOLVED, sj.orbit_sweep(SCENE, {"speed": SPEEDS[:3]}, steps_per_period=STEPS))
    branch = sj.continue_orbit(SCENE.replace(speed=1105.0), "speed", (1070.0, 1110.0), steps_per_period=STEPS)
    events = {name: [getattr(event, name) for event in branch.events] for name in ("label", "value", "note")}
    yield "branch, events", SOLVED, events
    along = ("speed", "state", "stable", "signature")
    yield "branch, points", SOLVED, {name: branch.ds[name].values for name in along}
    yield from layout("branch", branch.ds)


def design() -> Quantities:
    """A search for a design, and sensitivities."""
    box, over = {"clearance": (0.7e-3, 1.5e-3), "length": (0.18, 0.3)}, {"speed": [1250.0, 1500.0]}
    best = sj.optimise_design(SCENE, "peak_force", box, over=over, starts=1, max_trials=6, **SETTLED)
    outcome = best.design | dict(objective=best.objective, status=best.status, regime=best.regime)
    yield "design", SOLVED, outcome | dict(tried=best.history["design"].values)
    yield from layout("design", best.ds)
    ds = sj.design.sensitivities(SCENE, ["peak_force", "excursion_pitch"], method="orbit", **SETTLED)
    yield from labelled("sensitivities", SOLVED, ds)


PARTS = {part.__name__: part for part in (programs, strobe, derivatives, runs, exponents, orbits, design)}


def computed(part: str) -> Quantities:
    """The quantities of a part as the table has them."""
    for name, tolerance, values in PARTS[part]():
        yield name, tolerance, {key: np.asarray(value).tolist() for key, value in values.items()}


def write(parts: list[str]) -> bool:
    """Computes some parts and writes them to the table, one line per quantity."""
    table = json.loads(TABLE.read_text()) if TABLE.exists() else {}
    table |= {part: {name: values for name, _, values in computed(part)} for part in parts}
    rows = lambda part: ",\n".join(f"{json.dumps(name)}: {json.dumps(v)}" for name, v in table[part].items())
    TABLE.write_text("{\n" + ",\n".join(f'"{part}": {{\n{rows(part)}\n}}' for part in table) + "\n}\n")
    return True


def check(parts: list[str]) -> bool:
    """Computes some parts again and prints how they compare with the table; whether all is within its tolerance."""
    table, good = json.loads(TABLE.read_text()), True
    for part in parts:
        left = table[part]
        try:
            for name, tolerance, values in computed(part):
                worst, words = compared(values, left.pop(name, {}))
                good &= worst <= tolerance
                limit = {EQUAL: "must be equal", REPORTED: "only reported"}.get(tolerance, f"{tolerance:.0e}")
                print(f"{name:30} {words:36} {limit} {'' if worst <= tolerance else 'EXCEEDED'}", flush=True)
        except Exception as error:  # the other parts are worth knowing, too
            print(f"{part:30} {type(error).__name__}: {error}")
            good = False
        if left:
            print(f"{part:30} not computed: {', '.join(left)}")
            good = False
    return good


def compared(new: dict[str, Any], old: dict[str, Any]) -> tuple[float, str]:
    """The largest difference of a variable, in numbers and in words."""
    found = {key: difference(new.get(key), old.get(key)) for key in old | new}
    worst = max(found.values())
    if not worst:
        return worst, "equal bits"
    where = ", ".join(key for key, value in found.items() if value == worst)
    return worst, f"differs: {where}" if np.isinf(worst) else f"{worst:.1e} in {where}"


def difference(new: Any, old: Any) -> float:
    """The largest difference over the largest magnitude; infinite where other things than finite numbers differ."""
    new, old = np.asarray(new), np.asarray(old)
    if new.shape != old.shape or {new.dtype.kind, old.dtype.kind} != {"f"}:
        return 0.0 if new.dtype.kind == old.dtype.kind and np.array_equal(new, old) else np.inf
    finite = np.isfinite(old) & np.isfinite(new)
    if not np.array_equal(new[~finite], old[~finite], equal_nan=True):
        return np.inf
    largest = np.max(np.abs(new - old)[finite], initial=0.0)
    return float(largest / np.max(np.abs(old[finite]), initial=np.finfo(float).tiny))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=("write", "check"))
    parser.add_argument("part", nargs="*", choices=[*PARTS, []], help=f"default all: {', '.join(PARTS)}")
    asked, begun = parser.parse_args(), time.perf_counter()
    good = {"write": write, "check": check}[asked.action]([part for part in PARTS if part in (asked.part or PARTS)])
    print(f"{time.perf_counter() - begun:.0f} s, {time.process_time():.0f} s of processor time")
    sys.exit(not good)
