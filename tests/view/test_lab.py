"""The flight lab in a real browser: no requests, the numbers of the crate, controls that act, a readable export."""

from __future__ import annotations

import base64
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
from jax_aero import rust
from jax_aero.base import typed_config
from jax_aero.view import recording

sync_api = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: make setup")

from tests.browser import CHROMIUM, SLOWEST, Page  # noqa: E402 - after the skip
from tests.measurements import measured  # noqa: E402

needs_node = pytest.mark.skipif(
    shutil.which("node") is None, reason="node is not installed: apt-get install nodejs npm"
)

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "rust/lab/page"
LAB = ROOT / "target/lab"

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed: apt-get install chromium")

STATES = ("base_position", "base_quaternion", "base_velocity", "joint_position", "joint_velocity", "com_position")
STATES += ("com_velocity", "momentum", "thrust")


class Visit(Page):
    """The lab in a tab."""

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


@pytest.fixture
def visit(browser: Any, built: Path) -> Iterator[Callable[..., Visit]]:
    contexts = []

    def open_page(link: str = "", **options: Any) -> Visit:
        contexts.append(browser.new_context(**{"viewport": {"width": 420, "height": 300}, **options}))
        contexts[-1].set_default_timeout(SLOWEST)
        url = f"{(built / 'index.html').as_uri()}{link}"
        return Visit(contexts[-1].new_page(), url, "window.page && page.solid && page.solid.rows > 1")

    yield open_page
    for context in contexts:
        context.close()


def about(name: str) -> dict[str, Any]:
    """What the page reads of an experiment from the simulator."""
    config = rust.resolve_config(rust.load_config(name))
    return {"config": config, "jets": rust.Robot(config["robot"]).jet_names}


def in_node(program: str) -> Any:
    """What a program prints, as JSON, that has `scenario.js` as `scenario`, and the lab's scenario as `lab`."""
    module = json.dumps((PAGE / "scenario.js").as_uri())
    begin = f"const lab = new scenario.Scenario({json.dumps(about('test1'))}, 'in_line');"
    words = ["node", "--input-type=module", "-e", f"import * as scenario from {module};\n{begin}\n{program}"]
    return json.loads(subprocess.run(words, capture_output=True, text=True, check=True).stdout)


