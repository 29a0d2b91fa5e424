"""`python -m tests.bench`: error against cost of every solver; with `throughput` rates over the batch instead."""

import argparse
from collections.abc import Sequence
from pathlib import Path

import matplotlib

from .measure import bench
from .rates import rows, throughput
from .work_precision import write


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench", description=__doc__)
    parser.add_argument("what", nargs="?", choices=["solvers", "throughput"], default="solvers")
    parser.add_argument("--quick", action="store_true", help="two scenes, four methods and one batch only")
    parser.add_argument("--scene", action="append", default=[], help="of solvers: name; repeat for several")
    parser.add_argument("--method", action="append", default=[], help="of solvers: name; repeat for several")
    parser.add_argument("--engine", action="append", default=[], help="of throughput: RK4, Rodas4 or Lyapunov")
    parser.add_argument("--batch", action="append", type=int, default=[], help="trajectories at once")
    parser.add_argument("--repeats", type=int, help="times that each point is timed")
    parser.add_argument("--out", type=Path, default=Path("bench"), help="OUT.md, and of solvers OUT.png")
    asked = parser.parse_args(arguments)
    if asked.what == "throughput":
        _throughput(asked)
    else:
        _solvers(asked)


def _solvers(asked: argparse.Namespace) -> None:
    matplotlib.use("Agg")
    how = dict(quick=asked.quick, repeats=asked.repeats, cases=asked.scene, methods=asked.method, batches=asked.batch)
    points = []
    # written after each scene
    for found in bench(**how):
        points += found
        for point in found:
            times = ", ".join(f"{best:.3g} us at {lanes}" for lanes, (best, _) in point.cost.items())
            print(f"{point.case}: {point.method}, {point.setting}: error {point.error:.1e}, {times}", flush=True)
        print("wrote", *write(points, asked.out))


def _throughput(asked: argparse.Namespace) -> None:
    # without them the functions have their own
    given = {name: values for name, values in (("batches", asked.batch), ("engines", asked.engine)) if values}
    rates = []
    for rate in throughput(**given):
        rates.append(rate)
        print(rows([rate])[-1], flush=True)
    asked.out.with_suffix(".md").write_text("\n".join(rows(rates)) + "\n")


if __name__ == "__main__":
    main()
