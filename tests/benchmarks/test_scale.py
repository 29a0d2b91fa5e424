"""Maps of 100 to a million cases into stores: time, memory and disk, as `slipperjax.explain` said and as they were.

    pytest -m benchmark -s tests/benchmarks/test_scale.py

Each map runs in a process of its own, with a cache of programs. Twelve minutes on two cores.
"""

import pytest

from .timing import shown, told

SCRIPT = """
import json, resource, sys, time, numpy as np, slipperjax as sj
from slipperjax.sweeps.store import store_status
sj.compile_cache(sys.argv[1])
side, store = int(sys.argv[3]), sys.argv[2]
grid = {"speed": np.linspace(1000, 2000, side), "clearance": np.linspace(0.5e-3, 2e-3, side)}
how = dict(record=["peak_force"], transient=20, periods=10, steps_per_period=50)
said = sj.explain(sj.sweep, sj.paper_scene(), grid, store=store, **how)
begin = time.perf_counter()
ds = sj.sweep(sj.paper_scene(), grid, store=store, **how)
seconds = time.perf_counter() - begin
memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
assert ds.sizes == {"speed": side, "clearance": side, **{k: v for k, v in ds.sizes.items() if k not in grid}}
print("ROW " + json.dumps({
    "cases": side * side,
    "time [s]": f"{seconds:.1f}",
    "said": f"{said.seconds:.1f}",
    "ms per case": f"{1e3 * seconds / side**2:.2f}",
    "memory [MB]": f"{memory / 1e6:.0f}",
    "disk [MB]": f"{store_status(store).bytes / 1e6:.2f}",
    "said ": f"{said.stored / 1e6:.2f}",
    "bad": int((ds["status"] != 0).sum()),
}))
"""


@pytest.mark.benchmark
def test_maps_of_growing_size(tmp_path):
    sides = (10, 32, 100, 316, 1000)
    shown(told("-c", SCRIPT, tmp_path / "cache", tmp_path / f"{side}.zarr", side) for side in sides)
