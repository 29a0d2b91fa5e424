"""Stores by dask's workers."""

import os
import signal
import threading
import time
import warnings

import pytest

from slipperjax.sweeps.stores.archive import store_status

from .made_up import call, files

distributed = pytest.importorskip("distributed")


@pytest.fixture
def client(monkeypatch):
    """Two spawned workers of one thread each, whose tiles take a tenth of a second."""
    monkeypatch.setenv("PAUSE", "0.1")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of dask's own making: ports in use, unclosed sockets
        options = dict(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None)
        with distributed.LocalCluster(**options) as cluster, distributed.Client(cluster) as found:
            yield found


def test_a_worker_killed_midway_changes_no_byte(tmp_path, client, monkeypatch):
    path, killed = tmp_path / "map.zarr", []

    def kill():
        while not path.exists() or store_status(path).tiles_done < 3:
            time.sleep(0.01)
        killed.append(next(iter(client.run(os.getpid).values())))
        os.kill(killed[0], signal.SIGKILL)

    other = threading.Thread(target=kill)
    other.start()
    ds = call(path, executor=client)
    other.join()
    assert killed
    assert int((ds["status"] == 7).sum()) == 0
    monkeypatch.delenv("PAUSE")
    call(tmp_path / "whole.zarr")
    assert files(path) == files(tmp_path / "whole.zarr")