@needs_node
def test_a_wind_that_was_dragged_is_in_the_link_whatever_it_is():
    """Of each direction the strongest: before the ramp, where it sets speed and direction, and after it."""
    differing = in_node("""
        const { DEFAULTS, STRONGEST, rampTo, round, velocity } = scenario;
        const differing = [];
        for (let degree = -180; degree < 180; degree += 0.1) {
            const wind = velocity(STRONGEST, degree).map(round);
            const steer = [[7.5, 0, -5], [7.7, ...wind], [round(8 + degree / 100), 0, 0]].slice(0, degree < 0 ? 2 : 3);
            for (const change of [rampTo(wind), { ...rampTo(wind), steer }]) {
                const settings = { ...DEFAULTS, ...change };
                const [said, read] = [settings, lab.fromHash(lab.toHash(settings))].map((one) => JSON.stringify(one));
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
    settings, default = in_node(f'console.log(JSON.stringify([lab.fromHash("#{link}"), scenario.DEFAULTS]))')
    assert settings == default


def changed(name: str, settings: dict[str, Any], mission: str = "given") -> dict[str, Any]:
    """The configuration of an experiment with settings of the page that differ from its own."""
    changes = in_node(f"""
        const shown = new scenario.Scenario({json.dumps(about(name))}, "{mission}");
        console.log(JSON.stringify(shown.changes({{ ...shown.start, ...{json.dumps(settings)} }})));""")
    text = json.dumps(dict(changes)).replace('"../', f'"{ROOT}/configs/')
    return rust.set_keys(about(name)["config"], json.loads(text))


EXPERIMENTS = ["test1", "test2", "test3", "test1_published", "test2_published", "no_wind", "engine_out"]
EXPERIMENTS += ["closed_circuit", "test2_sensors_mpc", "mk3_test2", "sensor_noise"]


@needs_node
@pytest.mark.parametrize("name", EXPERIMENTS)
def test_the_settings_of_a_flight_are_that_flight(name):
    assert changed(name, {}) == about(name)["config"]


@needs_node
@pytest.mark.parametrize(
    ("settings", "name", "same"),
    [
        # A baseline has no aerodynamics that could have arms.
        ({"controller": "baseline", "arms": "published"}, "test1_published", ["simulator"]),
        ({"controller": "aware", "arms": "published"}, "test2_published", ["simulator", "controller"]),
        ({"controller": "observer"}, "test1_observer", ["controller"]),
        ({"controller": "mpc"}, "test2_mpc", ["controller"]),
    ],
)
def test_what_is_chosen_in_the_page_is_what_the_experiment_files_say(settings, name, same):
    config, experiment = rust.resolve_config(changed("test1", settings)), about(name)["config"]
    assert {part: config[part] for part in same} == {part: experiment[part] for part in same}


@needs_node
@pytest.mark.parametrize(
    ("wind", "until"),
    [
        ({"profile": "constant", "velocity": [-3, 0, 0]}, [[0, -3, 0, 0]]),
        ({"profile": "constant", "velocity": [0, 0, 0]}, [[0, 0, 0, 0], [5, 0, 0, 0]]),  # would rise from 5 s on
        ({"profile": "ramp", "velocity": [-6, 0, 0], "ramp_start": 0, "ramp_end": 2}, [[0, 0, 0, 0], [2, -6, 0, 0]]),
    ],
)
def test_a_wind_is_dragged_from_what_it_was(wind, until):
    given = about("test1")
    given["config"]["wind"] = wind
    found = in_node(f"""
        const shown = new scenario.Scenario({json.dumps(given)});
        const [, ...now] = shown.windUntil(shown.start, 8).at(-1);
        console.log(JSON.stringify(shown.windOf({{ ...shown.start, steer: [[8, ...now], [8.2, 0, 5]] }})));""")
    before = [float(part) for part in wind["velocity"]]
    assert found == {"profile": "samples", "samples": [*until, [8, *before], [8.2, 0, 5, 0]]}


@needs_node
def test_what_is_not_chosen_is_kept():
    """Wind, gains and sensors of the result."""
    config = changed("robustness", {"scale": 0.5, "controller": "baseline"})
    before = about("robustness")["config"]
    assert config["disturbances"]["aero_estimate"]["scale"] == 0.5
    assert config["controller"]["aero"]["model"] == "off"
    assert config["wind"] == before["wind"]
    assert {**config["controller"], "aero": None} == {**before["controller"], "aero": None}
    # Of another robot, whose control files the page does not have.
    config = changed("mk3_test2_mpc", {"model": "off", "air": "spheres"})
    assert config["controller"]["aero"] == {"model": "off"}
    assert config["simulator"]["aero"]["model"] == "sphere_cylinder"
    assert config["controller"]["weights"] == about("mk3_test2_mpc")["config"]["controller"]["weights"]


@needs_node
@pytest.mark.parametrize("arms", ["corrected", "published"])
@pytest.mark.parametrize("air", ["axisymmetric", "printed", "signed", "alternative", "network", "spheres", "off"])
def test_every_choice_of_the_predictive_law_is_a_flight(air, arms):
    found = changed("test1", {"controller": "mpc", "air": air, "arms": arms, "kp": 3.0})
    is_linear = arms == "corrected" and air not in ("network", "spheres")
    assert found["controller"]["mpc"]["air"] == ("linear" if is_linear else "constant")
    rust.check_config(found)


@pytest.mark.slow
def test_it_is_small_and_asks_for_nothing(visit, built):
    files = {path.name: path.read_bytes() for path in built.iterdir()}
    assert set(files) == {"index.html"}
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
        native = rust.fly(rust.load_config(name.lower()))
        assert outcome == native.outcome
        for state in STATES:
            np.testing.assert_array_equal(ours[state], np.ravel(native[state]), f"{name}: {state}")
    speed = page.tab.evaluate("""() => {
        const flight = page.flightOf(page.scenario.start);
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


@pytest.mark.slow
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
        "[page.scenario.changes(page.settings), page.scenario.toHash(page.settings), page.solid.config.wind.profile]"
    )
    assert profile == "samples"
    assert "dragged wind" in dict(config)["title"]
    assert dict(config)["description"].endswith(link)
    # A turn in progress is dropped with the rest.
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
        Object.assign(page, { settings: { ...page.scenario.start, mission: "hover", steer }, ghostKind: "aware" });
        page.begin(5.6);
        while (page.solid.flown < 5.6 - 1e-9) page.advance(0);
        page.blow([-7, 4]);
        page.isPlaying = true;
        while (page.solid.flown < 6) page.advance(0.05);
        page.play(false);
        const settings = page.scenario.fromHash(location.hash);
        const begin = (controller) => page.flightOf({ ...settings, controller });
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
    again = rust.fly(typed_config.make_paths_absolute(config))
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


@pytest.mark.slow
def test_an_exported_flight_plays_as_one_file(browser, built, fallen, tmp_path):
    out = tmp_path / "fall.html"
    assert commands.main(["export", str(fallen), "--html", "--ghost", str(fallen), "--out", str(out)]) == 0
    tab = browser.new_context(viewport={"width": 800, "height": 500}).new_page()
    tab.set_default_timeout(SLOWEST)
    page = Page(tab, out.as_uri(), "page.now > 0.2")  # it plays by itself
    tab.keyboard.press("Space")
    page.wait("!page.isPlaying")
    tab.locator("figcaption select").last.select_option("joint_position")
    tab.evaluate("page.seek(21)")
    page.wait("document.querySelector('#status').textContent.includes('rotation error')")
    seen = recording.read(fallen)
    shown = tab.evaluate("[...page.solid.pose(page.rowAt(page.solid, 21))]")
    now = seen.at(21.0)
    poses = np.concatenate([np.swapaxes(now.body_rotations, 1, 2).reshape(-1, 9), now.body_positions], axis=1)
    np.testing.assert_allclose(np.reshape(shown, (-1, 12)), poses, rtol=0, atol=1e-5)  # single precision, 100 m
    assert page.complaints == []
    assert [url for url in page.requests if not url.startswith("data:")] == [out.as_uri()]
    tab.context.close()
