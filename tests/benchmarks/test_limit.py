"""The limit of a step by its own instructions: what the compiled loop over steps would take at full rate.

    pytest -m benchmark -s tests/benchmarks/test_limit.py

XLA writes the machine code of the program, objdump lists it. Each loop of it counts as often as it runs, and takes as
long as the busiest part of the processor needs for its instructions. Needs objdump and g++.
"""

import os
import re
import shutil
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

pytestmark = pytest.mark.benchmark
LANES, STEPS, PERIODS, POINTS = 124, 50, 8, 20
RATES = {"all instructions": 6, "loads": 2, "stores": 1, "products": 2, "sums": 2, "divisions and roots": 1}
"""Vector instructions in a cycle, of a core such as Zen 4 and Golden Cove; a product with a sum is one."""
DIVISION, ROOT = 4.5, 8.0
"""Cycles of a division and a root of four numbers: 0.31 and 0.55 ns for one at 3.6 GHz, measured on a Zen 4."""
PROGRAM = f"""
import sys, time, jax, numpy as np, slipperjax as sj
from slipperjax.flow.period_map import PeriodMap, initial_states
from slipperjax.flow.stepping import ConstantSteps
from slipperjax.sweeps.grid import Cases
from slipperjax.tools.forms import compiler_options
solver, grid = getattr(sj.solvers, sys.argv[1])(), {{"speed": np.linspace(1200, 1300, {LANES})}}
scenes, starts = Cases(sj.paper_scene(1250.0), grid, sj.table_2_start()).take(np.arange({LANES}))
states = initial_states(scenes, starts)
one = lambda scene, state: PeriodMap(scene, ConstantSteps({STEPS}), solver).run(state, periods={PERIODS}).state
run = lambda scenes, states: scenes.map(one, states)
run = jax.jit(run, compiler_options=compiler_options()).lower(scenes, states).compile()
times = []
for _ in range(60):
    begin = time.perf_counter()
    jax.block_until_ready(run(scenes, states))
    times.append(time.perf_counter() - begin)
print(min(times), np.median(times))
"""
CYCLES = """
int main() { long x = 0; for (long i = 0; i < 50000000; i++) { %s } return (int)x; }
""" % ('__asm__ volatile("add $1, %0" : "+r"(x));' * 10)


class Instruction(NamedTuple):
    address: int
    name: str
    operands: str


def instructions(file: Path) -> list[Instruction]:
    """Those of an object file."""
    text = subprocess.run(["objdump", "-d", "--no-show-raw-insn", file], capture_output=True, text=True, check=True)
    lines = re.findall(r"^\s+([0-9a-f]+):\s+(\S+)[ \t]*(.*)$", text.stdout, re.MULTILINE)
    return [Instruction(int(at, 16), name, re.sub(r"\s*[<#].*", "", rest)) for at, name, rest in lines]


def loops(code: list[Instruction]) -> list[tuple[int, int]]:
    """First and last instruction of each loop: jumps backwards."""
    place = {one.address: k for k, one in enumerate(code)}
    jumps = ((k, re.match(r"[0-9a-f]+", one.operands)) for k, one in enumerate(code) if one.name.startswith("j"))
    found = {(place.get(int(to[0], 16), len(code)), k) for k, to in jumps if to}
    return sorted(pair for pair in found if pair[0] <= pair[1])


def passes(body: list[Instruction]) -> float:
    """How often a loop runs, from the last comparison and what is added to the number that it compares."""
    end = next((one for one in reversed(body) if one.name.startswith("cmp")), body[-2])
    limit, counter = re.match(r"\$0x([0-9a-f]+),(%\w+)", end.operands).groups()
    if end.name == "add":  # without comparison, it counts from minus the number of points to zero
        return POINTS / int(limit, 16)
    for one in body:
        step = re.match(rf"\$-?0x([0-9a-f]+),{counter}$", one.operands)
        if step and one.name.startswith(("add", "sub")):
            return int(limit, 16) / int(step[1], 16)
        if one.name.startswith("inc") and one.operands == counter:
            return int(limit, 16)
    raise AssertionError(f"a loop's counter is not understood: {end}")


