"""Stores by dask's workers."""

import contextlib
import os
import signal
import time
import warnings
from concurrent.futures import ThreadPoolExecutor

import pytest

from slipperjax.sweeps.store import store_status

from .made_up import call, files

distributed = pytest.importorskip("distributed")


@contextlib.contextmanager
def workers(processes):
    """A client of two workers of one thread each, in this process or in spawned ones."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of dask's own making: ports in use, unclosed sockets
        options = dict(n_workers=2, threads_per_worker=1, processes=processes, dashboard_address=None)
        with distributed.LocalCluster(**options) as cluster, distributed.Client(cluster) as client:
            yield client


def test_workers_compute_tiles(tmp_path):
    with workers(processes=False) as client:
        ds = call(tmp_path / "map.zarr", executor=client)
    assert int((ds["status"] == 7).sum()) == 0
    call(tmp_path / "whole.zarr")
    assert files(tmp_path / "map.zarr") == files(tmp_path / "whole.zarr")


@pytest.mark.slow
def test_a_worker_killed_midway_changes_no_byte(tmp_path, monkeypatch):
    path = tmp_path / "map.zarr"
    monkeypatch.setenv("PAUSE", "0.1")  # of each tile, in the workers

    def kill(client):
        while not path.exists() or store_status(path).tiles_done < 3:
            time.sleep(0.01)
        os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)
        return True

    with workers(processes=True) as client, ThreadPoolExecutor(1) as beside:
        killed = beside.submit(kill, client)
        ds = call(path, executor=client)
        assert killed.result()
    assert int((ds["status"] == 7).sum()) == 0
    monkeypatch.delenv("PAUSE")
    call(tmp_path / "whole.zarr")
    assert files(path) == files(tmp_path / "whole.zarr")
