"""The flight lab in a real browser: no requests, the numbers of the crate, controls that act, a readable export."""

from __future__ import annotations

import base64
import fcntl
import gzip
import json
import re
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jax_aero import __main__ as commands
from jax_aero import io, rust
from jax_aero.view import recording

sync_api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")

from tests.browser import CHROMIUM, SLOWEST, open_chromium  # noqa: E402 - after the skip
from tests.measurements import measured  # noqa: E402

needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "rust/lab/page"
LAB = ROOT / "target/lab"

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")

STATES = ("base_position", "base_quaternion", "base_velocity", "joint_position", "joint_velocity", "com_position")
STATES += ("com_velocity", "momentum", "thrust")


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page, built by `make lab`; skips where a tool for that is missing."""
    if shutil.which("npm") is None or shutil.which("node") is None:
        pytest.skip("the flight lab is not built: node and npm are not installed")
    folder = subprocess.run(
        ["rustc", "--print", "target-libdir", "--target", "wasm32-unknown-unknown"], capture_output=True, text=True
    ).stdout.strip()
    if not folder or not Path(folder).is_dir():
        pytest.skip("the flight lab is not built: rustup target add wasm32-unknown-unknown")
    with (ROOT / "target/lab.lock").open("w") as lock:  # test processes build one after the other
        fcntl.flock(lock, fcntl.LOCK_EX)
        packages = subprocess.run(["make", "rust/lab/page/node_modules"], cwd=ROOT, capture_output=True, text=True)
        if packages.returncode:
            pytest.skip("the flight lab is not built: npm ci cannot fetch its packages")
        # The compiled module is the one that this test has imported.
        done = subprocess.run(["make", "-o", ".venv/.module", "lab"], cwd=ROOT, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        return shutil.copytree(LAB, tmp_path_factory.mktemp("lab") / "lab")  # which no other process builds anew


class Visit:
    """The page in a tab, and what the tab had to complain about or asked for."""

    def __init__(self, tab: Any, folder: Path, link: str = "") -> None:
        self.tab = tab
        self.complaints: list[str] = []
        self.requests: list[str] = []
        tab.on("console", lambda message: self.complaints.append(message.text) if message.type == "error" else None)
        tab.on("pageerror", lambda error: self.complaints.append(str(error)))
        tab.on("request", lambda request: self.requests.append(request.url))
        tab.goto(f"{(folder / 'index.html').as_uri()}{link}")
        self.wait("window.page && page.solid && page.solid.rows > 1")

    def wait(self, condition: str) -> None:
        self.tab.wait_for_function(condition)

    def seek(self, time: float) -> None:
        """Show a moment, and stay there."""
        self.tab.evaluate("time => { page.play(false); page.seek(time); }", time)
        self.wait(f"page.solid.hasEnded || page.solid.flown >= {time} - 0.011")

    def settings(self) -> dict[str, Any]:
        found: dict[str, Any] = self.tab.evaluate("page.settings")
        return found

    def fly(self, name: str) -> tuple[str, dict[str, Any]]:
        """Outcome and signals of a whole flight of the paper, by its button."""
        self.tab.get_by_role("button", name=name, exact=True).click()
        outcome, signals = self.tab.evaluate(
            """(names) => {
                const { solid } = page;
                solid.advance(solid.n_ticks + 1);
                page.isStale = true;
                const pack = (name) => {
                    const { buffer, byteOffset, byteLength } = solid.series(name);
                    const bytes = new Uint8Array(buffer, byteOffset, byteLength);
                    let text = "";
                    for (let at = 0; at < bytes.length; at += 0x8000) {
                        text += String.fromCharCode(...bytes.subarray(at, at + 0x8000));
                    }
                    return btoa(text);
                };
                return [solid.result().outcome, Object.fromEntries(names.map((name) => [name, pack(name)]))];
            }""",
            list(STATES),
        )
        return outcome, {name: np.frombuffer(base64.b64decode(data), "<f8") for name, data in signals.items()}


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with open_chromium() as opened:
        yield opened


@pytest.fixture
def visit(browser: Any, built: Path) -> Iterator[Callable[..., Visit]]:
    contexts = []

    def open_page(link: str = "", **options: Any) -> Visit:
        contexts.append(browser.new_context(**{"viewport": {"width": 420, "height": 300}, **options}))
        contexts[-1].set_default_timeout(SLOWEST)
        return Visit(contexts[-1].new_page(), built, link)

    yield open_page
    for context in contexts:
        context.close()


def in_node(program: str) -> Any:
    """What a program prints, as JSON, that has `scenario.js` as `scenario`."""
    module = json.dumps((PAGE / "scenario.js").as_uri())
    words = ["node", "--input-type=module", "-e", f"import * as scenario from {module};\n{program}"]
    return json.loads(subprocess.run(words, capture_output=True, text=True, check=True).stdout)


@needs_node
def test_a_wind_that_was_dragged_is_in_the_link_whatever_it_is():
    """Of each direction the strongest: before the ramp, where it sets speed and direction, and after it."""
    differing = in_node("""
        const { DEFAULTS, STRONGEST, fromHash, rampTo, round, toHash, velocity } = scenario;
        const differing = [];
        for (let degree = -180; degree < 180; degree += 0.1) {
            const wind = velocity(STRONGEST, degree).map(round);
            const steer = [[7.5, 0, -5], [7.7, ...wind], [round(8 + degree / 100), 0, 0]].slice(0, degree < 0 ? 2 : 3);
            for (const change of [rampTo(wind), { ...rampTo(wind), steer }]) {
                const settings = { ...DEFAULTS, ...change };
                const [said, read] = [settings, fromHash(toHash(settings))].map((one) => JSON.stringify(one));
                if (said !== read) differing.push([said, read]);
            }
        }
        console.log(JSON.stringify(differing));""")
    assert differing == []


@needs_node
@pytest.mark.parametrize(
    "link", ["engine=l_jet.500", "engine=l_arm_jet.Infinity", "engine=l_arm_jet.", "controller=toString", "steer=1.2"]
)
def test_what_a_link_says_wrongly_is_as_by_default(link):
    settings, default = in_node(f'console.log(JSON.stringify([scenario.fromHash("#{link}"), scenario.fromHash("")]))')
    assert settings == default


def inline(value: Any) -> str:
    """A value of a configuration in TOML, with paths from `configs/experiments`."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {inline(part)}" for key, part in value.items()) + "}"
    return json.dumps(value).replace('"../', f'"{ROOT}/configs/')