def needs(one: Instruction) -> Counter:
    """What an instruction takes of each part, in its units."""
    if one.name.startswith(("nop", "data16", "cs")):
        return Counter()
    taken = Counter({"all instructions": 1})
    if "(" in one.operands and not one.name.startswith("lea"):
        taken["stores" if one.operands.endswith(")") and not one.name.startswith(("cmp", "test")) else "loads"] += 1
    if one.name.startswith(("vdiv", "vsqrt")):
        taken["divisions and roots"] += DIVISION if one.name.startswith("vdiv") else ROOT
    elif one.name.startswith(("vf", "vmul")):
        taken["products"] += 1
    elif one.name.startswith(("vadd", "vsub", "vmin", "vmax", "vcmp", "vrnd")):
        taken["sums"] += 1
    return taken


def least_cycles(code: list[Instruction]) -> tuple[float, Counter]:
    """Cycles of a pass of the loop over steps for one case, and those of each part if there were no other."""
    found = loops(code)
    inside = lambda a, b: b[0] <= a[0] and a[1] <= b[1] and a != b
    # of the loops over periods and steps, the inner one
    steps = max(
        (a for a in found if any(inside(b, a) for b in found)),
        key=lambda a: (len(around(found, a)) == 1, a[1] - a[0]),
    )
    cycles, parts = 0.0, Counter()
    for loop in [steps, *(a for a in found if inside(a, steps))]:
        own = [k for k in range(loop[0], loop[1] + 1) if not any(b[0] <= k <= b[1] for b in found if inside(b, loop))]
        taken = sum((needs(code[k]) for k in own), Counter())
        nest = [a for a in (loop, *around(found, loop)) if inside(a, steps)]
        often = np.prod([passes(code[a[0] : a[1] + 1]) for a in nest]) / LANES
        taken = Counter({part: often * number / RATES[part] for part, number in taken.items()})
        cycles, parts = cycles + max(taken.values()), parts + taken
    return cycles, parts


def around(found: list[tuple[int, int]], loop: tuple[int, int]) -> list[tuple[int, int]]:
    return [a for a in found if a[0] <= loop[0] and loop[1] <= a[1] and a != loop]


@pytest.fixture(scope="module")
def gigahertz(tmp_path_factory) -> float:
    """Cycles of a core in a nanosecond, from additions that wait for each other."""
    folder = tmp_path_factory.mktemp("cycles")
    (folder / "cycles.c").write_text(CYCLES)
    subprocess.run(["g++", "-O1", folder / "cycles.c", "-o", folder / "cycles"], check=True)
    times = []
    for _ in range(9):
        begin = time.perf_counter()
        subprocess.run([folder / "cycles"])
        times.append(time.perf_counter() - begin)
    return 0.5 / min(times)


@pytest.mark.skipif(not (shutil.which("objdump") and shutil.which("g++")), reason="objdump and g++ are needed")
@pytest.mark.parametrize("solver", ["RK4", "ImpulseRK4"])
def test_the_share_of_the_limit(solver, gigahertz, tmp_path):
    flags = f"--xla_dump_to={tmp_path}"
    words = [sys.executable, "-c", PROGRAM, solver]
    if hasattr(os, "sched_setaffinity"):
        words = ["taskset", "-c", "0", *words]
    done = subprocess.run(words, env=os.environ | {"XLA_FLAGS": flags}, capture_output=True, text=True, check=True)
    best, median = (float(x) / (LANES * STEPS * PERIODS) * 1e9 for x in done.stdout.split())
    kernel = max(tmp_path.glob("*.o"), key=lambda file: file.stat().st_size)
    cycles, parts = least_cycles(instructions(kernel))
    print(
        f"\n{solver}: {best:.0f} ns per step and case (median {median:.0f}), {best * gigahertz:.0f} cycles of "
        f"{gigahertz:.2f} GHz; its instructions at full rate {cycles:.0f}: {cycles / best / gigahertz:.0%}"
    )
    print("alone:", ", ".join(f"{part} {number:.0f}" for part, number in parts.most_common()))
    assert cycles < 1.02 * best * gigahertz  # or the count would be wrong
