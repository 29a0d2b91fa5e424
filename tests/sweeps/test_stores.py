"""Stores: the same bytes however a sweep was cut short, and clear words where they cannot be written."""

import contextlib
import errno
import itertools
import json
import multiprocessing
import os
import shutil
import subprocess
import sys
import time
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import equinox as eqx
import filelock
import numpy as np
import pytest
import xarray as xr

import slipperjax as sj
from slipperjax.flow.status import ASKED
from slipperjax.sweeps import run
from slipperjax.sweeps.grid import Tiling
from slipperjax.sweeps.plan import Chunk
from slipperjax.sweeps.schedule import Schedule
from slipperjax.sweeps.store import Store, StoreInUse, WorkerLost, check_store, store_status
from slipperjax.tools.checks import warn

from . import made_up
from .made_up import a_grid, call, files

ROOT = Path(__file__).parents[2]
module = sys.modules["slipperjax.sweeps.store"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The bytes of a store that nothing disturbed."""
    path = tmp_path_factory.mktemp("whole") / "map.zarr"
    call(path)
    return files(path)


def forget(stored, number=4):
    """Takes the mark of a tile away: it is computed again."""
    (stored / "status" / "marks" / str(number)).unlink()


@pytest.fixture
def stored(tmp_path, whole):
    """The path of such a store."""
    for name, content in whole.items():
        (tmp_path / "map.zarr" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "map.zarr" / name).write_bytes(content)
    return tmp_path / "map.zarr"


# of processes in which shapes and types of stores are checked
CHECKED = os.pathsep.join([str(ROOT / "tests" / "checked"), str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])


def process(path, pause):
    """A process that computes the store, once it has begun."""
    options = dict(cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    options["env"] = os.environ | {"PAUSE": str(pause), "PYTHONPATH": CHECKED}
    found = subprocess.Popen([sys.executable, "-m", "tests.sweeps.made_up", str(path)], **options)
    assert found.stdout.readline() == "ready\n", found.stderr.read()
    return found


def test_a_store_holds_what_the_sweep_gives(tmp_path):
    found, plain = call(tmp_path / "map.zarr"), made_up.made_up(sj.paper_scene(), a_grid())
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


def test_the_lists_of_a_grid_are_read_side_by_side(tmp_path):
    lists = {"speed": np.linspace(500, 600, 23), "clearance": np.linspace(2e-3, 1e-3, 23)}
    how = dict(product=False, steps_per_period=50 * (1 + np.arange(23) % 8))
    plain = made_up.made_up(sj.paper_scene(), lists, **how)
    ds = made_up.made_up(sj.paper_scene(), lists, store=sj.sweeps.Store(tmp_path / "list.zarr", tile=7), **how)
    assert ds["status"].dims == ("case",)
    for name in (*lists, "steps_per_period", "seconds"):
        np.testing.assert_array_equal(ds[name], plain[name])


def test_tiles_cover_a_grid_once():
    for shape, size in (((7, 5, 3), 4), ((23,), 7), ((200, 200), None), ((1, 1), 9)):
        tiles = Tiling.of(shape, size)
        seen = np.zeros(shape, int)
        for number in range(tiles.count):
            seen[tiles.region(number)] += 1
        assert np.all(seen == 1)


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
def test_stores_of_processes_hold_what_functions_give(tmp_path, function, how):
    scene, grid = sj.paper_scene(), {"speed": np.linspace(1000, 1600, 4), "clearance": np.linspace(5e-4, 15e-4, 3)}
    how = how | dict(steps_per_period=50)
    with sj.sweeps.processes(2) as pool:
        ds = function(
            scene, grid=grid, store=sj.sweeps.Store(tmp_path / "map.zarr", tile=4), chunk=8, executor=pool, **how
        )
    plain = function(scene, grid=grid, **how)
    assert set(ds.variables) == set(plain.variables)
    for name in plain.variables:
        np.testing.assert_array_equal(ds[name].values, plain[name].values, err_msg=name)


@pytest.mark.full
def test_two_processes_cannot_write_to_one_store_and_a_killed_one_is_gone_on_with(tmp_path, whole):
    path = tmp_path / "map.zarr"
    with process(path, 0.2) as one:
        while not path.exists() or store_status(path).tiles_done < 3:
            time.sleep(0.01)
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
        while not path.exists() or store_status(path).tiles_done < 3:
            time.sleep(0.01)
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
    there = ds["status"].values != int(sj.Status.NOT_RUN)
    assert there.sum() == finished
    assert np.isnan(ds["v_z"].values[~there]).all()
    call(path)
    assert files(path) == whole


def test_another_call_is_refused_with_the_difference(tmp_path, stored, whole):
    grid = a_grid()

    def asked(fresh=False, **change):
        how = dict(scene=sj.paper_scene(), grid=grid) | change
        made_up.made_up(store=sj.sweeps.Store(stored, tile=10, fresh=fresh), **how)

    for change, words in (
        (dict(periods=4), "call.periods: 3 in the store, 4 asked"),
        (dict(scene=sj.paper_scene(restitution=0.8)), "restitution: 0.9 in the store, 0.8 asked"),
        (dict(grid=grid | {"speed": grid["speed"] + 1}), "grid.speed.first: 1000.0 in the store, 1001.0 asked"),
    ):
        with pytest.raises(ValueError, match=f"(?s)was made by another one.*{words}"):
            asked(**change)
    with pytest.raises(ValueError, match="grid"):  # a wrong argument deletes nothing
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
    asked, computed = [], made_up.computed
    monkeypatch.setattr(made_up, "computed", lambda *given, **how: asked.append(given) or computed(*given, **how))
    call(stored)
    assert files(stored) == whole
    assert len(asked) == 2


def test_a_tile_of_another_store_or_place_is_none_of_this_one(stored, whole, tmp_path):
    other = tmp_path / "other.zarr"
    made_up.made_up(sj.paper_scene(restitution=0.8), a_grid(), store=Store(other, tile=10))
    for file in [*other.glob("*/c/3/**/*"), other / "status" / "marks" / "3"]:
        if file.is_file() and file.relative_to(other).parts[0] not in ("speed", "clearance", "point"):
            (stored / file.relative_to(other)).write_bytes(file.read_bytes())
    marks = stored / "status" / "marks"
    (marks / "5").write_bytes((marks / "6").read_bytes())
    (marks / "7").write_bytes(b"")
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


def test_other_versions_go_on_with_a_warning_and_stand_by_tile(stored, monkeypatch):
    forget(stored)
    now = module.versions()
    monkeypatch.setattr(module, "versions", lambda: now | {"numpy": "1.2.3"})
    with pytest.warns(sj.ImplausibleWarning, match=f"begun with numpy {now['numpy']} and not 1.2.3"):
        call(stored)
    found = [(stored / "status" / "marks" / str(k)).read_text() for k in (3, 4)]
    assert ["1.2.3" in text for text in found] == [False, True]
    assert check_store(stored) == []
    call(stored)  # of a complete one nothing is said


def test_workers_with_other_code_write_nothing(stored, whole, monkeypatch):
    forget(stored)
    before = files(stored)
    of_caller = module._fingerprint

    def fingerprint(*given):
        with monkeypatch.context() as caller:
            caller.setattr(module, "IMPORTED", module.IMPORTED.removesuffix("of a worker"))
            return of_caller(*given)

    monkeypatch.setattr(module, "_fingerprint", fingerprint)
    monkeypatch.setattr(module, "IMPORTED", module.IMPORTED + "of a worker")
    with pytest.raises(RuntimeError, match="a worker imported other code"):
        call(stored)
    assert files(stored) == before


def test_only_stores_of_ours_are_replaced(tmp_path, stored, whole):
    other = tmp_path / "other.zarr"
    made_up.made_up(sj.paper_scene(), a_grid()).to_zarr(other, zarr_format=2, consolidated=False)
    before = files(other)
    with pytest.raises(ValueError, match="must be a store of slipperjax, but is none"):
        call(other, fresh=True)
    assert files(other) == before
    for name in ("thesis.tex", "notes/thesis.tex", "v_z/c/3/0/0.tex", "thesis.partial", ".git/config"):
        file = stored / name
        file.parent.mkdir(exist_ok=True)
        file.write_text("years of work")
        with pytest.raises(ValueError, match=f"must have no other files .* but has .*{name}"):
            call(stored, fresh=True)
        assert file.read_text() == "years of work"
        file.unlink()
        if not any(file.parent.iterdir()):
            file.parent.rmdir()
    (stored / "v_z" / "c" / "3" / "0" / "0.1.partial").write_text("of a process that was killed")
    (stored / "status" / "marks" / "4").unlink()
    call(stored)
    assert files(stored) == whole


def test_an_old_worker_does_not_write_into_a_new_store(stored, whole):
    old = module._open_archive(stored)
    ds = made_up.made_up(sj.paper_scene(), a_grid()).isel(speed=slice(2, 3))
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
    forget(stored)
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


def own_law(body, helper=""):
    known = {"__name__": "of_a_user"}
    exec(LAW.format(body=body, helper=helper), known)
    return eqx.tree_at(lambda scene: scene.contact, sj.paper_scene(), known["OwnLaw"](1e9))


def test_a_store_refuses_other_code_of_a_law(tmp_path, monkeypatch):
    path = tmp_path / "map.zarr"
    asked = lambda *law: made_up.made_up(own_law(*law), a_grid(), store=Store(path, tile=10))
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
    script = """
import os, slipperjax as sj
if __name__ == '__main__':
    print(sj.sweeps.processes(1).submit(os.getpid).result(), flush=True)
    input()
"""
    file = tmp_path / "script.py"
    file.write_text(script)
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


def test_the_first_case_is_told_too(tmp_path, capsys, monkeypatch):
    """It makes the store, and compiles for minutes before there is one."""
    monkeypatch.setattr("slipperjax.sweeps.store.DELAY", 0.0)
    call(tmp_path / "map.zarr", progress=True)
    lines = [line for line in capsys.readouterr().err.splitlines() if line]
    assert lines[0].startswith("first case:   0%")
    assert any(line.startswith("first case: 100%") and line.endswith("1 of 1 cases") for line in lines)
    assert lines[-1].endswith("120 of 120 cases")


def test_a_full_disk_is_named_and_nothing_is_lost(tmp_path, whole, monkeypatch):
    from zarr.storage import LocalStore

    path, usual, count = tmp_path / "map.zarr", LocalStore.set, 0

    async def fails(self, key, value):
        nonlocal count
        count += 1
        if count > 60:
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
    module = sys.modules["slipperjax.tools.limits"]
    monkeypatch.setattr(module, "available_memory", lambda: 1000)
    with pytest.raises(ValueError, match=r"120 cases need about .* but 1 kB of memory are available"):
        call(tmp_path / "map.zarr", workers=2)
    assert list(tmp_path.iterdir()) == []
    monkeypatch.setattr(module, "available_memory", lambda: None)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=1000))
    with pytest.warns(sj.ImplausibleWarning, match="The store needs about .* and its disk has 1 kB"):
        call(tmp_path / "map.zarr")


def test_where_nothing_can_be_written_a_complete_store_is_read(stored, monkeypatch):
    def refused(*given, **how):
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(filelock.FileLock, "acquire", refused)
    assert int((call(stored)["status"] == int(sj.Status.NOT_RUN)).sum()) == 0
    forget(stored)
    with pytest.raises(PermissionError, match="protected against writing"):
        call(stored)


@pytest.mark.parametrize("fresh", [False, True])
def test_a_protected_store_is_named_before_anything_is_computed_or_replaced(stored, fresh, monkeypatch):
    forget(stored)
    before = files(stored)
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != stored)  # as for all but root
    monkeypatch.setattr(module, "gather", None)
    with pytest.raises(PermissionError, match=r"map\.zarr is protected against writing"):
        call(stored, fresh=fresh)
    assert files(stored) == before


@pytest.mark.parametrize(
    ("name", "error", "words"),
    [
        ("none/map.zarr", FileNotFoundError, "No such folder"),
        ("map.nc", ValueError, r"ends in \.zarr"),
        ("plain.zarr", ValueError, "must be a store of slipperjax"),
    ],
)
def test_what_can_be_no_store_is_named(name, error, words, tmp_path):
    (tmp_path / "plain.zarr").mkdir()
    with pytest.raises(error, match=words):
        call(tmp_path / name)


@pytest.mark.full
def test_processes_compute_tiles_and_shares_and_a_killed_one_is_named(tmp_path, whole, monkeypatch):
    mark, path, shared, dies = (tmp_path / name for name in ("die", "map.zarr", "shared.zarr", "dies.zarr"))
    monkeypatch.setenv("DIES", str(mark))
    monkeypatch.setenv("PYTHONPATH", CHECKED)
    with sj.sweeps.processes(2) as pool:
        ds = call(path, executor=pool)
        assert files(path) == whole
        assert int((ds["status"] == int(sj.Status.NOT_RUN)).sum()) == 0
        other = pool.submit(made_up.first_half, shared)
        call(shared, share=(2, 2))
        other.result()
        assert files(shared) == whole
        calls = itertools.count(1)

        def submit(*work):
            if next(calls) == 3:  # the third worker is asked to die
                mark.touch()
            return pool.submit(*work)

        with pytest.raises(WorkerLost, match=r"[0-9]+ cases or more are stored"):
            call(dies, executor=SimpleNamespace(submit=submit))
    assert store_status(dies).tiles_done < 12
    call(dies)
    assert files(dies) == whole


def test_tasks_of_a_broken_executor_are_left_to_it(tmp_path):
    futures = []

    def submit(*work):
        futures.append(Future())
        if len(futures) == 12:
            futures[3].set_exception(BrokenExecutor("lost"))
        return futures[-1]

    with pytest.raises(WorkerLost):
        call(tmp_path / "map.zarr", executor=SimpleNamespace(submit=submit))
    assert not any(future.cancelled() for future in futures)


def test_each_kind_of_warning_is_given_once_however_many_parts_there_are(tmp_path):
    grid = {"speed": np.linspace(1.1e4, 9e4, 24), "clearance": np.linspace(0.1, 0.9, 5)}
    with pytest.warns(sj.ImplausibleWarning) as told:
        made_up.made_up(sj.paper_scene(), grid, store=Store(tmp_path / "map.zarr", tile=5))
    # of two parameters by the whole grid, by the first case, and by all of 24 tiles
    assert len(told) <= 6
    chunks = [Chunk(np.arange(8) + 8 * k, 8, Schedule.of(0, 1, 50)) for k in range(6)]

    def work(chunk, on_progress):
        warn(f"{chunk.index[0]} of 48 starts lie outside.")
        return run.PartRun(np.zeros(8), np.zeros(8, int), (), np.empty((8, 0)))

    for _ in range(2):
        with pytest.warns(sj.ImplausibleWarning) as told:
            run.run_parts(chunks, 2, work, periods=1.0, progress=False)
        assert len(told) == 1


def test_what_is_no_executor_or_no_store_is_named(tmp_path):
    path, asked = tmp_path / "m.zarr", lambda **how: made_up.made_up(sj.paper_scene(), a_grid(), **how)
    forked = ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("fork"))  # which starts none by itself
    for make, words in (
        (lambda: asked(executor=forked, store=path), "must start new processes, .* but is one that forks"),
        (lambda: asked(executor=3, store=path), "must be a dask.distributed.Client or"),
        (lambda: asked(executor=ThreadPoolExecutor(1)), "`executor` must come with `store`"),
        (lambda: asked(store=7), "must be a path or a slipperjax.sweeps.Store"),
        (lambda: asked(store=path, steps_per_period=np.ones(3)), "one for each case, \\(12, 10\\)"),
        *((lambda n=n: sj.sweeps.Store(path, share=n), "`share` must be") for n in ((0, 2), (3, 2), (1,), "1/2")),
        (lambda: sj.sweeps.Store(path, share=(1, 2), fresh=True), "`fresh` must be False"),
    ):
        with pytest.raises(ValueError, match=words):
            make()


def test_the_call_is_digested_once_and_not_for_each_tile(stored, whole, monkeypatch):
    """A call may hold a whole rail."""
    shutil.rmtree(stored / "status" / "marks")
    seen = []
    of_text = module._digest
    monkeypatch.setattr(module, "_digest", lambda content: seen.append(len(content)) or of_text(content))
    opened = []
    of_store = module._open_archive
    monkeypatch.setattr(module, "_open_archive", lambda *given: opened.append(given) or of_store(*given))
    call(stored)
    assert files(stored) == whole
    attributes = json.loads((stored / "zarr.json").read_text())["attributes"]
    long = len(json.dumps(json.loads(attributes[module.MARK])["call"], sort_keys=True))
    assert seen.count(long) == 1
    # the file that holds it is digested where it is opened, and by each tile
    assert sum(length > long for length in seen) == len(opened) + 12
    assert len(opened) < 5
