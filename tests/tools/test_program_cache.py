"""The cache of compiled programs: used, shared, and never a failure."""

import math
import os
import subprocess
import sys
import time
import zlib
from pathlib import Path

import pytest

import slipperjax as sj
from slipperjax.tools.program_cache import CHECKED, SETTLED, CacheWarning, _tidy, processor

PROGRAM = """
import jax
import slipperjax as sj
hits, folder = [], sj.compile_cache()
jax.monitoring.register_event_listener(lambda name, **_: hits.append(1) if name.endswith("cache_hits") else None)
found = jax.jit(lambda x: jax.numpy.sin(x) * 2)(1.0)
print(folder, len(hits), float(found))
"""


def run(folder: Path, **variables: str) -> tuple[list[str], str]:
    """What a fresh process prints, and its errors."""
    inherited = {k: v for k, v in os.environ.items() if not k.startswith(("JAX_", "SLIPPERJAX_"))}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        env=inherited | {"SLIPPERJAX_CACHE": str(folder)} | variables,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.split(), done.stderr


def entries(place: Path) -> list[Path]:
    return sorted(place.glob("*-cache"))


def test_a_second_process_takes_what_the_first_compiled(tmp_path):
    (place, hits, value), errors = run(tmp_path)
    assert Path(place).parent == tmp_path
    assert Path(place).name.endswith(processor())
    assert hits == "0"
    assert not errors
    assert entries(Path(place))
    (_, again, same), errors = run(tmp_path)
    assert int(again) >= 1
    assert same == value
    assert not errors  # XLA's, of processors with AVX-512, are not shown


def test_the_cache_is_off_where_asked_and_a_folder_of_jax_stays(tmp_path):
    assert run(Path("off"))[0][0] == "None"
    folder = tmp_path / "of_jax"
    assert run(tmp_path / "other", JAX_COMPILATION_CACHE_DIR=str(folder))[0][0] == str(folder)
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize("make", [lambda path: path.write_text("a file"), lambda path: path.symlink_to(path)])
def test_a_folder_that_cannot_be_used_is_one_warning(tmp_path, make):
    make(tmp_path / "cache")
    with pytest.warns(CacheWarning, match="compiled programs are not kept: .*cache.* cannot be used") as seen:
        assert sj.compile_cache(tmp_path / "cache") is None
    assert len(seen) == 1


def test_a_folder_that_fails_later_is_silent(tmp_path):
    place = Path(run(tmp_path)[0][0])
    for path in entries(place):
        path.write_bytes(path.read_bytes()[:40])  # as a process leaves it that is killed while it writes
    (_, hits, _), errors = run(tmp_path)
    assert hits == "0"
    assert not errors


def test_incomplete_entries_are_deleted_and_whole_ones_stay(tmp_path):
    whole = zlib.compress(bytes(1000))
    old = time.time() - 2 * SETTLED
    for name, data in {
        "good-cache": whole,
        "cut-cache": whole[:-4],
        "noise-cache": b"noise",
        "1-program.2.part": b"",
    }.items():
        path = tmp_path / name
        path.write_bytes(data)
        os.utime(path, (old, old))
    (tmp_path / "young-cache").write_bytes(whole[:-4])  # somebody may be writing it
    _tidy(tmp_path)
    assert [path.name for path in entries(tmp_path)] == ["good-cache", "young-cache"]
    assert not list(tmp_path.glob("*.part"))
    assert (tmp_path / CHECKED).exists()


def test_the_entries_that_are_longest_unused_go_first(tmp_path, monkeypatch):
    monkeypatch.setattr("slipperjax.tools.program_cache.MOST", 4000)
    now = time.time()
    for k in range(6):
        path = tmp_path / f"{k}-cache"
        path.write_bytes(zlib.compress(os.urandom(1000)))
        os.utime(path, (now - k, now - k))
    _tidy(tmp_path)
    assert [path.name for path in entries(tmp_path)] == ["0-cache", "1-cache"]


def test_several_processes_share_a_folder(tmp_path):
    command = [sys.executable, "-c", PROGRAM]
    environment = {**os.environ, "SLIPPERJAX_CACHE": str(tmp_path)}
    both = [subprocess.Popen(command, env=environment, stdout=-1, stderr=-1, text=True) for _ in range(2)]
    for process in both:
        out, errors = process.communicate(timeout=300)
        assert process.returncode == 0
        assert not errors
        assert float(out.split()[2]) == pytest.approx(2 * math.sin(1.0), rel=1e-12)
