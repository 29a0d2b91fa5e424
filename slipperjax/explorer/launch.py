"""The server of a page: on the loopback address, in a thread of this process, with nothing from outside."""

import asyncio
import socket
import threading
from collections.abc import Mapping
from typing import Any

from .session import Session

ADDRESS = "127.0.0.1"
LEFT = 2000
"""Milliseconds after which the computations of a window that was closed end."""
STARTING = 30.0
"""Seconds that the server may take to start or stop."""
HEIGHT = 1150
"""Of the page in a notebook [pixels]."""


class Explorer:
    """A page that is served until `stop()` or the end of the process; in a notebook it shows itself."""

    def __init__(self, session: Session, port: int = 0):
        """**Raises:** `ImportError` without Bokeh; `OSError` where the port is in use."""
        try:
            from bokeh.server.server import Server
        except ImportError:
            raise ImportError('The page needs Bokeh: pip install "slipperjax[explore]"') from None
        self._latest, self._pages, started = session, [], threading.Event()
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # as the server's own
            try:
                probe.bind((ADDRESS, port))
            except OSError as error:
                raise OSError(f"Argument `port` must be one that is free, but is {port}: {error.strerror}") from None

        def serve() -> None:
            from tornado.ioloop import IOLoop

            asyncio.set_event_loop(asyncio.new_event_loop())
            self._loop = IOLoop.current()
            ends: dict[str, Any] = dict(unused_session_lifetime_milliseconds=LEFT)
            ends["check_unused_sessions_milliseconds"] = LEFT // 2
            self._server = Server({"/": self._open}, io_loop=self._loop, address=ADDRESS, port=port, **ends)
            self._server.start()
            self.port = self._server.port
            started.set()
            self._loop.start()
            self._loop.close()

        self._thread = threading.Thread(target=serve, daemon=True)
        self._thread.start()
        if not started.wait(STARTING):
            raise OSError(f"the server of the page did not start at port {port}")

    @property
    def url(self) -> str:
        """Its address."""
        return f"http://{ADDRESS}:{self.port}/"

    def _open(self, doc: Any) -> None:
        """Fills the document of a new window, which goes on where the latest one is."""
        from .page import Page

        page = Page(doc, self._latest.copied(), self._keep)
        self._pages.append(page)

        def left(context: Any) -> None:
            page.close()
            self._pages.remove(page)

        doc.on_session_destroyed(left)

    @property
    def windows(self) -> int:
        """How many windows show it."""
        return len(self._pages)

    def _keep(self, session: Session) -> None:
        self._latest = session

    def stop(self) -> None:
        """Ends computations and server."""
        for page in self._pages:
            page.close()

        def end() -> None:
            self._server.stop()
            self._loop.stop()

        if self._thread.is_alive():
            self._loop.add_callback(end)
            self._thread.join(STARTING)

    def _repr_html_(self) -> str:
        return f'<iframe src="{self.url}" width="100%" height="{HEIGHT}" style="border:0"></iframe>'

    def __repr__(self) -> str:
        return f"Explorer({self.url})"


def explore(
    source: Any = None, grid: Mapping[str, Any] | None = None, *, start: Any = None, port: int = 0
) -> Explorer:
    """Serves a page on which clicking a point of a map shows how that slipper moves.

    ```python
    sj.explore()  # in a notebook it is shown; elsewhere open its `url`
    sj.explore("map.zarr")
    sj.explore(scene, {"clearance": np.linspace(2e-4, 3e-3, 16), "speed": np.linspace(500.0, 2000.0, 25)})
    ```

    **Arguments:** `source`: a dataset of `sweep`, `lyapunov_sweep`, `follow` or `run`, a netCDF file or a store of
    one, which may still grow, or a scene or its TOML file, by default `paper_scene()`; `grid`: values of one or two
    parameters, as for `sweep`, of what is computed where `source` has none, the first drawn upwards; `start`: as for
    `sweep`; `port`: 0 for one that is free.

    **Returns:** an `Explorer`. It is served at the loopback address by this process, and needs no network.

    **Raises:** `ValueError` that names the argument which is wrong; `OSError` for a file that cannot be read, or a
    port in use; `ImportError` without Bokeh.
    """
    return Explorer(Session.of(source, grid, start=start), port)
