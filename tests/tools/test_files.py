"""Files whole or not at all."""

import errno
import os
import stat

import pytest

from slipperjax.tools.files import NotWritten, said, write_each, write_whole


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_new_file_is_written_and_an_old_one_replaced(tmp_path):
    path = tmp_path / "a.nc"
    assert write_whole(path, b"one") is False
    os.chmod(path, 0o640)
    with open(path, "rb") as held:
        assert write_whole(path, memoryview(b"three")) is True
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


@pytest.fixture
def full_disk(monkeypatch, tmp_path):
    """A folder whose disk is full, beside one for temporary files that has room."""
    folder, elsewhere = tmp_path / "full", tmp_path / "elsewhere"
    folder.mkdir()
    elsewhere.mkdir()
    sync = os.fsync

    def fsync(descriptor):
        if os.readlink(f"/proc/self/fd/{descriptor}").startswith(str(folder)):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        sync(descriptor)

    monkeypatch.setattr("slipperjax.tools.files.os.fsync", fsync)
    monkeypatch.setattr("slipperjax.tools.files.tempfile.gettempdir", lambda: str(elsewhere))
    return folder, elsewhere


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


def test_what_cannot_be_written_goes_elsewhere_and_the_rest_to_its_place(full_disk, tmp_path):
    folder, elsewhere = full_disk
    (folder / "a.nc").write_bytes(b"old")
    contents = {folder / "a.nc": lambda: b"new", tmp_path / "a.png": lambda: b"picture"}
    with pytest.raises(NotWritten) as failed:
        write_each(contents)
    (kept,) = elsewhere.glob("*/*")
    assert str(failed.value) == (
        f"cannot write {folder / 'a.nc'}: No space left on device (it is kept as {kept}); wrote {tmp_path / 'a.png'}"
    )
    assert kept.read_bytes() == b"new"
    assert (folder / "a.nc").read_bytes() == b"old"
    assert names(folder) == ["a.nc"]
    assert (tmp_path / "a.png").read_bytes() == b"picture"


def test_nothing_is_written_through_links_that_somebody_has_put_there(full_disk, monkeypatch):
    folder, elsewhere = full_disk
    victim = elsewhere.parent / "victim"
    victim.write_bytes(b"years of work")
    monkeypatch.setattr("secrets.token_hex", lambda count: "guessed")
    for link in (folder / f".a.nc.{os.getpid()}.part", folder / ".a.nc.guessed.part"):
        link.symlink_to(victim)
    (elsewhere / f"slipperjax_{os.getpid()}_a.nc").symlink_to(victim)
    with pytest.raises(NotWritten, match="cannot write"):
        write_each({folder / "a.nc": lambda: b"new"})
    assert victim.read_bytes() == b"years of work"
    (kept,) = elsewhere.glob("slipperjax_*/a.nc")
    assert kept.read_bytes() == b"new"
    assert stat.S_IMODE(kept.parent.stat().st_mode) == 0o700


def test_what_was_done_is_said(tmp_path):
    (tmp_path / "b").write_bytes(b"old")
    done = write_each({tmp_path / name: lambda: b"new" for name in "abc"})
    (tmp_path / "d").mkdir()  # a folder in the way is left alone
    with pytest.raises(OSError, match="directory"):
        write_whole(tmp_path / "d", b"new")
    assert names(tmp_path) == list("abcd")
    assert said(done) == f"wrote {tmp_path / 'a'} and {tmp_path / 'c'} and replaced {tmp_path / 'b'}"
