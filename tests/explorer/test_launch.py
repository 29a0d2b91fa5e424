"""The server of a page, and errors of its command in one line."""

import re
import socket
import urllib.error
import urllib.request

import pytest

import slipperjax as sj
from slipperjax.explorer.session import Session

from ..cli.commands import error_of

pytest.importorskip("bokeh", reason="needs the extra explore")
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
        assert address.startswith(("/static/", "data:")), address
        if address.startswith("/static/"):
            with urllib.request.urlopen(page.url + address[1:]) as answer:
                assert answer.status == 200
    assert not re.search(r"https?://(?!127\.0\.0\.1|www\.w3\.org)", text)
    assert page.url in page._repr_html_()


def test_a_stopped_page_is_gone():
    page = sj.explore(sj.paper_scene(), GRID)
    urllib.request.urlopen(page.url).close()
    page.stop()
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(page.url, timeout=5)


def test_a_port_in_use_is_named(page, capsys):
    with pytest.raises(OSError, match=f"`port` must be one that is free, but is {page.port}"):
        sj.explore(sj.paper_scene(), GRID, port=page.port)
    assert str(page.port) in error_of(["explore", "--no-browser", "--port", page.port], capsys)


def test_a_missing_extra_is_named(capsys, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "bokeh.server.server", None)
    assert 'pip install "slipperjax[explore]"' in error_of(["explore", "--no-browser"], capsys)


def test_bad_sources_are_one_line(capsys, tmp_path):
    (tmp_path / "text.nc").write_text("no file of ours")
    (tmp_path / "empty.zarr").mkdir()
    for source in ("none.zarr", "none.nc", "none.toml", "text.nc", "empty.zarr"):
        assert source in error_of(["explore", "--no-browser", tmp_path / source], capsys)
    assert "--by needs --over" in error_of(["explore", "--by", "speed", "1", "2", "3"], capsys)


def test_another_window_goes_on_where_the_latest_is():
    from bokeh.document import Document

    from slipperjax.explorer.page import Page

    kept = [Session.of(sj.paper_scene(), GRID)]
    one, other = (Page(Document(), kept[-1].copied(), kept.append) for _ in range(2))
    one.session.show(one.session.box((1e-3, 2e-3), (1100.0, 1300.0)))
    one._show_view()
    later = Page(Document(), kept[-1].copied(), kept.append)
    assert [len(page.session.views) for page in (one, other, later)] == [2, 1, 2]
    assert later.session.view is one.session.view
    for page in (one, other, later):
        page.close()


def test_the_port_is_bound_at_the_loopback_address_only(page):
    with socket.socket() as probe:
        probe.bind(("127.0.0.2", page.port))  # which a server at all addresses would hold
