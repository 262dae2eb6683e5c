"""Names and titles of files are text: seen by a real browser."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from jax_aero.base import places
from jax_aero.view import web

pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: make setup")

from tests.browser import CHROMIUM, SLOWEST

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed: apt-get install chromium")

ROBOT = places.CONFIGS / "robot/sparrow.toml"
HOSTILE = "<img src=x onerror='window.hasRun = true'>"
TITLE = f"{HOSTILE}</script><!--<script>"


@pytest.fixture(scope="module")
def tab(browser: Any) -> Any:
    opened = browser.new_page()
    opened.set_default_timeout(SLOWEST)
    return opened


@pytest.fixture
def hostile(standing: Callable[..., Any], tmp_path: Path) -> Any:
    """A recording whose title and jets are markup."""
    shutil.copy(ROBOT.with_suffix(".urdf"), tmp_path)
    path = tmp_path / "sparrow.toml"
    path.write_text(re.sub(r'name = "(\w+_jet)"', rf'name = "{HOSTILE} \1"', ROBOT.read_text()))
    found = standing(path, TITLE)
    assert all(name.startswith(HOSTILE) for name in found.robot.jet_names)
    return replace(found, outcome="fell", lost_time=1.0, lost_reason=HOSTILE)


def test_markup_is_text_in_the_page(tab, hostile, built, tmp_path):
    web.write_page([hostile, replace(hostile)], tmp_path / "flight.html")
    tab.goto((tmp_path / "flight.html").as_uri())
    tab.wait_for_function("window.page && document.querySelector('#figures').textContent")
    assert tab.get_by_text(HOSTILE).count() >= 2 + 2 + len(hostile.robot.jet_names)  # titles, reasons, jets
    tab.wait_for_timeout(300)  # in which a picture that is not there would have failed
    assert tab.evaluate("window.hasRun") is None


def test_an_exported_title_leaves_the_script_whole(tab, hostile, tmp_path, monkeypatch):
    page = (places.HOME / "rust/lab/page/index.html").read_text()
    read = "window.title = JSON.parse(document.querySelector('#data').textContent).flights[0].title"
    page = page.replace("/*SCRIPT*/", read)
    monkeypatch.setattr(web, "TEMPLATE", tmp_path / "template.html")
    web.TEMPLATE.write_text(page)
    web.write_page([hostile], tmp_path / "flight.html")
    tab.goto((tmp_path / "flight.html").as_uri())
    assert tab.evaluate("[window.title, window.hasRun]") == [TITLE, None]
