"""The server of a page, and errors of its command in one line."""

import dataclasses
import html
import http.client
import re
import socket
import urllib.error
import urllib.parse
import urllib.request
from pathlib import Path
from types import SimpleNamespace

import pytest

import slipperjax as sj
from slipperjax.explorer.session import Case, Session

from ..cli.commands import error_of

pytest.importorskip("bokeh", reason="needs the extra explore")
IMAGE = "<img src=x onerror='alert(1)'>"
GRID = {"clearance": [1e-3, 2e-3], "speed": [1000.0, 1500.0]}


@pytest.fixture
def page():
    page = sj.explore(sj.paper_scene(), GRID)
    yield page
    page.stop()


def test_a_page_and_all_that_it_loads_are_served_at_the_loopback_address(page):
    with urllib.request.urlopen(page.url) as answer:
        text = answer.read().decode()
    loaded = re.findall(r'(?:src|href)="([^"]+)"', text)
    assert loaded
    for address in loaded:
        if not address.startswith("data:"):
            assert address.startswith(f"/{page.url.split('/')[3]}/static/"), address
            assert status_of(page, address) == 200
    assert not re.search(r"https?://(?!127\.0\.0\.1|www\.w3\.org)", text)
    assert page.url in page._repr_html_()


def status_of(page, path="", socket=False, **headers):
    """The status of the answer to a request of a page, or of a socket that is asked for."""
    if socket:
        headers |= {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
        headers |= {"Sec-WebSocket-Key": "c2xpcHBlcmpheCBzbGlwcA==", "Sec-WebSocket-Protocol": "bokeh, token"}
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=30)
    connection.request("GET", path or urllib.parse.urlsplit(page.url).path, headers=headers)
    status = connection.getresponse().status
    connection.close()
    return status


def test_whoever_does_not_know_the_address_gets_nothing(page):
    secret = page.url.split("/")[3]
    assert len(secret) >= 32
    for path in ("/", "/ws", "/metadata", "/autoload.js", "/static/js/bokeh.min.js", f"/{secret[:-1]}/", "/none/ws"):
        assert status_of(page, path) == 404, path
        assert status_of(page, path, socket=True, Origin=page.url.rpartition(f"/{secret}")[0]) == 404, path
    other = sj.explore(sj.paper_scene(), GRID)
    assert secret not in other.url
    other.stop()


def test_sockets_from_pages_of_other_hosts_are_refused(page):
    socket = urllib.parse.urlsplit(page.url).path + "ws"
    for host in ("127.0.0.1", "localhost"):
        assert status_of(page, socket, socket=True, Origin=f"http://{host}:{page.port}") == 101
    others = ("http://evil.example", f"http://evil.example:{page.port}", "http://127.0.0.1.evil.example", "null")
    for origin in others:
        assert status_of(page, socket, socket=True, Origin=origin) == 403, origin


def test_the_browser_is_led_by_a_file_of_this_user_alone(page, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    seen = []

    def browse(address):
        file = Path(urllib.request.url2pathname(urllib.parse.urlsplit(address).path))
        seen.append((address, file.read_text(), file.stat().st_mode & 0o777))
        page._opened.set()  # as when the browser shows it

    monkeypatch.setattr("webbrowser.open", browse)
    page.open_browser()
    (address, text, mode), secret = seen[0], page.url.split("/")[3]
    assert secret not in address
    assert f'content="0; url={page.url}"' in text
    assert mode == 0o600
    assert not list(tmp_path.iterdir())


def test_a_port_in_use_is_named_and_bound_at_the_loopback_address_only(page, capsys):
    with pytest.raises(OSError, match=f"`port` must be one that is free, but is {page.port}"):
        sj.explore(sj.paper_scene(), GRID, port=page.port)
    assert str(page.port) in error_of(["explore", "--no-browser", "--port", page.port], capsys)
    with socket.socket() as probe:
        probe.bind(("127.0.0.2", page.port))  # which a server at all addresses would hold


def test_a_missing_extra_is_named(capsys, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "bokeh.server.server", None)
    assert 'pip install "slipperjax[explore]"' in error_of(["explore", "--no-browser"], capsys)


def test_bad_sources_are_one_line(capsys, tmp_path):
    (tmp_path / "text.nc").write_text("no file of ours")
    (tmp_path / "empty.zarr").mkdir()
    for source in ("none.zarr", "none.nc", "none.toml", "text.nc", "empty.zarr"):
        assert source in error_of(["explore", "--no-browser", tmp_path / source], capsys)
    assert "--by needs --over" in error_of(["explore", "--by", "speed", "1", "2", "3"], capsys)


@pytest.mark.parametrize("option", [["--speed", 900], ["--scene", "other.toml"], ["--set", "mass=15"]])
def test_options_of_the_case_are_used_or_refused(capsys, tmp_path, option):
    source = tmp_path / "scene.toml"
    for path in (source, tmp_path / "other.toml"):
        path.write_text(sj.paper_scene().to_toml())
    option = [tmp_path / part if part == "other.toml" else part for part in option]
    text = error_of(["explore", "--no-browser", source, *option], capsys)
    assert "scene.toml must not be given with" in text
    assert option[0] in text
    for name, value in (("--solver", "RK4"), ("--steps-per-period", 100)):
        text = error_of(["explore", "--no-browser", name, value], capsys)
        assert f"Option {name} must not be given" in text


@pytest.mark.parametrize("port", [-1, 65536, "80", 1.5])
def test_what_is_no_port_is_named(port):
    with pytest.raises(ValueError, match="`port` must be a whole number of 0 to 65535, but is"):
        sj.explore(sj.paper_scene(), GRID, port=port)


def test_names_of_points_reach_the_page_as_text():
    from slipperjax.explorer.panels import _words

    scene = sj.paper_scene()
    with pytest.raises(ValueError, match="`names` must be a tuple of names of letters"):
        dataclasses.replace(scene.section, names=(IMAGE, *scene.section.names[1:]))
    object.__setattr__(scene.section, "names", (IMAGE,) * 10)  # as of a file that an older version wrote
    peak = SimpleNamespace(force=1e3, point=0, end=0)
    shown = SimpleNamespace(case=Case(scene), run=SimpleNamespace(status=0, peak=peak), kind="period", period=1)
    assert html.escape(IMAGE) in _words(shown)
    assert IMAGE not in _words(shown)
    # a doubt is told before the force, and a lost motion without it
    shown.run.status = 6
    assert _words(shown).index("inaccurate") < _words(shown).index("highest force")
    shown.run.status = 2
    assert "derailed" in _words(shown)
    assert "highest force" not in _words(shown)


@pytest.mark.full
def test_a_followed_path_is_shown_both_ways():
    from bokeh.document import Document

    from slipperjax.explorer.page import Page

    speeds = [1000.0, 1200.0]
    followed = sj.follow(sj.paper_scene(), {"speed": speeds}, transient=10, periods=10, record="strobe")
    ds = followed.assign(v_z=followed["strobe"].sel(coordinate="v_z").rename(strobe_period="crossing"))
    session = Session.of(ds)
    page = Page(Document(), session)
    page.choice.value = "v_z"
    assert len(page.dots.data["x"]) == ds["v_z"].size
    case = session.case_at(session.nearest(1190.0))
    assert float(case.scene.speed) == 1200.0
    page.worker.close()
