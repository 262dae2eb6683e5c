"""The page in a real browser: it draws, plays, scrubs and flies."""

from __future__ import annotations

import io
import re
import time
import unicodedata
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jax_aero.view import recording
from jax_aero.view.settings import default_config

pytest.importorskip("viser", reason="viser is not installed")
sync_api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")

from tests.browser import CHROMIUM, SLOWEST, SWITCHES  # noqa: E402 - after the skip

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")


class Visit:
    """A page that is served, and a browser that looks at it."""

    def __init__(self, served: Any, tab: Any, complaints: list[str]) -> None:
        self.served, self.tab, self.complaints = served, tab, complaints

    def picture(self) -> np.ndarray:
        """What the scene's canvas shows, (h, w, 3)."""
        from PIL import Image

        size = self.tab.viewport_size
        clip = {"x": 0, "y": 0, "width": size["width"] - 400, "height": size["height"]}
        with Image.open(io.BytesIO(self.tab.screenshot(clip=clip))) as image:
            return np.asarray(image.convert("RGB")).astype(np.int16)

    def _box(self, label: str) -> Any:
        return self.tab.locator(
            f"//label[normalize-space(.)='{label}']/ancestor::*[.//input[@type='text']][1]//input[@type='text']"
        ).first

    def number(self, label: str) -> float:
        """Read the box beside a slider."""
        return float(self._box(label).input_value())

    def set_number(self, label: str, value: str) -> None:
        """Type into the box beside a slider."""
        box = self._box(label)
        box.fill(value)
        box.press("Enter")

    def choose(self, label: str, value: str) -> None:
        """Pick from a list; open it again where the figures of a new flight move it out of sight, which hides it."""
        name = self.tab.locator(f"//label[normalize-space(.)='{label}']").get_attribute("for")
        box = self.tab.locator(f"[id='{name}']")

        def is_picked() -> bool:
            box.click()
            try:
                self.tab.get_by_role("option", name=value, exact=True).click(timeout=3000.0)
            except sync_api.TimeoutError:
                box.press("Escape")
                return False
            return True

        self.wait_for(is_picked, f"`{value}` of the list `{label}`")

    def outcomes(self) -> list[str]:
        return list(self.tab.locator(".outcome").all_inner_texts())

    def wait_for(self, holds: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + SLOWEST / 1000.0
        while not holds():
            assert time.monotonic() < deadline, f"{what} never came; the page says {self.outcomes()}"
            self.tab.wait_for_timeout(100)


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    with sync_api.sync_playwright() as playwright:
        opened = playwright.chromium.launch_persistent_context(
            tmp_path_factory.mktemp("profile"),
            executable_path=CHROMIUM,
            headless=True,
            args=list(SWITCHES),
            viewport={"width": 900, "height": 480},
            timeout=SLOWEST,
        )
        opened.set_default_timeout(SLOWEST)
        yield opened
        opened.close()


@pytest.fixture
def visit(browser: Any) -> Iterator[Callable[..., Visit]]:
    from jax_aero.view.page import Page

    served = []

    def open_page(*results: Path) -> Visit:
        recordings = [recording.read(path) for path in results]
        page = Page(recordings, recordings[0].config if recordings else default_config(), port=0)
        served.append(page)
        tab, complaints = browser.new_page(), []
        tab.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
        tab.on("pageerror", lambda error: complaints.append(str(error)))
        tab.goto(page.url)
        tab.locator(".outcome").first.wait_for()
        return Visit(page, tab, complaints)

    yield open_page
    for tab in browser.pages[1:]:
        tab.close()
    for page in served:
        page.close()


def colours(picture: np.ndarray) -> int:
    return len(np.unique(picture.reshape(-1, 3), axis=0))


FALL = re.compile(r"fell at 2[01]\.\d s")
"""Outcome of TEST1 as published; its last digits hang on rounding."""


def falls_and_completes(outcomes: list[str]) -> bool:
    return len(outcomes) == 2 and FALL.fullmatch(outcomes[0]) is not None and outcomes[1] == "completed"


def has_changed(first: np.ndarray, second: np.ndarray) -> float:
    """Share of pixels that are clearly different."""
    return float((np.abs(first - second).max(axis=-1) > 24).mean())


def test_speeds_are_what_their_buttons_say():
    from jax_aero.view.page import SPEEDS

    assert list(SPEEDS.values()) == [unicodedata.numeric(label[0]) for label in SPEEDS]


def test_the_second_result_is_the_ghost(fallen):
    from jax_aero.view.page import Page

    results = [recording.read(fallen) for _ in range(3)]
    page = Page(results, results[0].config, port=0)
    page.close()
    assert [page.solid, page.ghost, *page.others] == [results[0], results[1], *results[1:]]


def test_what_is_switched_off_stays_off_with_another_ghost(fallen):
    from jax_aero.view.page import NO_GHOST, Page

    results = [recording.read(fallen) for _ in range(2)]
    page = Page(results, results[0].config, port=0)
    for box in (page.show_forces, page.show_plumes, page.show_path):
        box.value = False
    page.compare.value = NO_GHOST
    page.close()
    assert page.ghost is None
    assert not any(node.visible for node in (page.robot.arrows, page.robot.flames, page.path, page.trail, page.cross))


def test_every_recording_has_a_label_of_its_own(fallen):
    from jax_aero.view.page import _labels

    seen = recording.read(fallen)
    titles = ["TEST1, observed", "TEST1", "TEST1", "TEST1 (2)", "TEST1"]
    labels = _labels([replace(seen, title=title) for title in titles])
    assert labels == ["TEST1, observed", "TEST1", "TEST1 (2)", "TEST1 (2) (2)", "TEST1 (3)"]


def test_a_result_is_drawn_and_scrubbed(visit, fallen):
    page = visit(fallen)
    assert page.served.server.get_host() == "127.0.0.1"  # no other machine is served
    assert [FALL.fullmatch(outcome) is not None for outcome in page.outcomes()] == [True]
    page.wait_for(lambda: colours(page.picture()) > 300, "a picture of many colours")
    start = page.picture()
    page.set_number("time [s]", "18")
    page.wait_for(lambda: page.served.now == 18.0, "the requested moment")
    page.wait_for(lambda: has_changed(start, page.picture()) > 0.02, "another picture")
    page.wait_for(lambda: re.search("rotation error [67]", page.tab.content()) is not None, "its numbers")
    # Playing goes on from there, to the fall.
    page.tab.get_by_role("button", name="5×").click()
    page.tab.get_by_role("button", name="Play").click()
    page.wait_for(lambda: page.served.now == page.served.solid.duration, "the end of the flight")
    page.tab.get_by_role("button", name="Play").wait_for()
    assert page.complaints == []


def test_controls_fly_anew(visit):
    page = visit()
    assert page.outcomes() == ["completed"]
    before = page.served.solid.merit.rotation_error
    page.set_number("wind [m/s]", "28")
    page.wait_for(lambda: page.outcomes()[0].startswith("fell at"), "the fall of the baseline")
    page.choose("controller", "aware")
    page.wait_for(lambda: page.outcomes() == ["completed"], "the aware controller's flight")
    assert page.served.solid.merit.rotation_error < before
    assert "aware, 28 m/s from 90°" in page.tab.content()
    page.choose("ghost", "TEST1: baseline controller")
    page.wait_for(lambda: len(page.outcomes()) == 2, "the ghost")
    page.choose("controller", "baseline")
    page.set_number("wind [m/s]", "10")
    page.choose("lever arms", "published")
    page.choose("air", "axisymmetric, published")
    page.wait_for(lambda: falls_and_completes(page.outcomes()), "the published fall")
    assert page.complaints == []


def test_a_new_flight_keeps_the_moment_and_the_old_one_as_ghost(visit, fallen):
    page = visit(fallen)
    served = page.served
    end = round(served.solid.duration, 2)
    page.set_number("time [s]", "22")
    page.wait_for(lambda: served.now > 21.0, "the end of the flight that fell")
    page.tab.get_by_role("button", name="Keep this flight as ghost").click()
    page.wait_for(lambda: len(page.outcomes()) == 2, "the ghost")
    first = served.solid
    page.choose("air", "network default")
    page.choose("lever arms", "corrected")
    page.wait_for(lambda: served.solid is not first and served.solid.duration == 50.0, "a flight that completes")
    assert served.ghost is first
    assert served.solid.config["simulator"]["aero"]["card"].endswith("default.json")
    # Robot, time field and numbers show one moment.
    with served.lock:
        assert served.time.value == round(served.now, 2) == end
        np.testing.assert_allclose(served.robot.root.position, served.solid.at(served.now).com, atol=1e-9)
    page.wait_for(lambda: page.number("time [s]") == end, "the moment in the time field")
    # Any signal, its curves by name.
    page.choose("plot", "thrust")
    jets = served.solid.robot.jet_names
    page.wait_for(lambda: [line["label"] for line in served.plot.series][1:5] == list(jets), "curves of the jets")
    # A camera that stands looks at the robot.
    page.tab.get_by_text("Show", exact=True).click()
    page.tab.get_by_text("camera goes with the robot").click()
    page.wait_for(lambda: not served.follow.value, "the choice")
    page.set_number("time [s]", "45")
    (client,) = served.server.get_clients().values()

    def distance() -> float:
        robot = np.asarray(served.world.position) + served.solid.at(45.0).com
        return float(np.linalg.norm(np.asarray(client.camera.look_at) - robot))

    page.wait_for(lambda: served.now == 45.0 and distance() < 1e-6, "a look at the robot")
    assert page.complaints == []
