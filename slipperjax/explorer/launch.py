"""The server of a page: on the loopback address, in a thread of this process, for those who know its address."""

import asyncio
import functools
import secrets
import socket
import threading
import time
import webbrowser
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

from ..tools.checks import require
from .session import Session

ADDRESS = "127.0.0.1"
LOOK = 0.2
"""Seconds between two looks whether a browser shows the page."""
LEFT = 2000
"""Milliseconds after which the computations of a window that was closed end."""
STARTING = 30.0
"""Seconds that the server may take to start or stop."""
HEIGHT = 1150
"""Of the page in a notebook [pixels]."""
BROWSER = "slipperjax_browser"
"""Cookie, or argument of an address, by which windows of one browser are known."""
REMEMBER = "document.cookie = `${name}=${value}; path=${location.pathname}; SameSite=Strict`"
"""Sets this cookie, in the browser."""


class Explorer:
    """A page that is served until `stop()` or the end of the process; in a notebook it shows itself.

    Its address holds a random secret, and other programs and users of the machine get nothing without it.
    """

    def __init__(self, session: Session, port: int = 0):
        """**Raises:** `ImportError` without Bokeh; `OSError` where the port is in use; `ValueError` for no port."""
        try:
            from bokeh.server.server import BaseServer
        except ImportError:
            raise ImportError('The page needs Bokeh: pip install "slipperjax[explore]"') from None
        from tornado.httpserver import HTTPServer
        from tornado.ioloop import IOLoop

        good = isinstance(port, int) and not isinstance(port, bool) and 0 <= port < 1 << 16
        require(good, "port", "be a whole number of 0 to 65535", port)
        try:
            listener = socket.create_server((ADDRESS, port))
        except OSError as error:
            raise OSError(f"Argument `port` must be one that is free, but is {port}: {error.strerror}") from None
        listener.setblocking(False)
        self.port = listener.getsockname()[1]
        self._first, self._pages, started = session, [], threading.Event()
        self._latest: dict[str, Session] = {}
        """What was changed last, by browser."""
        self._secret = secrets.token_urlsafe()

        def serve() -> None:
            asyncio.set_event_loop(asyncio.new_event_loop())
            self._loop = IOLoop.current()
            pages = _application(self._open, self._secret, {f"{name}:{self.port}" for name in (ADDRESS, "localhost")})
            self._http = HTTPServer(pages)
            self._http.add_socket(listener)
            self._server = BaseServer(self._loop, pages, self._http)
            self._server.start()
            started.set()
            self._loop.start()
            self._loop.close()

        self._thread = threading.Thread(target=serve, daemon=True)
        self._thread.start()
        if not started.wait(STARTING):
            raise OSError(f"the server of the page did not start at port {port}")

    @property
    def url(self) -> str:
        """Its address, whose secret lets in whoever knows it."""
        return f"http://{ADDRESS}:{self.port}/{self._secret}/"

    def open_browser(self) -> None:
        """Opens a browser, and returns when it shows the page or does not within `STARTING`.

        It is led there by a file that only this user can read, and that is deleted then: every user of the machine
        sees with which address a browser was started.
        """
        page = f'<!doctype html><meta http-equiv="refresh" content="0; url={self.url}"><title>slipperjax</title>'
        # in the home: browsers in a sandbox see neither the usual folder of temporary files nor hidden ones
        with NamedTemporaryFile("w", prefix="slipperjax-", suffix=".html", dir=Path.home()) as file:
            file.write(page)
            file.flush()
            webbrowser.open(Path(file.name).as_uri())
            latest = time.monotonic() + STARTING
            while not self._pages and time.monotonic() < latest:
                time.sleep(LOOK)

    def _open(self, doc: Any) -> None:
        """Fills the document of a new window, which goes on where the latest one of its browser is."""
        from bokeh.events import DocumentReady
        from bokeh.models import CustomJS

        from .page import Page

        request = doc.session_context.request
        named = request.arguments.get(BROWSER) or [request.cookies.get(BROWSER) or secrets.token_urlsafe()]
        browser = str(named[0])
        keep = functools.partial(self._latest.__setitem__, browser)
        page = Page(doc, self._latest.get(browser, self._first).copied(), keep)
        doc.js_on_event(DocumentReady, CustomJS(args=dict(name=BROWSER, value=browser), code=REMEMBER))
        self._pages.append(page)

        def left(context: Any) -> None:
            page.close()
            self._pages.remove(page)

        doc.on_session_destroyed(left)

    @property
    def windows(self) -> int:
        """How many windows show it."""
        return len(self._pages)

    def stop(self) -> None:
        """Ends computations and server."""
        for page in self._pages:
            page.close()

        async def end() -> None:
            self._server.stop(wait=False)  # for tasks of this loop, which ends
            await self._http.close_all_connections()
            self._loop.stop()

        if self._thread.is_alive():
            self._loop.add_callback(end)
            self._thread.join(STARTING)

    def _repr_html_(self) -> str:
        # frames in pages of other addresses keep no cookies
        source = f"{self.url}?{BROWSER}=notebook"
        return f'<iframe src="{source}" width="100%" height="{HEIGHT}" style="border:0"></iframe>'

    def __repr__(self) -> str:
        return f"Explorer({self.url})"


def _application(fill: Callable[[Any], None], secret: str, hosts: Collection[str]) -> Any:
    """Returns the application that serves pages.

    Whoever asks for another host than one of `hosts`, as a page does whose name was made to mean this address, or
    opens a socket from the page of another host or of none, is answered 403, and who does not know the secret 404.

    **Arguments:** `fill`: fills the document of a new window; `hosts`: each with its port.
    """
    from bokeh.server.tornado import BokehTornado
    from tornado.web import ErrorHandler

    origins = {f"http://{host}" for host in hosts}

    class Pages(BokehTornado):
        def find_handler(self, request: Any, **more: Any) -> Any:
            origin, upgrade = (request.headers.get(name) for name in ("Origin", "Upgrade"))
            if request.host.lower() in hosts and (origin in origins or (origin is None and upgrade is None)):
                return super().find_handler(request, **more)
            return self.get_handler_delegate(request, ErrorHandler, {"status_code": 403})

    ends: dict[str, Any] = dict(unused_session_lifetime_milliseconds=LEFT)
    ends["check_unused_sessions_milliseconds"] = LEFT // 2
    return Pages({"/": fill}, prefix=secret, extra_websocket_origins=list(hosts), **ends)


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
