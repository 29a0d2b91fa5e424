"""Files whole or not at all."""

import errno
import os
import stat

import pytest

from slipperjax.tools.files import first_ones, write_each, write_whole


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_new_file_is_written_and_an_old_one_replaced(tmp_path):
    path = tmp_path / "a.nc"
    write_whole(path, b"one")
    os.chmod(path, 0o640)
    with open(path, "rb") as held:
        write_whole(path, memoryview(b"three"))
        assert held.read() == b"one"  # what is open elsewhere stays as it was
    assert path.read_bytes() == b"three"
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert names(tmp_path) == ["a.nc"]


def test_the_file_that_a_link_leads_to_is_written(tmp_path):
    (tmp_path / "there").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "there" / "a")
    write_whole(tmp_path / "link", b"one")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "there" / "a").read_bytes() == b"one"


@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, "full"), KeyboardInterrupt()])
def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch, error):
    path = tmp_path / "a.nc"
    path.write_bytes(b"old")

    def fsync(descriptor):
        raise error

    monkeypatch.setattr("slipperjax.tools.files.os.fsync", fsync)
    with pytest.raises(type(error)):
        write_whole(path, b"new")
    assert path.read_bytes() == b"old"
    assert names(tmp_path) == ["a.nc"]


def test_the_rest_is_written_where_one_file_cannot_be(tmp_path, monkeypatch):
    def fails(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def content():
        monkeypatch.undo()
        return b"picture"

    (tmp_path / "a.nc").write_bytes(b"old")
    monkeypatch.setattr("slipperjax.tools.files.os.fsync", fails)
    with pytest.raises(OSError, match="cannot write") as failed:
        write_each({tmp_path / "a.nc": lambda: b"new", tmp_path / "a.png": content})
    assert str(failed.value) == (
        f"cannot write {tmp_path / 'a.nc'}: No space left on device; wrote {tmp_path / 'a.png'}"
    )
    assert (tmp_path / "a.nc").read_bytes() == b"old"
    assert (tmp_path / "a.png").read_bytes() == b"picture"
    assert names(tmp_path) == ["a.nc", "a.png"]


def test_nothing_is_written_through_links_that_somebody_has_put_there(tmp_path, monkeypatch):
    victim = tmp_path / "victim"
    victim.write_bytes(b"years of work")
    monkeypatch.setattr("secrets.token_hex", lambda count: "guessed")
    (tmp_path / ".a.nc.guessed.part").symlink_to(victim)
    with pytest.raises(OSError, match="cannot write"):
        write_each({tmp_path / "a.nc": lambda: b"new"})
    assert victim.read_bytes() == b"years of work"


def test_what_was_done_is_said(tmp_path):
    done = write_each({tmp_path / name: lambda: b"new" for name in "abc"})
    (tmp_path / "d").mkdir()  # a folder in the way is left alone
    with pytest.raises(OSError, match="directory"):
        write_whole(tmp_path / "d", b"new")
    assert names(tmp_path) == list("abcd")
    assert done == f"wrote {tmp_path / 'a'}, {tmp_path / 'b'} and {tmp_path / 'c'}"


def test_of_many_names_the_first_five_are_said():
    assert first_ones(list("abc")) == "a, b and c"
    assert first_ones(list("abcde")) == "a, b, c, d and e"
    assert first_ones(list("abcdefgh")) == "a, b, c, d, e and 3 more"
