"""The page in the browser: scene, panel, playback, and flights computed while it is open (viser)."""

from __future__ import annotations

import contextlib
import io
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import viser
from viser import uplot

from jax_aero import rust
from jax_aero.view import drawing, panel
from jax_aero.view.drawing import Scales
from jax_aero.view.nodes import LIT, RobotNodes, segments, sky, thin_path
from jax_aero.view.origins import own_origins
from jax_aero.view.recording import Recording, from_flight
from jax_aero.view.settings import ARMS, CONTROLLERS, MODELS, Settings, apply, can_change_wind, settings_of

FRAME_RATE = 30.0  # pictures per second of playback
NUMBERS_RATE = 5.0  # updates of numbers and plot per second
STRONGEST_WIND = 30.0  # m/s
STRONGEST_FEEDBACK = 2.0
SPEEDS = {"¼×": 0.25, "1×": 1.0, "2×": 2.0, "5×": 5.0}
NO_GHOST = "none"


class Page:
    """The page: one solid flight, at most one ghost, and controls that repeat the solid flight.

    Parameters
    ----------
    recordings
        Results to show: the first is solid, a second one the ghost. If empty, TEST1 is flown.
    config
        Configuration that the controls change; by default the first result's, if it has one.
    host, port
        Address to listen on; for port 0 the system chooses one.
    """

    def __init__(
        self,
        recordings: Sequence[Recording],
        config: rust.Config | None,
        host: str = "127.0.0.1",
        port: int = 8080,
    ) -> None:
        self.base = config
        self.results = list(recordings)
        if not self.results:
            if config is None:
                raise ValueError("neither a recording nor a configuration; expected at least one of them")
            self.results = [from_flight(rust.fly(config), config, str(config.get("title", "flown here")))]
        self.solid = self.results[0]
        self.others = self.results[1:]
        self.ghost: Recording | None = self.others[0] if self.others else None
        self.scales = Scales()
        self.now = 0.0
        self.playing = False
        self.rate = 1.0
        self.wanted: Settings | None = None
        self.lock = threading.RLock()
        self.wake = threading.Condition()
        self.ended = threading.Event()
        # Viser prints its address even if `verbose` is off.
        with contextlib.redirect_stdout(io.StringIO()), own_origins(host):
            self.server = viser.ViserServer(host=host, port=port, label="jax-aero", verbose=False)
        try:
            self._build_scene()
            self._build_panel()
            self._show_flights()
        except BaseException:
            self.server.stop()
            raise
        self.threads = [threading.Thread(target=job, daemon=True) for job in (self._play, self._fly)]
        for thread in self.threads:
            thread.start()

    @property
    def url(self) -> str:
        """Address of the page."""
        host = self.server.get_host()
        return f"http://{'localhost' if host in ('127.0.0.1', '0.0.0.0') else host}:{self.server.get_port()}"

    def close(self) -> None:
        """Stop playback, flights and server."""
        self.ended.set()
        with self.wake:
            self.wake.notify_all()
        for thread in self.threads:
            thread.join(timeout=5.0)
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()

    # --- scene ---------------------------------------------------------------------------------------------

    def _build_scene(self) -> None:
        scene = self.server.scene
        scene.set_up_direction("+z")
        scene.configure_environment_map(None)
        scene.configure_default_lights(enabled=True, cast_shadow=True)
        scene.add_light_hemisphere("/sky", sky_color=(255, 255, 255), ground_color=(190, 190, 195), intensity=2.1)
        scene.set_background_image(sky())
        # The scene moves instead of the camera, which the user controls.
        self.world = scene.add_frame("/world", show_axes=False)
        self.ground = scene.add_grid(
            "/world/ground",
            infinite_grid=True,
            cell_size=1.0,
            section_size=10.0,
            cell_color=(205, 208, 212),
            section_color=(150, 155, 162),
            fade_distance=60.0,
            plane_color=(238, 240, 243),
            plane_opacity=1.0,
            shadow_opacity=0.25,
        )
        self.wind = scene.add_arrows(
            "/world/wind",
            np.zeros((1, 2, 3)),
            LIT[drawing.WIND],
            shaft_radius=0.022,
            head_radius=0.06,
            head_length=0.16,
        )
        self.wind_label = scene.add_label(
            "/world/wind_label", "wind 10.0 m/s", anchor="bottom-center", font_screen_scale=0.9
        )
        line: Any = {"thickness": 2.5, "thickness_units": "screen"}
        self.cross = scene.add_line_segments("/world/reference", np.zeros((3, 2, 3)), drawing.REFERENCE, **line)
        self.path = scene.add_line_segments("/world/path", np.zeros((1, 2, 3)), drawing.REFERENCE, **line)
        self.trail = scene.add_line_segments("/world/trail", np.zeros((1, 2, 3)), drawing.TRAIL, **line)
        self.posts: list[Any] = []
        self.robot: RobotNodes | None = None
        self.ghost_robot: RobotNodes | None = None
        self.server.initial_camera.fov = np.deg2rad(42.0)
        self.server.initial_camera.position = (-2.75, -2.15, 1.75)
        self.server.initial_camera.look_at = (0.0, 0.0, 0.75)

    def _show_flights(self) -> None:
        """Build everything that depends on the flights shown."""
        with self.lock, self.server.atomic():
            for nodes in (self.robot, self.ghost_robot):
                if nodes is not None:
                    nodes.remove()
            self.robot = RobotNodes(self.server, "/world/robot", self.solid.look, ghost=False)
            self.ghost_robot = None
            if self.ghost is not None:
                self.ghost_robot = RobotNodes(self.server, "/world/ghost", self.ghost.look, ghost=True)
            self._new_flight()
            self._show_or_hide()

    def _new_flight(self) -> None:
        """Build what depends on the flights but not on their robots."""
        with self.lock, self.server.atomic():
            reference_path = thin_path(self.solid, "com_setpoint", self.solid.duration)
            self.path.points = segments(reference_path)
            self._mark_distance(float(reference_path[:, 0].max()))
            self.time.max = max(self._duration(), 0.1)
            self.card.content = panel.card(self.solid, self.ghost)
            self._show_plot()
            self._go(min(self.now, self._duration()))

    def _show_plot(self) -> None:
        """Plot the selected signal of the flights shown."""
        with self.lock, self.server.atomic():
            self.chart = panel.Chart(self.solid, self.ghost, self.signal.value)
            self.plot.series, self.plot.scales, self.plot.axes = self.chart.series, self.chart.scales, self.chart.axes
            self.plot.data = self.chart.data(self.now)

    def _go(self, time_s: float) -> None:
        """Go to a time [s]: robot, time field, numbers and plot."""
        with self.lock, self.server.atomic():
            self._show(time_s)
            self.time.value = round(time_s, 2)
            self._show_numbers()

    def _mark_distance(self, farthest: float) -> None:
        wanted = np.arange(10.0, max(farthest, 10.0) + 5.0, 10.0)
        if len(wanted) == len(self.posts):
            return
        for post in self.posts:
            post.remove()
        self.posts = [
            self.server.scene.add_label(
                f"/world/posts/{x:.0f}",
                f"{x:.0f} m",
                position=(x, -1.5, 0.2),
                font_size_mode="scene",
                font_scene_height=0.22,
                anchor="bottom-center",
            )
            for x in wanted
        ]

    def _duration(self) -> float:
        return max(flight.duration for flight in (self.solid, self.ghost) if flight is not None)

    def _show(self, time_s: float) -> None:
        """Show the robot at a time [s]."""
        with self.lock, self.server.atomic():
            self.now = time_s
            instant = self.solid.at(time_s)
            if self.robot is not None:
                self.robot.show(instant, self.scales)
            if self.ghost is not None and self.ghost_robot is not None:
                self.ghost_robot.show(self.ghost.at(time_s), self.scales)
            if self.follow.value:
                self.world.position = (-instant.com[0], -instant.com[1], 0.75 - instant.com[2])
            else:  # the camera stays and turns towards the robot
                for client in self.server.get_clients().values():
                    client.camera.look_at = tuple(np.asarray(self.world.position) + instant.com)
            arrow = drawing.wind_arrow(instant, self.scales)
            self.wind.visible = self.wind_label.visible = arrow is not None and self.show_wind.value
            if arrow is not None:
                self.wind.points = arrow[None].astype(np.float32)
                self.wind_label.position = tuple(arrow.mean(axis=0) + np.array([0.0, 0.0, 0.1]))
                self.wind_label.text = f"wind {np.linalg.norm(instant.wind):.1f} m/s"
            arms = 0.28 * np.eye(3)
            at = instant.com_setpoint
            self.cross.points = np.stack([at - arms, at + arms], axis=1).astype(np.float32)
            self.trail.points = segments(thin_path(self.solid, "com_position", time_s))

    def _show_numbers(self) -> None:
        with self.lock:
            self.numbers.content = panel.numbers(self.solid, self.now)
            self.plot.data = self.chart.data(self.now)

    # --- panel ---------------------------------------------------------------------------------------------

    def _build_panel(self) -> None:
        gui = self.server.gui
        gui.configure_theme(
            control_width="large",
            show_logo=False,
            show_share_button=False,  # sharing would expose the page to the internet
            brand_color=drawing.FORCE,
        )
        gui.set_panel_label("jax-aero")
        gui.main_panel.dock_right()
        self.card = gui.add_html(panel.card(self.solid, self.ghost))
        self.time: Any = gui.add_slider("time [s]", min=0.0, max=self._duration(), step=0.01, initial_value=0.0)
        self.play = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY)
        self.speed = gui.add_button_group("speed", tuple(SPEEDS))
        self.numbers = gui.add_html(panel.numbers(self.solid, 0.0))
        self._build_controls()
        self.signal = gui.add_dropdown("plot", panel.signals(self.results), initial_value=panel.ROTATION_ERROR)
        self.chart = panel.Chart(self.solid, self.ghost, panel.ROTATION_ERROR)
        self.plot = gui.add_uplot(
            self.chart.data(0.0),
            self.chart.series,
            scales=self.chart.scales,
            axes=self.chart.axes,
            legend=uplot.Legend(show=False),
            height=150,
        )
        with gui.add_folder("Show", expand_by_default=False):
            self.follow = gui.add_checkbox(
                "camera goes with the robot", initial_value=True, hint="else it stands and turns towards the robot"
            )
            self.show_forces = gui.add_checkbox("aerodynamic forces", initial_value=True)
            self.show_plumes = gui.add_checkbox("thrusts", initial_value=True)
            self.show_wind = gui.add_checkbox("wind", initial_value=True)
            self.show_path = gui.add_checkbox("reference and trail", initial_value=True)
            self.force_length = gui.add_slider("cm per N", min=5.0, max=40.0, step=1.0, initial_value=15.0)
        self.legend = gui.add_html(panel.legend(self.scales))
        self.signal.on_update(lambda _: self._show_plot())
        self.time.on_update(self._on_scrub)
        self.play.on_click(lambda _: self._toggle())
        self.speed.on_click(lambda _: setattr(self, "rate", SPEEDS[self.speed.value]))
        for box in (self.follow, self.show_forces, self.show_plumes, self.show_wind, self.show_path):
            box.on_update(lambda _: self._show_or_hide())
        self.force_length.on_update(lambda _: self._rescale())

    def _build_controls(self) -> None:
        gui = self.server.gui
        if self.base is None:
            gui.add_html(panel.note("This result does not carry its configuration, so it cannot be repeated."))
            return
        start = settings_of(self.base)
        with gui.add_folder("Fly it yourself"):
            self.wind_speed = gui.add_slider(
                "wind [m/s]",
                min=0.0,
                max=max(STRONGEST_WIND, start.wind_speed),
                step=0.5,
                initial_value=start.wind_speed,
            )
            self.wind_direction = gui.add_slider(
                "from [°]",
                min=-180.0,
                max=180.0,
                step=5.0,
                initial_value=start.wind_direction_deg,
                hint="0: from ahead, 90: from the robot's left",
            )
            self.controller = gui.add_dropdown("controller", CONTROLLERS, initial_value=start.controller)
            models = (*([] if start.model in MODELS else [start.model]), *MODELS)
            self.model = gui.add_dropdown("air", models, initial_value=start.model)
            self.arms = gui.add_dropdown(
                "lever arms", ARMS, initial_value=start.arms, hint="published: link offsets are added without rotation"
            )
            self.feedback = gui.add_slider(
                "feedback",
                min=0.0,
                max=max(STRONGEST_FEEDBACK, start.feedback_scale),
                step=0.1,
                initial_value=start.feedback_scale,
                hint="factor on every aerodynamic force the controller estimates",
            )
            choices = (NO_GHOST, *_labels(self.results))
            chosen = _labels(self.results)[1] if self.others else NO_GHOST
            self.compare: Any = gui.add_dropdown("ghost", choices, initial_value=chosen)
            self.pin = gui.add_button("Keep this flight as ghost", icon=viser.Icon.PIN)
        if not can_change_wind(self.base):
            self.wind_speed.disabled = self.wind_direction.disabled = True
        self.feedback.disabled = start.controller == "baseline"
        self.shown_settings = self._settings()
        for control in (self.wind_speed, self.wind_direction, self.controller, self.model, self.arms, self.feedback):
            control.on_update(lambda _: self._on_change())
        self.compare.on_update(lambda _: self._choose_ghost())
        self.pin.on_click(lambda _: self._pin())

    def _settings(self) -> Settings:
        return Settings(
            wind_speed=float(self.wind_speed.value),
            wind_direction_deg=float(self.wind_direction.value),
            controller=self.controller.value,
            model=self.model.value,
            arms=self.arms.value,
            feedback_scale=float(self.feedback.value),
        )

    def _on_change(self) -> None:
        with self.wake:
            self.wanted = self._settings()
            self.wake.notify_all()
        self.feedback.disabled = self.wanted.controller == "baseline"

    def _choose_ghost(self) -> None:
        labels = _labels(self.results)
        with self.lock:
            self.ghost = self.results[labels.index(self.compare.value)] if self.compare.value in labels else None
            self._show_flights()

    def _pin(self) -> None:
        """Make the flight shown the ghost of the following ones."""
        with self.lock:
            if not any(self.solid is one for one in self.results):
                self.results.append(self.solid)
            labels = _labels(self.results)
            self.compare.options = (NO_GHOST, *labels)
            self.compare.value = labels[next(i for i, one in enumerate(self.results) if one is self.solid)]

    def _on_scrub(self, event: Any) -> None:
        if event.client is None:  # moved by playback
            return
        self._show(float(self.time.value))
        self._show_numbers()

    def _toggle(self) -> None:
        if not self.playing and self.now >= self._duration() - 1e-6:
            self.now = 0.0
        self.playing = not self.playing
        self.play.label = "Pause" if self.playing else "Play"
        self.play.icon = viser.Icon.PLAYER_PAUSE if self.playing else viser.Icon.PLAYER_PLAY

    def _show_or_hide(self) -> None:
        """Show what is switched on."""
        with self.lock, self.server.atomic():
            if self.robot is not None:
                if self.robot.arrows is not None:
                    self.robot.arrows.visible = self.show_forces.value
                if self.robot.flames is not None:
                    self.robot.flames.visible = self.show_plumes.value
            for line in (self.path, self.trail, self.cross):
                line.visible = self.show_path.value
            self._show(self.now)

    def _rescale(self) -> None:
        self.scales = replace(self.scales, force=float(self.force_length.value) / 100.0)
        self.legend.content = panel.legend(self.scales)
        self._show(self.now)

    # --- work ----------------------------------------------------------------------------------------------

    def _play(self) -> None:
        last, numbers_due = time.monotonic(), 0.0
        while not self.ended.wait(1.0 / FRAME_RATE):
            tick = time.monotonic()
            elapsed, last = tick - last, tick
            if not self.playing:
                continue
            with self.lock:
                then = min(self.now + self.rate * elapsed, self._duration())
                self._show(then)
                self.time.value = round(then, 2)
                if then >= self._duration():
                    self._toggle()
                if tick >= numbers_due or not self.playing:
                    numbers_due = tick + 1.0 / NUMBERS_RATE
                    self._show_numbers()

    def _fly(self) -> None:
        """Fly with the latest settings; settings changed in the meantime are skipped."""
        while True:
            with self.wake:
                self.wake.wait_for(lambda: self.wanted is not None or self.ended.is_set())
                wanted, self.wanted = self.wanted, None
            if self.ended.is_set():
                return
            if wanted is None or self.base is None or wanted == self.shown_settings:
                continue
            try:
                config = apply(self.base, wanted)
                flown = from_flight(rust.fly(config), config, wanted.title)
            except (ValueError, RuntimeError) as reason:
                self.card.content = panel.note(f"This cannot be flown: {reason}")
                continue
            self.shown_settings = wanted
            with self.lock:
                self.solid = flown
                self._new_flight()


def _labels(recordings: Sequence[Recording]) -> list[str]:
    """Return a distinct short name for every recording."""
    labels: list[str] = []
    for recording in recordings:
        label, number = recording.title, 1
        while label in labels:
            number += 1
            label = f"{recording.title} ({number})"
        labels.append(label)
    return labels