@needs_node
@pytest.mark.parametrize("arms", ["corrected", "published"])
@pytest.mark.parametrize("air", ["axisymmetric", "network", "spheres"])
def test_every_choice_of_the_predictive_law_is_a_flight(air, arms, tmp_path):
    settings = json.dumps({"controller": "ahead", "air": air, "arms": arms, "kp": 3.0})
    config = in_node(f"""
        const settings = {{ ...scenario.DEFAULTS, ...{settings} }};
        console.log(JSON.stringify(scenario.configuration(settings)));""")
    path = tmp_path / "flown.toml"
    path.write_text("".join(f"{key} = {inline(value)}\n" for key, value in config.items()))
    found = rust.load_config(path)
    is_linear = (air, arms) == ("axisymmetric", "corrected")
    assert found["controller"]["mpc"]["air"] == ("linear" if is_linear else "constant")
    rust.Controller(found)


def test_it_is_small_and_asks_for_nothing(visit, built):
    files = {path.name: path.read_bytes() for path in built.iterdir()}
    assert set(files) == {"index.html", "lab.js", "style.css"}
    assert sum(len(gzip.compress(content)) for content in files.values()) < 3e6
    page = visit()
    page.wait("page.now > 0.2")  # it flies by itself
    assert page.complaints == []
    here = {(built / name).as_uri() for name in files}
    assert {url for url in page.requests if not url.startswith(("data:", "blob:"))} <= here


def test_the_papers_flights_are_those_of_the_crate(visit):
    page = visit()
    for name in ("TEST1", "TEST2", "TEST3", "TEST4"):
        outcome, ours = page.fly(name)
        native = rust.fly(rust.load_config(ROOT / f"configs/experiments/{name.lower()}.toml"))
        assert outcome == native.outcome
        for state in STATES:
            np.testing.assert_array_equal(ours[state], np.ravel(native[state]), f"{name}: {state}")
    speed = page.tab.evaluate("""() => {
        const flight = page.lab.begin(scenarios.configuration(scenarios.DEFAULTS));
        const begin = performance.now();
        flight.advance(1000);
        const taken = performance.now() - begin;
        flight.end();
        return 10000 / taken;
    }""")
    measured("speed of a flight in the page, times real time", speed)
    page.tab.evaluate("page.seek(0); page.play(true)")
    page.wait("page.times.drawing.length > 3")
    for part, times in page.tab.evaluate("page.frameTimes").items():
        measured(f"a picture's {part}, median of {times['pictures']} [ms]", times["median"])
    assert page.complaints == []


