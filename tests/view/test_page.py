"""The page with results, in a real browser: it draws, plays, scrubs, compares, and flies them anew."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jax_aero import rust
from jax_aero.view import recording, web
from jax_aero.view.recording import Recording

sync_api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: make setup")

from tests.browser import CHROMIUM, SLOWEST, Page  # noqa: E402 - after the skip
from tests.view.test_shapes import FACES, STL, draw_meshes  # noqa: E402

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed: apt-get install chromium")

FALL = re.compile(r"Falls at 2[01]\.\d s")
"""Outcome of TEST1 as published; its last digits hang on rounding."""


class Visit(Page):
    """The page of results in a tab."""

    def seek(self, time: float) -> None:
        """Show a moment, and stay there, when all is flown until then."""
        self.tab.evaluate("time => { page.play(false); page.seek(time); }", time)
        self.wait(f"[page.solid, page.ghost].every((one) => !one || one.hasEnded || one.flown >= {time} - 0.011)")
        self.wait("!page.isStale")

    def status(self) -> str:
        return str(self.tab.locator("#status").inner_text())

    def figures(self) -> dict[str, list[str]]:
        """The figures of merit by name, of solid flight and ghost."""
        rows = self.tab.locator("#figures tr").all()
        cells = [[cell.inner_text() for cell in row.locator("th, td").all()] for row in rows]
        return {name: words for name, *words in cells}


@pytest.fixture
def visit(browser: Any, built: Path) -> Iterator[Callable[..., Visit]]:
    opened = []

    def open_page(recordings: list[Recording], **options: Any) -> Visit:
        server = web.serve("127.0.0.1", 0)
        server.page = web.fill_page(recordings, recordings[0].config).encode()
        threading.Thread(target=server.serve_forever, daemon=True).start()
        context = browser.new_context(**{"viewport": {"width": 800, "height": 420}, **options})
        context.set_default_timeout(SLOWEST)
        opened.append((server, context))
        return Visit(context.new_page(), f"http://127.0.0.1:{server.server_port}/", "window.page && page.plotted")

    yield open_page
    for server, context in opened:
        context.close()
        server.shutdown()
        server.server_close()


def short_flight(name: str, seconds: float, **changes: Any) -> Recording:
    config = rust.load_config(name, {"simulator.duration": seconds, **changes})
    return recording.from_flight(rust.fly(config), config, name)


@pytest.mark.slow
def test_a_result_is_played_and_measured_beside_a_second_one(visit, fallen):
    seen = recording.read(fallen)
    page = visit([seen, replace(seen, title="another")])
    page.seek(18.0)
    assert re.search(r"rotation error\s+[67]\d\.\d°\s+lean\s+[56]\d\.\d°", page.status())
    assert page.tab.evaluate("page.ghost.title") == "another"
    flight = rust.fly(rust.load_config("test1_published"))
    error = f"{np.rad2deg(flight.summary['max_rotation_error']):.1f}°"
    thrusts = f"{flight.summary['thrust_min']:.0f}–{flight.summary['thrust_max']:.0f} N"
    figures = page.figures()
    assert figures["rotation error"] == [error, error]
    assert figures["thrusts"] == [thrusts, thrusts]
    assert figures["CoM error"][0] == f"{flight.summary['max_com_error']:.3f} m"
    assert figures["outcome"][0].startswith("fell at 2")
    # Any signal, its curves by name and with their numbers, those of the ghost too.
    page.tab.locator("figcaption select").last.select_option("aero_force_sim")
    page.wait("page.plots[2].key.textContent.includes('left arm jet turbine y -')")
    assert page.tab.locator("figcaption select").last.locator("option").count() > 20
    page.tab.evaluate("page.setRate(5); page.play(true)")
    page.wait("!page.isPlaying")
    assert FALL.search(page.status())
    assert page.complaints == []


@pytest.mark.slow
def test_a_result_flies_anew_and_a_flight_is_kept_as_a_ghost(visit, fallen):
    seen = recording.read(fallen)
    page = visit([seen])
    # With its own settings it is the result, to the last bit.
    again = page.tab.evaluate("""() => {
        const flight = page.flightOf(page.settings);
        flight.advance(flight.n_ticks + 1);
        return [[...flight.series("com_position")], [...flight.series("thrust")]];
    }""")
    for name, rows in zip(("com_position", "thrust"), again, strict=True):
        np.testing.assert_array_equal(np.ravel(seen.signals[name]), rows)
    page.seek(22.0)
    page.tab.get_by_role("button", name="Keep this flight as ghost").click()
    page.tab.get_by_label("lever arms").select_option("corrected")
    page.seek(21.0)
    page.wait("page.solid.flown > 20 && page.solid.title.includes('baseline, 10 m/s from 90°')")
    assert page.tab.evaluate("page.ghost === page.kept[0]")
    page.tab.get_by_label("controller", exact=True).select_option("aware")
    page.tab.get_by_role("button", name="Keep this flight as ghost").click()
    page.tab.get_by_label("air", exact=True).select_option("network ensemble/member_1")
    page.seek(1.0)
    assert page.tab.evaluate("page.solid.config.simulator.aero.card").endswith("ensemble/member_1.json")
    assert page.tab.get_by_label("beside it").locator("option").count() == 4 + 1 + 2  # controllers, before, kept
    page.tab.get_by_label("beside it").select_option("0")
    assert page.tab.evaluate("page.ghost.title") == seen.title
    # The wind of the result, from 10 s on; what was flown until then stays.
    page.seek(12.0)
    before = page.tab.evaluate("[...page.solid.row('com_position', 1000)]")
    page.tab.evaluate("page.blow([0, 0]); page.play(true)")
    page.wait("page.settings.steer.length > 1 && page.solid.flown > 12.5")
    assert page.tab.evaluate("[...page.solid.row('com_position', 1000)]") == before
    assert page.complaints == []


def test_meshes_are_drawn(visit, standing, tmp_path):
    pytest.importorskip("trimesh", reason="trimesh is not installed: make setup")
    (tmp_path / "bird.stl").write_text(STL)
    draw_meshes(tmp_path, ["bird.stl"])
    page = visit([standing(tmp_path / "sparrow.toml")])
    counts = page.tab.evaluate("page.scene.robot.parts.map(({ mesh }) => mesh.geometry.attributes.position.count)")
    assert set(counts[:-1]) == {3 * len(FACES)}
    assert page.complaints == []


def test_what_the_page_cannot_fly_is_played_all_the_same(visit):
    page = visit([short_flight("test1", 1.0, **{"controller.qp.solver": "clarabel"})])
    assert page.tab.locator("#message").inner_text().startswith("This flight cannot be repeated here: ")
    page.seek(0.5)
    assert page.complaints == []


def test_another_robot_flies_and_one_without_configuration_is_played(visit, standing):
    mk3 = short_flight("mk3_hover", 1.0)
    page = visit([mk3, standing(Path("configs/robot/sparrow.toml").resolve())])
    assert page.tab.evaluate("page.scene.ghost.parts.length !== page.scene.robot.parts.length")
    assert not page.tab.get_by_label("mission").is_visible()
    page.tab.get_by_label("speed, exactly").fill("3.7")
    page.tab.get_by_label("speed, exactly").press("Enter")
    page.seek(0.9)
    wanted = short_flight("mk3_hover", 1.0, **{"wind.velocity": [0.0, -3.7, 0.0]})
    got = page.tab.evaluate("[...page.solid.row('com_position', 90)]")
    np.testing.assert_array_equal(wanted.signals["com_position"][90], got)
    assert page.complaints == []
    alone = visit([standing(Path("configs/robot/sparrow.toml").resolve())])
    assert alone.tab.locator("#choices").inner_text() == ""
    for shown, is_there in ((page, True), (alone, False)):
        assert shown.tab.locator("#legend label", has_text="ghost").is_visible() is is_there
    assert not alone.tab.locator("#compass").is_visible()
    assert alone.complaints == []


@pytest.mark.slow
def test_what_is_not_wanted_is_hidden_and_the_camera_can_stand(visit, fallen):
    seen = recording.read(fallen)
    page = visit([seen, replace(seen, title="another")])
    for name in ("aerodynamic force on a link", "thrust:", "wind:", "set-point", "trail", "ghost"):
        page.tab.locator("#legend label", has_text=name).locator("input").uncheck()
    assert page.tab.evaluate("Object.values(page.scene.layers).some((layer) => layer.visible)") is False
    page.tab.locator("#length").fill("30")
    assert "30 cm per N" in page.tab.locator("#legend").inner_text()
    page.seek(3.0)
    camera = page.tab.evaluate("page.scene.camera.position.toArray()")
    page.tab.keyboard.press("c")
    page.seek(20.0)
    places = ("camera.position", "controls.target", "world.position")
    seen = f"[{', '.join(f'page.scene.{place}.toArray()' for place in places)}]"
    stands, target, world = page.tab.evaluate(seen)
    com = page.tab.evaluate("[...page.solid.row('com_position', page.rowAt(page.solid, 20))]")
    np.testing.assert_allclose(stands, camera, atol=1e-9)
    np.testing.assert_allclose(target, np.add(np.add(com, world), [0.0, 0.0, 0.1]), atol=1e-5)
    page.tab.keyboard.press("c")
    page.seek(20.0)
    np.testing.assert_allclose(page.tab.evaluate(seen)[1], [0.0, 0.0, 0.85], atol=1e-5)
    assert page.complaints == []


def test_a_small_dark_screen_shows_results(visit, fallen):
    page = visit([recording.read(fallen)] * 2, viewport={"width": 390, "height": 844}, color_scheme="dark")
    assert page.tab.evaluate("document.documentElement.scrollWidth") == 390  # nothing to scroll sideways
    page.tab.keyboard.press("Space")
    assert page.complaints == []
