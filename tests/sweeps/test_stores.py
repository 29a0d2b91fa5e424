"""Stores: the same bytes however a sweep was cut short, and clear words where they cannot be written."""

import contextlib
import errno
import itertools
import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import time
import warnings
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import equinox as eqx
import filelock
import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.flow.status import ASKED
from slipperjax.sweeps.store import Store, StoreInUse, WorkerLost, check_store, store_status

from . import made_up
from .made_up import a_grid, call, files

ROOT = Path(__file__).parents[2]
SCENE = sj.paper_scene()
module = sys.modules["slipperjax.sweeps.store"]
# of processes in which shapes and types of stores are checked
CHECKED = os.pathsep.join([str(ROOT / "tests" / "checked"), str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The bytes of a store that nothing disturbed."""
    path = tmp_path_factory.mktemp("whole") / "map.zarr"
    call(path)
    return files(path)


@pytest.fixture
def stored(tmp_path, whole):
    """The path of such a store."""
    for name, content in whole.items():
        (tmp_path / "map.zarr" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "map.zarr" / name).write_bytes(content)
    return tmp_path / "map.zarr"


def mark(stored, number=4):
    """The mark of a tile, without which it is computed again."""
    return stored / "status" / "marks" / str(number)


def wait_for_tiles(path, count=3):
    while not path.exists() or store_status(path).tiles_done < count:
        time.sleep(0.01)


def not_run(ds):
    return int((ds["status"] == sj.Status.NOT_RUN).sum())


def test_a_store_has_what_the_sweep_gives(tmp_path):
    found, plain = call(tmp_path / "map.zarr"), made_up.made_up(SCENE, a_grid())
    assert found.attrs == plain.attrs
    assert set(found.coords) == set(plain.coords)
    for name, variable in plain.variables.items():
        # a store has room for more crossings
        values = found[name].values[..., : variable.shape[-1]]
        np.testing.assert_array_equal(values, variable.values)
        assert found[name].attrs == variable.attrs, name
    assert np.isnan(found["v_z"].values[..., plain["v_z"].shape[-1] :]).all()
    one = sj.load(tmp_path / "map.zarr").sel(speed=1000.0, clearance=0.5e-3).scene
    assert eqx.tree_equal(one, sj.paper_scene(1000.0, 0.5e-3))
    # lists side by side
    lists = {"speed": np.linspace(500, 600, 23), "clearance": np.linspace(2e-3, 1e-3, 23)}
    how = dict(product=False, steps_per_period=50 * (1 + np.arange(23) % 8))
    ds = made_up.made_up(SCENE, lists, store=Store(tmp_path / "list.zarr", tile=7), **how)
    for name, values in made_up.made_up(SCENE, lists, **how).variables.items():
        if name != "v_z":
            np.testing.assert_array_equal(ds[name], values)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("function", "how"),
    [
        (sj.sweep, dict(transient=20, periods=20, record=["motion", "peak_force", "rms", "sections", "exponent"])),
        (sj.sweep, dict(transient=20, periods=2, record="history", saves_per_period=10)),
        (sj.lyapunov_sweep, dict(transient=40, periods=100, count=2)),
        (sj.orbit_sweep, dict(transient=40)),
    ],
)
def test_stores_of_processes_have_what_functions_give(tmp_path, function, how):
    grid = {"speed": np.linspace(1000, 1600, 4), "clearance": np.linspace(5e-4, 15e-4, 3)}
    how = how | dict(steps_per_period=50)
    with sj.sweeps.processes(2) as pool:
        ds = function(SCENE, grid, store=Store(tmp_path / "map.zarr", tile=4), chunk=8, executor=pool, **how)
    plain = function(SCENE, grid, **how)
    assert set(ds.variables) == set(plain.variables)
    for name in plain.variables:
        np.testing.assert_array_equal(ds[name].values, plain[name].values, err_msg=name)


@pytest.mark.full
def test_two_processes_cannot_write_to_one_store_and_a_killed_one_is_gone_on_with(tmp_path, whole):
    path = tmp_path / "map.zarr"
    options = dict(cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    options["env"] = os.environ | {"PAUSE": "0.2", "PYTHONPATH": CHECKED}
    with subprocess.Popen([sys.executable, "-m", "tests.sweeps.made_up", str(path)], **options) as one:
        assert one.stdout.readline() == "ready\n", one.stderr.read()
        wait_for_tiles(path)
        with pytest.raises(StoreInUse, match=r"Another process writes to map\.zarr"):
            call(path)
        assert xr.open_zarr(path, consolidated=False, chunks=None).sizes["speed"] == 12  # but read it
        one.kill()
        assert one.wait() != 0
    assert 3 <= store_status(path).tiles_done < 12
    call(path)  # a lock ends with its process
    assert files(path) == whole
    assert not list(tmp_path.glob("*.lock"))


def test_ctrl_c_leaves_a_store_that_can_be_read(tmp_path, whole, monkeypatch):
    path = tmp_path / "map.zarr"
    monkeypatch.setenv("PAUSE", "0.05")

    def stop():
        wait_for_tiles(path)
        ASKED.set()

    try:
        with ThreadPoolExecutor(1) as pool:
            pool.submit(stop)
            with pytest.raises(sj.Interrupted) as caught:
                call(path, workers=1)
    finally:
        ASKED.clear()
    ds, finished = caught.value.result, caught.value.finished
    assert caught.value.of == 120
    assert 30 <= finished < 120
    assert not_run(ds) == 120 - finished
    assert np.isnan(ds["v_z"].where(ds["status"] == sj.Status.NOT_RUN)).all()
    call(path)
    assert files(path) == whole


def test_another_call_is_refused_with_the_difference(tmp_path, stored, whole):
    grid = a_grid()

    def asked(fresh=False, scene=SCENE, grid=grid, **change):
        made_up.made_up(scene, grid, store=Store(stored, tile=10, fresh=fresh), **change)

    for change, words in (
        (dict(periods=4), "call.periods: 3 in the store, 4 asked"),
        (dict(scene=sj.paper_scene(restitution=0.8)), "restitution: 0.9 in the store, 0.8 asked"),
        (dict(grid=grid | {"speed": grid["speed"] + 1}), "grid.speed.first: 1000.0 in the store, 1001.0 asked"),
    ):
        with pytest.raises(ValueError, match=f"(?s)was made by another one.*{words}"):
            asked(**change)
    # a wrong argument deletes nothing
    with pytest.raises(ValueError, match="grid"):
        asked(fresh=True, grid={})
    with pytest.raises(TypeError):
        asked(fresh=True, periods="many")
    assert files(stored) == whole
    call(stored, fresh=True)
    assert files(stored) == whole
    assert [file.name for file in tmp_path.iterdir()] == ["map.zarr"]


@pytest.mark.parametrize("spoil", [lambda content: content[:-7], lambda content: content[:-1] + b"?"])
def test_a_damaged_tile_is_found_and_computed_again_and_no_other(stored, whole, spoil, monkeypatch):
    assert check_store(stored) == []
    broken = stored / "status" / "c" / "3" / "0"
    broken.write_bytes(spoil(broken.read_bytes()))
    (stored / "good" / "c" / "5" / "0").unlink()
    assert store_status(stored).tiles_done == 11  # what is missing is seen without reading
    assert check_store(stored) == [3]
    assert store_status(stored).tiles_done == 10
    asked, compute = [], made_up.MadeUp.compute
    monkeypatch.setattr(made_up.MadeUp, "compute", lambda *given, **how: asked.append(1) or compute(*given, **how))
    call(stored)
    assert files(stored) == whole
    assert len(asked) == 2


def test_a_tile_of_another_store_or_place_is_none_of_this_one(stored, whole, tmp_path):
    other = tmp_path / "other.zarr"
    made_up.made_up(sj.paper_scene(restitution=0.8), a_grid(), store=Store(other, tile=10))
    for file in [*other.glob("*/c/3/**/*"), mark(other, 3)]:
        if file.is_file() and file.relative_to(other).parts[0] not in ("speed", "clearance", "point"):
            (stored / file.relative_to(other)).write_bytes(file.read_bytes())
    mark(stored, 5).write_bytes(mark(stored, 6).read_bytes())
    mark(stored, 7).write_bytes(b"")
    assert store_status(stored).tiles_done == 9
    call(stored)
    assert files(stored) == whole


@pytest.mark.parametrize("content", [b"", b"[" * 100_000, b'{"attributes": 3}', dict(tile="large"), dict(more=1)])
def test_what_has_another_mark_or_none_is_no_store_of_ours(stored, content):
    file = stored / "zarr.json"
    if isinstance(content, dict):
        group = json.loads(file.read_text())
        group["attributes"][module.MARK] = json.dumps(json.loads(group["attributes"][module.MARK]) | content)
        content = json.dumps(group).encode()
    file.write_bytes(content)
    before = files(stored)
    for function in (sj.load, store_status, check_store, call, lambda path: call(path, fresh=True)):
        with pytest.raises(ValueError, match="must be a store of slipperjax, but is none"):
            function(stored)
    assert files(stored) == before


def test_other_versions_go_on_with_a_warning_and_are_marked_by_tile(stored, monkeypatch):
    mark(stored).unlink()
    now = module.versions()
    monkeypatch.setattr(module, "versions", lambda: now | {"numpy": "1.2.3"})
    with pytest.warns(sj.ImplausibleWarning, match=f"begun with numpy {now['numpy']} and not 1.2.3"):
        call(stored)
    assert ["1.2.3" in mark(stored, k).read_text() for k in (3, 4)] == [False, True]
    call(stored)  # of a complete one nothing is said


def test_workers_with_other_code_write_nothing(stored, monkeypatch):
    mark(stored).unlink()
    before = files(stored)
    imported, of_caller = module.IMPORTED, module._fingerprint

    def fingerprint(*given):
        with monkeypatch.context() as caller:
            caller.setattr(module, "IMPORTED", imported)
            return of_caller(*given)

    monkeypatch.setattr(module, "_fingerprint", fingerprint)
    monkeypatch.setattr(module, "IMPORTED", "of a worker")
    with pytest.raises(RuntimeError, match="a worker imported other code"):
        call(stored)
    assert files(stored) == before


def test_only_stores_of_ours_are_replaced(tmp_path, stored, whole):
    other = tmp_path / "other.zarr"
    made_up.made_up(SCENE, a_grid()).to_zarr(other, zarr_format=2, consolidated=False)
    before = files(other)
    with pytest.raises(ValueError, match="must be a store of slipperjax, but is none"):
        call(other, fresh=True)
    assert files(other) == before
    for name in ("thesis.tex", "v_z/c/3/0/0.tex", "thesis.partial", ".git/config"):
        file = stored / name
        file.parent.mkdir(exist_ok=True)
        file.write_text("years of work")
        with pytest.raises(ValueError, match=f"must have no other files .* but has .*{name}"):
            call(stored, fresh=True)
        assert file.read_text() == "years of work"
        file.unlink()
    (stored / ".git").rmdir()
    (stored / "v_z" / "c" / "3" / "0" / "0.1.partial").write_text("of a process that was killed")
    mark(stored).unlink()
    call(stored)
    assert files(stored) == whole


def test_an_old_worker_does_not_write_into_a_new_store(stored, whole):
    old = module._open_archive(stored)
    ds = made_up.made_up(SCENE, a_grid()).isel(speed=slice(2, 3))
    old.write(2, ds)
    assert files(stored) == whole
    call(stored, fresh=True, periods=4)
    before = files(stored)
    with pytest.raises(ValueError, match="must be of the same call"):
        old.write(2, ds)
    assert files(stored) == before


@pytest.mark.parametrize("name", ["v_z", "speed"])
def test_a_copy_that_was_not_finished_is_no_store_of_fewer_variables(stored, name):
    shutil.rmtree(stored / name)
    for ask in (call, sj.load, check_store):
        with pytest.raises(ValueError, match=f"must be whole, but is without {name}: start over"):
            ask(stored)


def test_a_link_leads_to_the_same_lock(tmp_path, stored):
    mark(stored).unlink()
    link = tmp_path / "link.zarr"
    link.symlink_to(stored)
    with module._writing(Store(link)), pytest.raises(StoreInUse):
        call(stored)


LAW = """
from slipperjax.model.contact import HertzSpring
{helper}
class OwnLaw(HertzSpring):
    def damping(self, rate, rate_ratio):
        return {body}
"""


def test_a_store_refuses_other_code_of_a_law(tmp_path, monkeypatch):
    def asked(body, helper=""):
        known = {"__name__": "of_a_user"}
        exec(LAW.format(body=body, helper=helper), known)
        scene = eqx.tree_at(lambda scene: scene.contact, SCENE, known["OwnLaw"](1e9))
        made_up.made_up(scene, a_grid(), store=Store(tmp_path / "map.zarr", tile=10))

    first = "factor(rate)", "factor = lambda rate: 2.0 * rate"
    asked(*first)
    asked(*first)  # defined anew, and the same
    for other in (("3.0 * rate",), (first[0], "factor = lambda rate: 3.0 * rate")):
        with pytest.raises(ValueError, match=r"OwnLaw: [0-9a-f]{12} in the store, [0-9a-f]{12} asked"):
            asked(*other)
    monkeypatch.setattr(module, "IMPORTED", "edited")
    with pytest.raises(ValueError, match=r"code\.slipperjax: [0-9a-f]{12} in the store, edited asked"):
        asked(*first)


@pytest.mark.full
def test_workers_end_with_the_process_that_made_them(tmp_path):
    file = tmp_path / "script.py"
    file.write_text("""
import os, slipperjax as sj
if __name__ == '__main__':
    print(sj.sweeps.processes(1).submit(os.getpid).result(), flush=True)
    input()
""")
    options = dict(stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=os.environ | {"PYTHONPATH": CHECKED})
    with subprocess.Popen([sys.executable, str(file)], **options) as one:
        worker = int(one.stdout.readline())
        os.kill(worker, 0)
        one.kill()
    until = time.monotonic() + 10.0
    with contextlib.suppress(ProcessLookupError):
        while time.monotonic() < until:
            os.kill(worker, 0)
            time.sleep(0.05)
    assert time.monotonic() < until


def test_progress_begins_with_the_first_case(tmp_path, capsys, monkeypatch):
    """It makes the store, and compiles for minutes before there is one."""
    monkeypatch.setattr(module, "DELAY", 0.0)
    call(tmp_path / "map.zarr", progress=True)
    lines = [line for line in capsys.readouterr().err.splitlines() if line]
    assert lines[0].startswith("first case:   0%")
    assert any(line.startswith("first case: 100%") and line.endswith("1 of 1 cases") for line in lines)
    assert lines[-1].endswith("120 of 120 cases")


def test_a_full_disk_is_named_and_nothing_is_lost(tmp_path, whole, monkeypatch):
    from zarr.storage import LocalStore

    path, usual, count = tmp_path / "map.zarr", LocalStore.set, itertools.count(1)

    async def fails(self, key, value):
        if next(count) > 60:
            raise OSError(28, "No space left on device")
        await usual(self, key, value)

    monkeypatch.setattr(LocalStore, "set", fails)
    with pytest.raises(OSError, match=r"cannot write to .*No space left on device; .* of 120 cases are stored"):
        call(path, workers=1)
    monkeypatch.undo()
    assert 0 < store_status(path).cases_done < 120
    call(path)
    assert files(path) == whole


def test_what_does_not_fit_is_said_before_it_is_begun(tmp_path, monkeypatch):
    limits = sys.modules["slipperjax.tools.limits"]
    monkeypatch.setattr(limits, "available_memory", lambda: 1000)
    with pytest.raises(ValueError, match=r"120 cases need about .* but 1 kB of memory are available"):
        call(tmp_path / "map.zarr", workers=2)
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setattr(limits, "available_memory", lambda: None)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=1000))
    with pytest.warns(sj.ImplausibleWarning, match="The store needs about .* and its disk has 1 kB"):
        call(tmp_path / "map.zarr")


def test_where_nothing_can_be_written_a_complete_store_is_read(stored, monkeypatch):
    def refused(*given, **how):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(filelock.FileLock, "acquire", refused)
    assert not_run(call(stored)) == 0
    mark(stored).unlink()
    with pytest.raises(PermissionError, match="protected against writing"):
        call(stored)


@pytest.mark.parametrize("fresh", [False, True])
def test_a_protected_store_is_named_before_anything_is_computed_or_replaced(stored, fresh, monkeypatch):
    mark(stored).unlink()
    before = files(stored)
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != stored)  # as for all but root
    monkeypatch.setattr(module, "gather", None)
    with pytest.raises(PermissionError, match=r"map\.zarr is protected against writing"):
        call(stored, fresh=fresh)
    assert files(stored) == before


@pytest.mark.full
def test_processes_compute_tiles_and_shares_and_a_killed_one_is_named(tmp_path, whole, monkeypatch):
    die, path, shared, dies = (tmp_path / name for name in ("die", "map.zarr", "shared.zarr", "dies.zarr"))
    monkeypatch.setenv("DIES", str(die))
    monkeypatch.setenv("PYTHONPATH", CHECKED)
    with sj.sweeps.processes(2) as pool:
        assert not_run(call(path, executor=pool)) == 0
        assert files(path) == whole
        other = pool.submit(made_up.first_half, shared)
        call(shared, share=(2, 2))
        other.result()
        assert files(shared) == whole
        calls = itertools.count(1)

        def submit(*work):
            if next(calls) == 3:  # the third worker is asked to die
                die.touch()
            return pool.submit(*work)

        with pytest.raises(WorkerLost, match=r"[0-9]+ cases or more are stored"):
            call(dies, executor=SimpleNamespace(submit=submit))
    assert store_status(dies).tiles_done < 12
    call(dies)
    assert files(dies) == whole


@contextlib.contextmanager
def dask(processes):
    """A client of two workers of one thread each, in this process or in spawned ones."""
    distributed = pytest.importorskip("distributed")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of dask's own making: ports in use, unclosed sockets
        options = dict(n_workers=2, threads_per_worker=1, processes=processes, dashboard_address=None)
        with distributed.LocalCluster(**options) as cluster, distributed.Client(cluster) as client:
            yield client


def test_workers_of_dask_compute_tiles(tmp_path, whole):
    with dask(processes=False) as client:
        assert not_run(call(tmp_path / "map.zarr", executor=client)) == 0
    assert files(tmp_path / "map.zarr") == whole


@pytest.mark.slow
def test_a_worker_of_dask_that_is_killed_midway_changes_no_byte(tmp_path, whole, monkeypatch):
    path = tmp_path / "map.zarr"
    monkeypatch.setenv("PAUSE", "0.1")  # of each tile, in the workers

    def kill(client):
        wait_for_tiles(path)
        os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)

    with dask(processes=True) as client, ThreadPoolExecutor(1) as other:
        killed = other.submit(kill, client)
        call(path, executor=client)
        killed.result()
    assert files(path) == whole


def test_each_kind_of_warning_is_given_once_however_many_tiles_there_are(tmp_path):
    grid = {"speed": np.linspace(1.1e4, 9e4, 24), "clearance": np.linspace(0.1, 0.9, 5)}
    with pytest.warns(sj.ImplausibleWarning) as given:
        made_up.made_up(SCENE, grid, store=Store(tmp_path / "map.zarr", tile=5))
    # of two parameters by the whole grid, by the first case, and by all of 24 tiles
    assert len(given) <= 6


def test_what_is_no_executor_or_no_store_is_named(tmp_path):
    path, asked = tmp_path / "m.zarr", lambda **how: made_up.made_up(SCENE, a_grid(), **how)
    forked = ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("fork"))  # which starts none by itself
    (tmp_path / "plain.zarr").mkdir()
    for make, words in (
        (lambda: asked(executor=forked, store=path), "must start new processes, .* but is one that forks"),
        (lambda: asked(executor=3, store=path), "must be a dask.distributed.Client or"),
        (lambda: asked(executor=ThreadPoolExecutor(1)), "`executor` must come with `store`"),
        (lambda: asked(store=7), "must be a path or a slipperjax.sweeps.Store"),
        (lambda: asked(store=path, steps_per_period=np.ones(3)), "one for each case, \\(12, 10\\)"),
        *((lambda n=n: Store(path, share=n), "`share` must be") for n in ((0, 2), (3, 2), (1,), "1/2")),
        (lambda: Store(path, share=(1, 2), fresh=True), "`fresh` must be False"),
        (lambda: call(tmp_path / "map.nc"), r"ends in \.zarr"),
        (lambda: call(tmp_path / "plain.zarr"), "must be a store of slipperjax"),
        (lambda: call(tmp_path / "none" / "map.zarr"), "No such folder"),
    ):
        with pytest.raises((ValueError, FileNotFoundError), match=words):
            make()
