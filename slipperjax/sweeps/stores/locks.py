"""Who may write to a store: one process to all of it, or one to each share."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .target import Store

WAIT = 60.0
"""Seconds for which a share waits until another one has made the store."""


class StoreInUse(OSError):
    """Another process writes to the store. Its lock ends with that process, however this ends."""


def _lock_path(store: Path, share: tuple[int, int] | None = None) -> Path:
    return store.with_name(store.name + (".lock" if share is None else f".{share[0]}-of-{share[1]}.lock"))


@contextmanager
def writing(store: Store) -> Iterator[None]:
    """Holds the right to write to a store, or to a share of it.

    **Raises:** `StoreInUse`; `OSError` where the folder is missing or read-only.
    """
    with _held(_lock_path(store.path, store.share)):
        if store.share is None:
            for other in store.path.parent.glob(f"{store.path.name}.*-of-*.lock"):
                with _held(other):
                    pass
        yield


@contextmanager
def making(store: Store) -> Iterator[None]:
    """Holds the right to make a store, for which other shares wait; who writes to all of it has it already."""
    if store.share is None:
        yield
    else:
        with _held(_lock_path(store.path), WAIT):
            yield


@contextmanager
def _held(path: Path, wait: float = 0.5) -> Iterator[None]:
    """Holds a lock, and deletes its file afterwards."""
    import filelock

    if not path.parent.is_dir():
        raise FileNotFoundError(f"No such folder: {path.parent}")
    lock = filelock.FileLock(path)
    try:
        lock.acquire(timeout=wait)
    except filelock.Timeout:
        raise StoreInUse(
            f"Another process writes to {path.name.removesuffix('.lock')} (it holds {path}); wait for it or stop it, "
            "then call again: what it has finished is kept."
        ) from None
    except PermissionError:
        raise PermissionError(f"{path.parent} is protected against writing") from None
    try:
        yield
    finally:
        path.unlink(missing_ok=True)  # while it is held: who waits for it then looks for a new one
        lock.release()
