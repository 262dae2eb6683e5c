"""Names and titles of files are text, and pages of other sites are strangers: seen by a real browser."""

from __future__ import annotations

import http.server
import re
import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from jax_aero import places
from jax_aero.view import web
from jax_aero.view.settings import default_config

pytest.importorskip("viser", reason="viser is not installed")
pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")

from tests.browser import CHROMIUM, SLOWEST, open_chromium

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")

ROBOT = places.CONFIGS / "robot/sparrow.toml"
HOSTILE = "<img src=x onerror='window.hasRun = true'>"
TITLE = f"{HOSTILE}</script><!--<script>"


@pytest.fixture(scope="module")
def tab() -> Iterator[Any]:
    with open_chromium() as browser:
        opened = browser.new_page()
        opened.set_default_timeout(SLOWEST)
        yield opened


@pytest.fixture
def hostile(standing: Callable[..., Any], tmp_path: Path) -> Any:
    """A recording whose title and jets are markup."""
    shutil.copy(ROBOT.with_suffix(".urdf"), tmp_path)
    path = tmp_path / "sparrow.toml"
    path.write_text(re.sub(r'name = "(\w+_jet)"', rf'name = "{HOSTILE} \1"', ROBOT.read_text()))
    found = standing(path, TITLE)
    assert all(name.startswith(HOSTILE) for name in found.robot.jet_names)
    return replace(found, outcome="fell", lost_time=1.0, lost_reason=HOSTILE)


def test_markup_is_text_in_the_page_and_others_read_nothing(tab, hostile):
    from jax_aero.view.page import Page

    served = Page([hostile, replace(hostile)], default_config(), port=0)
    try:
        tab.goto(served.url)
        tab.locator(".outcome").first.wait_for()
        assert tab.get_by_text(HOSTILE).count() >= 2 + 2 + len(hostile.robot.jet_names)  # titles, reasons, jets
        served.signal.value = "thrust"
        tab.wait_for_timeout(300)  # in which a picture that is not there would have failed
        assert tab.evaluate("window.hasRun") is None
        with other_site() as url:
            tab.goto(url)
            connect = """url => new Promise(done => {
                const socket = new WebSocket(url);
                socket.onopen = () => done("open");
                socket.onerror = () => done("refused");
            })"""
            assert tab.evaluate(connect, served.url.replace("http", "ws")) == "refused"
    finally:
        served.close()


@contextmanager
def other_site() -> Iterator[str]:
    """An empty page of another port of this machine."""
    with http.server.HTTPServer(("127.0.0.1", 0), http.server.BaseHTTPRequestHandler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://localhost:{server.server_port}"
        server.shutdown()


def test_an_exported_title_leaves_the_script_whole(tab, hostile, tmp_path, monkeypatch):
    page = (places.HOME / "rust/lab/page/flight.html").read_text()
    page = page.replace("/*SCRIPT*/", "window.title = FLIGHTS.flights[0].title")
    monkeypatch.setattr(web, "TEMPLATE", tmp_path / "template.html")
    web.TEMPLATE.write_text(page)
    web.write_page([hostile], tmp_path / "flight.html")
    tab.goto((tmp_path / "flight.html").as_uri())
    assert tab.evaluate("[window.title, window.hasRun]") == [TITLE, None]
