"""Signals: Ctrl-C and `kill` end a command properly, and at once where necessary."""

import os
import signal
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from contextvars import copy_context
from types import FrameType
from typing import TypeVar

from ..flow.status import ASKED, Interrupted

Kept = TypeVar("Kept")

ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""Signals that interrupt a command."""


class Signals:
    """A context in which signals interrupt the main thread as Ctrl-C does."""

    def __init__(self):
        self.code: int | None = None
        """Exit code after the last signal: 128 and its number, as in shells; None without a signal."""
        self._before: dict[int, Callable[..., object] | int | None] = {}

    def __enter__(self) -> "Signals":
        # Python allows only the main thread to set handlers
        if threading.current_thread() is threading.main_thread():
            for number in ENDING:
                # signals that the caller ignores, as nohup does, stay ignored
                if signal.getsignal(number) not in (signal.SIG_IGN, None):
                    self._before[number] = signal.signal(number, self._interrupt)
            self._hook = sys.unraisablehook
            sys.unraisablehook = self._unraisable
        return self

    def __exit__(self, *_: object) -> None:
        # restore the caller's handlers
        for number, handler in self._before.items():
            signal.signal(number, handler)
        if self._before:
            sys.unraisablehook = self._hook
        ASKED.clear()  # for later commands of this process

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        self.code = 128 + number
        ASKED.set()  # in case the exception is lost
        raise KeyboardInterrupt

    def _unraisable(self, event: "sys.UnraisableHookArgs") -> None:
        """Raise again an interrupt that Python lost in a callback, such as JAX's in the garbage collector."""
        if isinstance(event.exc_value, KeyboardInterrupt) and self.code is not None:
            # later and from another thread, because nothing can be raised here
            again = threading.Timer(0.05, os.kill, (os.getpid(), self.code - 128))
            again.daemon = True  # it must not keep the process alive
            again.start()
        else:
            self._hook(event)


def ignore_signals() -> None:
    """Ignore further signals while the process ends, which is soon."""
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)


def leave(code: int) -> None:
    """End the process at once.

    Threads inside XLA cannot be stopped until their call ends. They must not run during the interpreter's shutdown,
    which removes objects that they use.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def on_thread(call: Callable[[], Kept], patience: float = 0.0) -> Kept:
    """Return the result of `call` on another thread, so that the main thread answers signals while XLA works.

    **Arguments:** `patience`: seconds to wait after a signal for a call that then returns a partial result.
    """
    pool = ThreadPoolExecutor(1)
    try:
        # a thread has no context; this thread's context has standard input, and the warnings already given
        future = pool.submit(copy_context().run, call)
        try:
            return future.result()
        except Interrupted:  # raised by the call itself, with its finished part
            raise
        except KeyboardInterrupt:
            # most calls end within half a second; nothing is printed then
            if patience and not wait([future], 0.5).done:
                print(f"waiting at most {patience:g} s for what is being computed", file=sys.stderr)
                wait([future], patience)
            if patience and future.done():
                return future.result()
            raise
    finally:
        pool.shutdown(wait=False)  # no thread waits for a call that continues
