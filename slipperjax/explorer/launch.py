"""The server of a page: a thread of this process, at the loopback address, for users who know the page's secret."""

import asyncio
import dataclasses
import secrets
import socket
import threading
import webbrowser
from collections.abc import Mapping
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import TYPE_CHECKING

from ..tools.checks import require
from ..tools.types import Numbers
from .session import Session, Source, Start
from .worker import Worker

if TYPE_CHECKING:
    from bokeh.document import Document

ADDRESS = "127.0.0.1"


class Explorer:
    """A page that is served until `stop()` or the end of the process; in a notebook it shows itself.

    Its address contains a random secret; other programs and users of the machine get nothing without the secret.
    """

    def __init__(self, session: Session, port: int = 0):
        """**Raises:** `ImportError` without Bokeh; `OSError` where the port is in use; `ValueError` for no port."""
        try:
            from bokeh.server.server import BaseServer
        except ImportError:
            raise ImportError('The page needs Bokeh: pip install "slipperjax[explore]"') from None
        from bokeh.server.tornado import BokehTornado
        from tornado.httpserver import HTTPServer
        from tornado.ioloop import IOLoop

        good = isinstance(port, int) and not isinstance(port, bool) and 0 <= port < 1 << 16
        require(good, "port", "be a whole number of 0 to 65535", port)
        # made here, so that a port in use raises an error in this call
        try:
            listener = socket.create_server((ADDRESS, port))
        except OSError as error:
            raise OSError(f"Argument `port` must be one that is free, but is {port}: {error.strerror}") from None
        listener.setblocking(False)
        self.port = listener.getsockname()[1]
        self._session = session
        self._secret = secrets.token_urlsafe()
        self._opened = threading.Event()
        self._workers: list[Worker] = []
        started = threading.Event()

        # all in one thread, because loops of asyncio and tornado belong to the thread that made them
        def serve() -> None:
            asyncio.set_event_loop(asyncio.new_event_loop())
            self._loop = IOLoop.current()
            # sockets are opened only for pages of these hosts, and computations end soon after their window is closed
            pages = BokehTornado(
                {"/": self._open},
                prefix=self._secret,
                extra_websocket_origins=[f"{host}:{self.port}" for host in (ADDRESS, "localhost")],
                unused_session_lifetime_milliseconds=2000,
                check_unused_sessions_milliseconds=1000,
            )
            self._http = HTTPServer(pages)
            self._http.add_socket(listener)
            self._server = BaseServer(self._loop, pages, self._http)
            self._server.start()
            started.set()
            self._loop.start()
            self._loop.close()

        self._thread = threading.Thread(target=serve, daemon=True)
        self._thread.start()
        if not started.wait(30.0):
            raise OSError(f"the server of the page did not start at port {port}")

    @property
    def url(self) -> str:
        """Address of the page, with the secret that opens it."""
        return f"http://{ADDRESS}:{self.port}/{self._secret}/"

    def open_browser(self) -> None:
        """Open a browser, and return when it shows the page, or after half a minute.

        The browser opens a file that leads to the page. Only this user can read the file, which is deleted
        afterwards; every user of the machine can see the address with which a browser was started.
        """
        page = f'<!doctype html><meta http-equiv="refresh" content="0; url={self.url}"><title>slipperjax</title>'
        # in the home folder, because a browser in a sandbox sees neither the usual temporary folder nor hidden files
        with NamedTemporaryFile("w", prefix="slipperjax-", suffix=".html", dir=Path.home()) as file:
            file.write(page)
            file.flush()
            webbrowser.open(Path(file.name).as_uri())
            self._opened.wait(30.0)

    def _open(self, doc: "Document") -> None:
        """Fill the document of a new window."""
        from .page import Page

        # windows share the given arguments, and nothing that changes
        session = dataclasses.replace(self._session, views=[*self._session.views])
        worker = Page(doc, session).worker
        self._workers.append(worker)
        doc.on_session_destroyed(lambda context: worker.close())
        self._opened.set()

    def stop(self) -> None:
        """End computations and server."""
        for worker in self._workers:
            worker.close()

        async def end() -> None:
            self._server.stop(wait=False)  # for tasks of this loop, which ends
            await self._http.close_all_connections()
            self._loop.stop()

        # only in this way do loops take calls of other threads
        if self._thread.is_alive():
            self._loop.add_callback(end)
            self._thread.join(30.0)

    def _repr_html_(self) -> str:
        return f'<iframe src="{self.url}" width="100%" height="1150" style="border:0"></iframe>'

    def __repr__(self) -> str:
        return f"Explorer({self.url})"


def explore(
    source: Source | None = None,
    grid: Mapping[str, Numbers] | None = None,
    *,
    start: Start = None,
    port: int = 0,
) -> Explorer:
    """Serve a page on which a click on a point of a map shows the motion of this slipper.

    ```python
    sj.explore()  # in a notebook it is shown; elsewhere open its `url`
    sj.explore("map.zarr")
    sj.explore(scene, {"clearance": np.linspace(2e-4, 3e-3, 16), "speed": np.linspace(500.0, 2000.0, 25)})
    ```

    **Arguments:** `source`: a dataset of `sweep`, `lyapunov_sweep`, `follow` or `run`, its netCDF file or its store,
    which may still grow; or a scene or its TOML file, by default `paper_scene()`. `grid`: values of one or two
    parameters of the scene, which are computed where `source` has no results; the first is drawn upwards. `start`: as
    for `sweep`; `port`: 0 for a free port.

    **Returns:** an `Explorer`. This process serves it at the loopback address, without a network.

    **Raises:** `ValueError` that names the wrong argument; `OSError` for a file that cannot be read, or a port in
    use; `ImportError` without Bokeh.
    """
    return Explorer(Session.of(source, grid, start=start), port)
