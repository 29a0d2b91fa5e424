"""The page in a real browser. All of it, with its screenshots and times:

SLIPPERJAX_SCREENSHOTS=shots python -m pytest -m slow -s tests/explorer/test_browser.py
"""

import contextlib
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import slipperjax as sj

pytestmark = pytest.mark.slow
BROWSER = os.environ.get("SLIPPERJAX_BROWSER") or shutil.which("chromium") or shutil.which("google-chrome")
WAIT = 240_000
"""Milliseconds that a program may take to compile."""
# places in the page: models have views, and views have scales
PLACE = """([name, x, y]) => {
  const view = Bokeh.index.find_one(Bokeh.documents[0].get_model_by_name(name)), frame = view.frame
  const box = view.el.getBoundingClientRect()
  return [box.x + frame.x_scale.compute(x), box.y + frame.y_scale.compute(y)]
}"""


CASE_CHANGED = "(old) => Bokeh.documents[0].get_model_by_name('case').text != old"


COMPUTED = "!Bokeh.documents[0].get_model_by_name('line').text.includes('computing')"


@pytest.fixture(scope="module")
def browser():
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    pytest.importorskip("bokeh", reason="needs bokeh")
    if BROWSER is None:
        pytest.skip("no Chromium here; its path may be given as SLIPPERJAX_BROWSER")
    with playwright.sync_playwright() as driver:
        # every name but the loopback address is unknown, as without a network
        options = ["--no-sandbox", "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"]
        browser = driver.chromium.launch(executable_path=BROWSER, args=options)
        yield browser
        browser.close()


