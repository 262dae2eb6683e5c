"""The panel beside the scene: outcome, figures of merit, current numbers, plot, legend."""

from __future__ import annotations

import html
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from viser import uplot

from jax_aero import rust
from jax_aero.result import ending
from jax_aero.view import drawing
from jax_aero.view.drawing import Colour, Scales
from jax_aero.view.recording import Recording

POINTS = 600  # in the plot
ROTATION_ERROR = "rotation error"
"""Angle between base and set-point."""
LEAN = "lean"
"""Angle between the base's z axis and the vertical."""


def _hex(colour: Colour) -> str:
    return "#" + "".join(f"{part:02x}" for part in colour)


COLOURS = [_hex(one) for one in (drawing.FELL, drawing.FORCE, drawing.PLUME, drawing.REFERENCE, drawing.TRAIL)]


class Html(NamedTuple):
    """HTML, as opposed to a text, which is shown letter by letter."""

    source: str


def tag(name: str, style: str, *content: str | Html, **attributes: str) -> Html:
    """Return an element that contains texts and other elements."""
    inner = "".join(part.source if isinstance(part, Html) else html.escape(part) for part in content)
    named = "".join(f' {key}="{html.escape(value)}"' for key, value in {"style": style, **attributes}.items())
    return Html(f"<{name}{named}>{inner}</{name}>")


def note(text: str) -> str:
    """Return a text as a highlighted note in HTML."""
    return tag("div", f"padding:0.4em 1em;font-size:0.85em;color:{_hex(drawing.FELL)}", text).source


def card(solid: Recording, ghost: Recording | None) -> str:
    """Return outcomes and figures of merit as a table with one column per flight."""
    flights = [solid] if ghost is None else [solid, ghost]
    marks = [""] if ghost is None else ["◼ ", "◻ "]
    head = "text-align:left;font-weight:600;padding:0.15em 0.4em;vertical-align:bottom"
    heads = [tag("th", head, mark + flight.title) for mark, flight in zip(marks, flights, strict=True)]
    badges = [tag("td", "padding:0.15em 0.4em", *_badge(flight)) for flight in flights]
    merits = [flight.merit for flight in flights]
    rows = [
        ("rotation error", [f"{np.rad2deg(m.rotation_error):.1f}°" for m in merits]),
        ("CoM error", [f"{m.com_error:.3f} m" for m in merits]),
        ("thrusts", [f"{m.thrust_min:.0f}–{m.thrust_max:.0f} N" for m in merits]),
        ("aerodynamic force", [f"{m.aero_force:.1f} N" for m in merits]),
        ("distance", [f"{m.distance:.1f} m" for m in merits]),
    ]
    body = [
        tag(
            "tr",
            "",
            tag("td", "color:#667;padding:0.05em 0.4em 0.05em 0", name),
            *(tag("td", "padding:0.05em 0.4em;font-variant-numeric:tabular-nums", cell) for cell in cells),
        )
        for name, cells in rows
    ]
    table = tag(
        "table",
        "border-collapse:collapse;width:100%",
        tag("tr", "", tag("th", ""), *heads),
        tag("tr", "", tag("td", "color:#667", "outcome"), *badges),
        *body,
    )
    return tag("div", "padding:0.5em 1em 0.2em 1em;font-size:0.85em;line-height:1.35", table).source


def _badge(flight: Recording) -> list[Html]:
    colour = drawing.COMPLETED if flight.outcome == "completed" else drawing.FELL
    style = f"background:{_hex(colour)};color:white;border-radius:4px;padding:0.1em 0.5em;display:inline-block"
    badge = tag("span", style, ending(flight.outcome, flight.lost_time, None), **{"class": "outcome"})
    return [badge] if flight.lost_reason is None else [badge, tag("div", "color:#667", flight.lost_reason)]


def numbers(flight: Recording, time: float) -> str:
    """Return the numbers at a time [s] in one or two lines."""
    now, jets = flight.at(time), flight.robot.jet_names
    parts = [
        f"rotation error {np.rad2deg(now.rotation_error):.1f}°",
        f"lean {np.rad2deg(now.lean):.1f}°",
        f"off course {np.linalg.norm(now.com - now.com_setpoint):.2f} m",
        f"{np.linalg.norm(now.com_velocity):.1f} m/s",
        f"height {now.com[2]:.1f} m",
        f"air {np.linalg.norm(now.aero_force.sum(axis=0)):.1f} N",
        *(f"{name} {t:.0f} N" for name, t in zip(jets, now.thrust, strict=True)),
    ]
    return tag(
        "div",
        "padding:0.2em 1em;font-size:0.8em;color:#445;font-variant-numeric:tabular-nums",
        *(tag("span", "display:inline-block;margin-right:1em", part) for part in parts),
    ).source