def test_every_scene_plays_and_proves_its_number(visit):
    page = visit()
    numbers = []
    for index in range(5):
        page.tab.keyboard.press(str(index + 1))
        assert page.tab.locator("#tour button[aria-current=true]").inner_text().startswith(str(index + 1))
        start = page.tab.evaluate("page.now")
        page.wait(f"page.now > {start} + 0.1")
        # At once, not picture by picture.
        page.tab.evaluate("page.jobs.forEach(({ flight }) => flight.advance(flight.n_ticks + 1))")
        page.wait("!document.querySelector('#caption').textContent.includes('computing')")
        numbers.append(page.tab.locator("#caption .proof").inner_text().replace("\n", " "))
    assert re.match(r"\d+\.\d mm", numbers[0])
    assert re.match(r"\d\d\.\d N", numbers[1])
    assert numbers[2].startswith("32.9°")
    assert "3.1° with the model" in numbers[2]
    assert re.match(r"2[01]\.\d s", numbers[3])
    assert "it completes" in numbers[3]
    assert numbers[4].startswith("4.9°")
    assert re.search(r"the baseline falls at 2[01]\.\d s", numbers[4])
    assert page.complaints == []


def test_controls_act_and_a_link_holds_the_whole_scenario(visit):
    page = visit("#mission=hover&controller=aware", viewport={"width": 800, "height": 420})
    page.seek(11.0)
    page.tab.get_by_label("controller", exact=True).select_option("observer")
    assert page.settings()["controller"] == "observer"
    page.seek(12.0)
    # The wind is dragged, then an engine goes out.
    box = page.tab.locator("#pad").bounding_box()
    page.tab.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 0.3 * box["height"])
    page.tab.mouse.down()
    page.tab.evaluate("page.play(true)")
    page.wait("page.settings.steer.length > 1")
    page.tab.mouse.up()
    page.wait("page.now > 12.6")
    page.tab.get_by_role("button", name="left chest").click()
    assert page.settings()["engine"][0] == "chest_l_jet"
    jet = "page.solid.row('thrust', page.solid.rows - 1)[2]"
    page.wait(f"page.solid.flown > page.settings.engine[1] + 0.05 && {jet} === 0")
    page.tab.evaluate("page.play(false)")
    wind = page.tab.evaluate("[...page.solid.row('wind', page.solid.rows - 1)]")
    assert wind[0] < -3.0  # from ahead
    # The same link, elsewhere: the same flight to the last bit.
    rows = page.tab.evaluate("page.solid.rows")
    state = page.tab.evaluate(f"[...page.solid.row('com_position', {rows - 1})]")
    other = visit(page.tab.evaluate("location.hash"))
    assert other.settings() == page.settings()
    other.seek((rows - 1) * 0.01)
    assert other.tab.evaluate(f"[...page.solid.row('com_position', {rows - 1})]") == state
    assert page.complaints + other.complaints == []


def test_the_flight_before_is_a_ghost_after_every_change(visit):
    page = visit("#mission=hover", viewport={"width": 800, "height": 420})
    page.seek(1.0)
    page.tab.get_by_label("beside it").select_option("previous")
    for before, controller in (("baseline", "aware"), ("aware", "observer"), ("observer", "baseline")):
        page.tab.get_by_label("controller", exact=True).select_option(controller)
        assert page.settings()["controller"] == controller
        titles = page.tab.evaluate("[page.solid, page.ghost].map((flight) => flight.config.title)")
        assert [title.split(",")[0] for title in titles] == [controller, before]
        page.seek(1.0)
        page.wait("page.ghost.flown >= 1.0 - 0.011")
    assert page.complaints == []


def test_a_dragged_wind_is_of_the_flight_that_it_was_dragged_in(visit):
    page = visit(viewport={"width": 800, "height": 420})
    page.seek(12.0)
    page.tab.evaluate("page.blow([0, -4])")
    page.wait("page.settings.steer.length > 1")
    config, link, profile = page.tab.evaluate(
        "[scenarios.configuration(page.settings), scenarios.toHash(page.settings), page.solid.config.wind.profile]"
    )
    assert profile == "samples"
    assert "dragged wind" in config["title"]
    assert config["description"].endswith(link)
    # What is still being turned to is forgotten with the rest.
    page.seek(13.0)
    page.tab.evaluate("page.blow([0, -6])")
    page.wait("page.settings.steer.at(-1)[2] === -6")
    page.tab.get_by_role("button", name="Forget the dragged wind").click()
    page.seek(0.5)
    assert (page.settings()["steer"], page.settings()["speed"]) == ([], 10)
    page.tab.evaluate("page.blow([0, -6])")
    page.tab.get_by_role("button", name="TEST2", exact=True).click()
    page.seek(0.5)
    assert page.tab.evaluate("location.hash") == "#controller=aware"
    assert page.complaints == []