@contextlib.contextmanager
def serving(*arguments):
    """The command's process, and the address that it prints."""
    code = "import sys; sys.argv = ['slipperjax', *sys.argv[1:]]; from slipperjax_command import main; main()"
    command = [sys.executable, "-c", code, "explore", "--no-browser", *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            yield process, process.stdout.readline().split()[0]
        finally:
            process.send_signal(signal.SIGINT)
            code = process.wait(20)
    assert code == 130


class Window:
    """A window of the browser, with all that went wrong in it."""

    def __init__(self, browser, url):
        self.wrong, self.asked = [], []
        self.context = browser.new_context(viewport={"width": 1300, "height": 1200}, accept_downloads=True)
        self.context.grant_permissions(["clipboard-read", "clipboard-write"])
        self.page = page = self.context.new_page()
        page.on("console", lambda m: self.wrong.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda error: self.wrong.append(str(error)))
        page.on("request", lambda request: self.asked.append(request.url))
        page.goto(url)
        page.wait_for_function("window.Bokeh && Bokeh.documents.length && Bokeh.index.roots.length", timeout=WAIT)

    def shoot(self, name):
        if folder := os.environ.get("SLIPPERJAX_SCREENSHOTS"):
            Path(folder).mkdir(parents=True, exist_ok=True)
            self.page.screenshot(path=Path(folder) / f"{name}.png")

    def place(self, name, x, y):
        return self.page.evaluate(PLACE, [name, x, y])

    def click(self, x, y, name="map"):
        self.page.mouse.click(*self.place(name, x, y))

    def look(self, x, y, name="map"):
        """Clicks, and gives the seconds until the picture is there."""
        before, began = self.model("case", "text"), time.perf_counter()
        self.click(x, y, name)
        self.page.wait_for_function(CASE_CHANGED, arg=before, polling="raf", timeout=WAIT)
        self.page.evaluate("new Promise((r) => requestAnimationFrame(() => requestAnimationFrame(r)))")
        return time.perf_counter() - began

    def drag(self, x0, y0, x1, y1):
        self.page.mouse.move(*self.place("map", x0, y0))
        self.page.mouse.down()
        self.page.mouse.move(*self.place("map", (x0 + x1) / 2, (y0 + y1) / 2))
        self.page.mouse.move(*self.place("map", x1, y1))
        self.page.mouse.up()

    def model(self, name, what):
        return self.page.evaluate(f"Bokeh.documents[0].get_model_by_name('{name}').{what}")

    def wait(self, text, timeout=WAIT):
        self.page.get_by_text(text).first.wait_for(timeout=timeout)

    def ready(self):
        self.wait("Click a point")

    def press(self, label):
        self.page.get_by_role("button", name=label, exact=True).click()

    def close(self):
        assert self.wrong == []
        assert {
            re.match(r"\w+://([\d.]+):", url)[1] for url in self.asked if not url.startswith(("data", "blob"))
        } == {"127.0.0.1"}
        self.context.close()


def run_copied(window, folder):
    """Runs the script in the clipboard, and gives the highest force of its `run` [kN]."""
    script = window.page.evaluate("navigator.clipboard.readText()")
    lines = ["import matplotlib; matplotlib.use('Agg')", script, "print(float(run.peak.force) / 1e3)"]
    (folder / "copied.py").write_text("\n".join(lines))
    done = subprocess.run([sys.executable, folder / "copied.py"], capture_output=True, text=True, check=True)
    return done.stdout


def peak_of(window):
    """The highest force that the page states [kN]."""
    return float(re.search(r"highest force ([\d.]+) kN", window.model("case", "text"))[1])


def test_a_map_is_computed_clicked_and_refined(browser, tmp_path):
    began = time.perf_counter()
    with serving() as (process, url):
        window = Window(browser, url)
        print(f"\nfirst page after {time.perf_counter() - began:.2f} s")
        window.shoot("1_first")
        window.ready()
        window.wait("period 1")
        for name in ("first", "warm"):
            times = []
            for k in range(20):
                times.append(window.look(300 + 100 * k, 0.5 + 0.3 * (k % 5)))
                window.ready()
            shown = f"median {np.median(times):.2f} s, 95th percentile {np.percentile(times, 95):.2f} s"
            print(f"click to picture, {name}: {shown}")
        window.ready()
        window.shoot("3_clicked")
        # a slider
        handle = window.page.locator(".noUi-handle").first
        handle.focus()
        before = window.model("case", "text")
        for _ in range(5):
            window.page.keyboard.press("ArrowRight")
        window.page.wait_for_function(CASE_CHANGED, arg=before)
        window.ready()
        # a box, and back
        wide = window.model("map", "x_range.end")
        t = time.perf_counter()
        window.drag(900, 0.5, 1500, 2.0)
        window.page.wait_for_function(f"Bokeh.documents[0].get_model_by_name('map').x_range.end < {wide}")
        window.page.wait_for_function(COMPUTED, timeout=WAIT)
        print(f"a box of 400 cases took {time.perf_counter() - t:.2f} s")
        window.ready()
        window.press("Back")
        window.page.wait_for_function(f"Bokeh.documents[0].get_model_by_name('map').x_range.end == {wide}")
        # stop
        window.drag(600, 0.5, 2300, 3.9)
        window.press("Stop")
        window.wait("stopped")
        window.press("Back")
        window.ready()
        # what was copied runs, and gives the same
        window.look(1250, 1.0)
        window.ready()
        window.press("Copy as Python")
        assert float(run_copied(window, tmp_path)) == pytest.approx(peak_of(window), rel=1e-2)
        with window.page.expect_download() as download:
            window.press("Save scene")
        download.value.save_as(tmp_path / "scene.toml")
        assert "speed" in (tmp_path / "scene.toml").read_text()
        assert sj.load(tmp_path / "scene.toml").scene.value("clearance") == pytest.approx(1e-3, rel=0.2)
        # another window does not disturb this one
        before = window.model("case", "text")
        other = Window(browser, url)
        other.ready()
        other.look(2000, 0.5)
        assert window.model("case", "text") == before
        other.close()
        window.close()
        again = Window(browser, url)  # after the browser was closed
        again.wait("period 1")
        again.close()
        assert process.poll() is None


def test_a_store_grows_and_is_seen_to(browser, tmp_path):
    grid = {"clearance": np.linspace(5e-4, 2e-3, 4), "speed": np.linspace(1000.0, 1900.0, 6)}
    fill = lambda share: sj.sweep(
        sj.paper_scene(),
        grid,
        record=["motion", "peak_force"],
        periods=200,
        store=sj.sweeps.Store(path, tile=6, share=share),
    )
    path = tmp_path / "map.zarr"
    fill((1, 2))
    with serving(path) as (_, url):
        window = Window(browser, url)
        window.wait("not computed yet")
        window.ready()
        fill((2, 2))
        window.page.get_by_text("not computed yet").wait_for(state="hidden", timeout=WAIT)
        window.page.locator("select").first.select_option("peak_force")
        window.wait("Colours: highest normal force of a contact point")
        window.look(1300, 1.5)
        window.ready()
        window.close()


def test_a_diagram_is_computed_and_refined(browser):
    with serving("--over", "speed", "1100", "1500", "60") as (_, url):
        window = Window(browser, url)
        window.wait("highest force")
        window.page.wait_for_function(COMPUTED, timeout=WAIT)
        low, high = (window.model("map", f"y_range.{end}") for end in ("start", "end"))
        window.look(1200, (low + high) / 2)
        window.ready()
        window.drag(1150, 0.3 * low + 0.7 * high, 1200, 0.7 * low + 0.3 * high)
        window.page.wait_for_function("Bokeh.documents[0].get_model_by_name('map').x_range.end < 1300")
        window.page.wait_for_function(COMPUTED, timeout=WAIT)
        window.close()


def test_a_run_shows_its_windows_and_parts_of_it_finer(browser, tmp_path):
    speed = sj.SpeedProgramme.stages([sj.Stage(250.0, speed=300.0)], start=100.0)
    ds = sj.run(sj.paper_scene(), length=250.0, speed=speed)
    ds.to_netcdf(tmp_path / "run.nc", engine="h5netcdf")
    force = ds["peak_force"].max(("end", "point"))
    highest = float(ds["distance"][force.values.argmax()])
    with serving(tmp_path / "run.nc") as (_, url):
        window = Window(browser, url)
        window.wait(f"{highest - 1:g} to {highest:g} m", WAIT)  # where the force is highest
        assert f"{float(force.max()) / 1e3:.3g} kN" in window.model("case", "text")
        window.ready()
        window.look(149.5, 1.0)
        window.wait("149 to 150 m")
        window.ready()
        # nearer
        window.drag(120, 0.5, 130, 1.0)
        window.page.wait_for_function("Bokeh.documents[0].get_model_by_name('map').x_range.end < 131")
        window.look(125.0, 1.0)
        window.press("Copy as Python")
        assert float(run_copied(window, tmp_path)) == pytest.approx(peak_of(window), rel=1e-2)
        window.page.locator("select").first.select_option("impacts")
        window.page.wait_for_function("Bokeh.documents[0].get_model_by_name('map').below")
        window.close()


@contextlib.contextmanager
def shown(browser, *arguments):
    """A window on a page of this process."""
    page = sj.explore(*arguments)
    window = Window(browser, page.url)
    try:
        window.wait("highest force")
        yield window
        window.close()
    finally:
        page.stop()


def cross(window):
    """Where the cross on the map is."""
    window.page.wait_for_function("Bokeh.documents[0].get_model_by_name('cross').data_source.data.x.length")
    return [window.model("cross", f"data_source.data.{axis}[0]") for axis in "xy"]


def test_a_map_with_uneven_values_is_clicked(browser):
    speed = np.geomspace(200.0, 2000.0, 5)
    ds = sj.sweep(
        sj.paper_scene(), {"clearance": np.array([1e-3, 2e-3]), "speed": speed}, record="motion", periods=200
    )
    with shown(browser, ds) as window:
        for k in (0, 3):
            window.look(speed[k] * 1.02, 1.1)
            assert cross(window) == pytest.approx([speed[k], 1.0])
        window.ready()
        window.press("Play")
        window.page.get_by_role("button", name="Pause").wait_for()
        window.press("Pause")


def test_a_notebook_shows_the_page(browser, tmp_path):
    pytest.importorskip("jupyterlab", reason="needs the extra notebook")
    code = 'import slipperjax as sj\nsj.explore(sj.paper_scene(), {"clearance": [1e-3, 2e-3], "speed": [1e3, 1.5e3]})'
    cell = {"cell_type": "code", "source": code, "metadata": {}, "outputs": [], "execution_count": None, "id": "one"}
    kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3"}}
    notebook = {"cells": [cell], "metadata": kernel, "nbformat": 4, "nbformat_minor": 5}
    (tmp_path / "page.ipynb").write_text(json.dumps(notebook))
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    options = ["--no-browser", "--allow-root", f"--port={port}", "--ip=127.0.0.1", "--IdentityProvider.token=secret"]
    command = [sys.executable, "-m", "jupyterlab", *options, f"--notebook-dir={tmp_path}"]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        try:
            page = browser.new_page(viewport={"width": 1400, "height": 1300})
            for _ in range(60):
                with contextlib.suppress(Exception):
                    page.goto(f"http://127.0.0.1:{port}/lab/tree/page.ipynb?token=secret")
                    break
                time.sleep(1.0)
            page.locator(".jp-CodeCell").first.click(timeout=WAIT)
            page.keyboard.press("Shift+Enter")
            frame = page.frame_locator("iframe[src^='http://127.0.0.1']")
            frame.get_by_text("highest force").first.wait_for(timeout=WAIT)
            frame.get_by_text("period 1").first.wait_for(timeout=WAIT)
            if folder := os.environ.get("SLIPPERJAX_SCREENSHOTS"):
                page.screenshot(path=Path(folder) / "12_notebook.png")
            page.close()
        finally:
            process.terminate()