@dataclass(frozen=True)
class Chart:
    """A plot over time: solid flight as a line, ghost dashed.

    Parameters
    ----------
    signal
        `ROTATION_ERROR`, `LEAN`, or a signal of the flights.
    """

    solid: Recording
    ghost: Recording | None
    signal: str

    def data(self, now: float) -> tuple[Any, ...]:
        """Return times [s], every curve, and a spike at time `now` [s]."""
        times = np.linspace(0.0, self._end, POINTS)
        curves = [curve for flight in self._flights for curve in _curves(flight, self.signal, times)]
        place = int(np.searchsorted(times, now))
        x = np.insert(times, place, [now] * 3)
        curves = [np.insert(curve, place, [np.interp(now, times, curve)] * 3) for curve in curves]
        low, high = self._range
        spike = np.full(x.size, low)
        spike[place + 1] = high
        return (x, *curves, spike)

    @property
    def scales(self) -> dict[str, uplot.Scale]:
        """Return the axis ranges, since the plot's own choice fails with NaN after a fall."""
        return {"x": uplot.Scale(time=False, range=(0.0, self._end)), "y": uplot.Scale(range=self._range)}

    @property
    def series(self) -> tuple[uplot.Series, ...]:
        """Return the lines, in the order of `data`."""
        lines = [uplot.Series(label="time [s]")]
        for flight in self._flights:
            is_ghost = flight is not self.solid
            names = _names(flight, self.signal)
            for number, name in enumerate(names):
                colour = _hex(drawing.GHOST) if is_ghost and len(names) == 1 else COLOURS[number % len(COLOURS)]
                label = f"ghost {name}" if is_ghost else name
                lines.append(uplot.Series(label=label, stroke=colour, width=1.5, dash=(5.0, 3.0) if is_ghost else ()))
        return (*lines, uplot.Series(label="now", stroke="#334", width=1, points={"show": False}))

    @property
    def axes(self) -> tuple[uplot.Axis, ...]:
        """Return the axes with units; the signal's name is above the plot."""
        unit = "°" if self.signal in (ROTATION_ERROR, LEAN) else rust.signals()[self.signal].unit.split(" (")[0]
        return (
            uplot.Axis(label="time [s]", labelSize=18, size=26),
            uplot.Axis(label=f"[{unit}]", labelSize=18, size=44),
        )

    @property
    def _flights(self) -> list[Recording]:
        return [flight for flight in (self.solid, self.ghost) if flight is not None]

    @property
    def _end(self) -> float:
        return max(flight.duration for flight in self._flights)

    @cached_property
    def _range(self) -> tuple[float, float]:
        every = np.concatenate([_rows(flight, self.signal).ravel() for flight in self._flights])
        every = every[np.isfinite(every)]
        low, high = (float(every.min()), float(every.max())) if every.size else (0.0, 0.0)
        least = 5.0 if self.signal in (ROTATION_ERROR, LEAN) else 1e-9
        return min(low * 1.08, 0.0), max(high * 1.08, low * 0.92, 0.0 if low < -least else least)


def signals(flights: Sequence[Recording]) -> list[str]:
    """Return the signals that all these flights have."""
    others = [name for name in rust.signals() if name not in ("time", "rotation_error")]
    return [ROTATION_ERROR, LEAN] + [name for name in others if all(name in flight.signals for flight in flights)]


def _rows(flight: Recording, signal: str) -> Any:
    if signal == ROTATION_ERROR:
        return np.rad2deg(flight.rows("rotation_error"))
    if signal == LEAN:
        _, x, y, _ = flight.signals["base_quaternion"].T
        return np.rad2deg(np.arccos(np.clip(1.0 - 2.0 * (x**2 + y**2), -1.0, 1.0)))[:, None]
    return flight.rows(signal)


def _names(flight: Recording, signal: str) -> list[str]:
    return [signal] if signal in (ROTATION_ERROR, LEAN) else flight.names(signal) or [signal.replace("_", " ")]


def _curves(flight: Recording, signal: str, times: Any) -> list[Any]:
    t = flight.signals["time"]
    flown = times <= flight.duration + 1e-9
    return [np.where(flown, np.interp(times, t, column), np.nan) for column in _rows(flight, signal).T]


def legend(scales: Scales) -> str:
    """Return the meaning of the colours and the length of a newton."""
    rows = [
        (drawing.FORCE, f"aerodynamic force on a link: {100 * scales.force:.0f} cm per N"),
        (drawing.PLUME, f"thrust: {100 * scales.thrust * 100:.0f} cm per 100 N"),
        (drawing.WIND, f"wind: {100 * scales.wind * 10:.0f} cm per 10 m/s"),
        (drawing.REFERENCE, "centre of mass: reference"),
        (drawing.TRAIL, "centre of mass: trail"),
    ]
    bar = (
        "display:inline-block;width:1.4em;height:0.35em;border-radius:2px;margin-right:0.6em;vertical-align:middle;"
        "background:"
    )
    lines = [tag("div", "", tag("span", bar + _hex(colour)), text) for colour, text in rows]
    return tag("div", "padding:0.4em 1em 0.8em 1em;font-size:0.8em;line-height:1.5", *lines).source