def test_a_wind_that_turns_on_leaves_what_was_flown_as_it_was(visit):
    """To the last bit: 560 ticks of 0.01 s are not 5.6 s in floating point."""
    page = visit("#mission=hover")
    live, again = page.tab.evaluate("""() => {
        page.play(false);
        const steer = [[5.2, 0, -0.4], [5.6, 0.3, 1.37]];
        Object.assign(page, { settings: { ...scenarios.DEFAULTS, mission: "hover", steer }, ghostKind: "aware" });
        page.begin(5.6);
        while (page.solid.flown < 5.6 - 1e-9) page.advance(0);
        page.blow([-7, 4]);
        page.isPlaying = true;
        while (page.solid.flown < 6) page.advance(0.05);
        page.play(false);
        const settings = scenarios.fromHash(location.hash);
        const begin = (controller) => page.lab.begin(scenarios.configuration({ ...settings, controller }));
        const again = ["baseline", "aware"].map(begin);
        return [[page.solid, page.ghost], again].map((flights) => flights.map((flight) => {
            if (flight.rows < 600) flight.advance(600 - flight.rows);
            return ["wind", "com_position"].map((name) => [...flight.series(name).slice(0, 3 * 600)]);
        }));
    }""")
    assert live == again


def test_a_flight_of_the_page_is_the_same_here(visit):
    page = visit("#mission=hover&speed=4")
    config, position = page.tab.evaluate("""() => {
        const { solid } = page;
        solid.advance(solid.n_ticks + 1);
        return [solid.config, [...solid.series("com_position")]];
    }""")
    again = rust.fly(io.make_paths_absolute(config))
    np.testing.assert_allclose(np.reshape(position, (-1, 3)), again["com_position"], rtol=0, atol=1e-9)


def test_keys_touch_and_small_screens(visit):
    page = visit("#mission=hover", viewport={"width": 390, "height": 844}, has_touch=True, color_scheme="dark")
    assert page.tab.evaluate("document.documentElement.scrollWidth") == 390  # nothing to scroll sideways
    page.tab.evaluate("page.play(false)")
    page.tab.keyboard.press("Space")
    page.wait("page.isPlaying")
    page.tab.keyboard.press("Space")
    page.wait("!page.isPlaying")
    page.seek(2.0)
    page.tab.keyboard.press("Shift+ArrowRight")
    page.wait("Math.abs(page.now - 3) < 1e-9")
    page.tab.keyboard.press("w")
    page.tab.keyboard.press("ArrowUp")
    page.wait("page.settings.speed === 11")
    page.tab.touchscreen.tap(*center(page.tab.locator("#play").bounding_box()))
    page.wait("page.isPlaying")
    x, y = center(page.tab.locator("#pad").bounding_box())
    page.tab.touchscreen.tap(x, y + 20)  # from behind
    page.wait("page.target[0] > 5")
    assert page.complaints == []


def center(box: dict[str, float]) -> tuple[float, float]:
    return box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]


def test_an_exported_flight_plays_as_one_file(browser, built, fallen, tmp_path):
    out = tmp_path / "fall.html"
    assert commands.main(["export", str(fallen), "--html", "--ghost", str(fallen), "--out", str(out)]) == 0
    tab = browser.new_context(viewport={"width": 800, "height": 500}).new_page()
    tab.set_default_timeout(SLOWEST)
    complaints, requests = [], []
    tab.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
    tab.on("pageerror", lambda error: complaints.append(str(error)))
    tab.on("request", lambda request: requests.append(request.url))
    tab.goto(out.as_uri())
    tab.wait_for_function("page.now > 0.2")  # it plays by itself
    tab.keyboard.press("Space")
    tab.wait_for_function("!page.isPlaying")
    tab.locator("figcaption select").last.select_option("joint_position")
    tab.evaluate("page.seek(21)")
    tab.wait_for_function("document.querySelector('#status').textContent.includes('rotation error')")
    seen = recording.read(fallen)
    shown = tab.evaluate("[...page.solid.pose(page.rowAt(page.solid, 21))]")
    now = seen.at(21.0)
    poses = np.concatenate([np.swapaxes(now.body_rotations, 1, 2).reshape(-1, 9), now.body_positions], axis=1)
    np.testing.assert_allclose(np.reshape(shown, (-1, 12)), poses, rtol=0, atol=1e-5)  # single precision, 100 m
    assert complaints == []
    assert [url for url in requests if not url.startswith("data:")] == [out.as_uri()]
    tab.context.close()
