"""The cache of compiled programs: filled by one process and used by another, private, and silent where it fails."""

import os
import subprocess
import sys
from datetime import datetime
from types import SimpleNamespace

import jax
import pytest

from slipperjax.cli import main
from slipperjax.tools import cache
from slipperjax.tools.cache import CacheWarning, compile_cache
from slipperjax.tools.forms import is_plain

PROGRAM = """
import jax, slipperjax as sj
import slipperjax.tools.forms
hits = []
jax.monitoring.register_event_listener(lambda event, **_: hits.append(event))
place = sj.compile_cache()
sj.tools.forms.is_plain()
jax.jit(lambda x: x * 2 + 1)(3.0)
count = lambda name: sum(event == f"/jax/compilation_cache/{name}" for event in hits)
print(count("cache_hits"), count("cache_misses"), place is not None)
"""


def in_process(folder):
    """Hits and misses of a program in a process of its own, and whether it has a cache; nothing else is printed."""
    env = os.environ | {"SLIPPERJAX_CACHE": str(folder)}
    found = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, env=env, check=True)
    assert found.stderr == ""
    hits, misses, has_cache = found.stdout.split()
    return int(hits), int(misses), has_cache == "True"


@pytest.mark.skipif(is_plain(), reason="whose warning is printed")
@pytest.mark.usefixtures("own_cache")
def test_a_second_process_takes_what_the_first_compiled(tmp_path, monkeypatch):
    hits, misses, has_cache = in_process(tmp_path / "cache")
    assert hits == 0
    assert misses > 0
    assert has_cache
    # the self-test of the fast form has passed, and is not repeated
    assert in_process(tmp_path / "cache") == (1, 0, True)
    for path in ((tmp_path / "cache"), *(tmp_path / "cache").iterdir()):
        assert path.stat().st_mode & 0o777 == 0o700
    monkeypatch.setenv("SLIPPERJAX_CACHE", "off")
    assert compile_cache() is None
    assert jax.config.jax_compilation_cache_dir is None


@pytest.mark.usefixtures("own_cache")
def test_a_folder_that_cannot_be_trusted_is_one_warning(tmp_path, monkeypatch):
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o770)
    (tmp_path / "file").write_text("")
    for name, words in (("open", "nobody else may write there"), ("file", "File exists")):
        with pytest.warns(CacheWarning, match=words) as warned:
            assert compile_cache(tmp_path / name) is None
        assert len(warned) == 1
        assert jax.config.jax_compilation_cache_dir is None
    monkeypatch.setattr(os, "getuid", lambda: tmp_path.stat().st_uid + 1)
    with pytest.warns(CacheWarning, match="must belong to you"):
        assert compile_cache(tmp_path / "cache") is None


def test_a_folder_of_jax_stays(tmp_path, own_cache, monkeypatch):
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    assert compile_cache(tmp_path / "other") == tmp_path
    assert not (tmp_path / "other").exists()


def test_the_longest_unused_go_first(tmp_path):
    for k in range(12):
        (tmp_path / f"{k}").write_bytes(bytes(100))
        os.utime(tmp_path / f"{k}", (k, k))
    cache._prune(tmp_path, most=1000)
    assert sorted(int(path.name) for path in tmp_path.iterdir()) == list(range(5, 12))


@pytest.mark.usefixtures("own_cache")
def test_what_a_crash_or_a_full_disk_leaves_is_not_kept_for_ever(tmp_path, monkeypatch):
    """JAX neither reads an empty entry nor writes it again."""
    place = compile_cache(tmp_path / "cache")
    (place / "jit_f-1-cache").write_bytes(b"")
    (place / "jit_f-2-cache").write_bytes(b"program")
    jax.config.update("jax_compilation_cache_dir", None)
    compile_cache(tmp_path / "cache")
    assert [path.name for path in place.iterdir()] == ["jit_f-2-cache"]
    jax.config.update("jax_compilation_cache_dir", None)
    monkeypatch.setattr(cache.shutil, "disk_usage", lambda path: SimpleNamespace(free=1000))
    with pytest.warns(CacheWarning, match="the disk of .* is full"):
        assert compile_cache(tmp_path / "cache") is None


@pytest.mark.usefixtures("own_cache")
def test_the_command_tells_and_deletes_what_is_kept(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("SLIPPERJAX_CACHE", str(tmp_path))
    place = cache.kept_folder()
    assert place is not None
    for name, seconds in (("a-whole", 1e9), ("jit_f-cache", 1.5e9)):
        (place / name).write_bytes(bytes(50_000))
        os.utime(place / name, (seconds, seconds))
    assert command(capsys, "cache") == [
        f"folder    {place}",
        "programs  2: 1 of the package, 1 of JAX",
        "size      0.1 MB",
        f"oldest    used last on {datetime.fromtimestamp(1e9):%Y-%m-%d at %H:%M}",
    ]
    assert command(capsys, "cache", "--clear") == [f"deleted 2 programs, 0.1 MB, of {place}"]
    assert command(capsys, "cache")[1:] == ["programs  0: 0 of the package, 0 of JAX", "size      0.0 MB"]
    assert command(capsys, "--no-cache", "cache") == [
        "no programs are kept: the cache is off, or its folder cannot be used"
    ]


def command(capsys, *words):
    """The lines that a command prints."""
    with pytest.raises(SystemExit) as ended:
        main(list(words))
    assert ended.value.code == 0
    return capsys.readouterr().out.splitlines()
