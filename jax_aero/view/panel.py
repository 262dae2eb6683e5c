"""What stands beside the scene: outcome, figures of merit, numbers of the moment, plot, legend."""

from __future__ import annotations

import html
from typing import Any

import numpy as np
from viser import uplot

from jax_aero.view import drawing
from jax_aero.view.drawing import Colour, Scales
from jax_aero.view.recording import Recording

POINTS = 600  # of the plot


def _hex(colour: Colour) -> str:
    return "#" + "".join(f"{part:02x}" for part in colour)


def note(text: str) -> str:
    """Return a sentence."""
    return f'<div style="padding:0.4em 1em;font-size:0.85em;color:{_hex(drawing.FELL)}">{html.escape(text)}</div>'


def card(solid: Recording, ghost: Recording | None) -> str:
    """How the flights ended and what they achieved, as a table with a column each."""
    flights = [solid] if ghost is None else [solid, ghost]
    heads = "".join(
        f'<th style="text-align:left;font-weight:600;padding:0.15em 0.4em;vertical-align:bottom">'
        f"{'' if ghost is None else '◼ ' if flight is solid else '◻ '}{html.escape(flight.title)}</th>"
        for flight in flights
    )
    badges = "".join(f'<td style="padding:0.15em 0.4em">{_badge(flight)}</td>' for flight in flights)
    merits = [flight.merit for flight in flights]
    rows = [
        ("rotation error", [f"{np.rad2deg(m.rotation_error):.1f}°" for m in merits]),
        ("CoM error", [f"{m.com_error:.3f} m" for m in merits]),
        ("thrusts", [f"{m.thrust_min:.0f}–{m.thrust_max:.0f} N" for m in merits]),
        ("aerodynamic force", [f"{m.aero_force:.1f} N" for m in merits]),
        ("distance", [f"{m.distance:.1f} m" for m in merits]),
    ]
    body = "".join(
        f'<tr><td style="color:#667;padding:0.05em 0.4em 0.05em 0">{name}</td>'
        + "".join(f'<td style="padding:0.05em 0.4em;font-variant-numeric:tabular-nums">{cell}</td>' for cell in cells)
        + "</tr>"
        for name, cells in rows
    )
    return (
        '<div style="padding:0.5em 1em 0.2em 1em;font-size:0.85em;line-height:1.35">'
        f'<table style="border-collapse:collapse;width:100%"><tr><th></th>{heads}</tr>'
        f'<tr><td style="color:#667">outcome</td>'
        f"{badges}</tr>{body}</table></div>"
    )


def _badge(flight: Recording) -> str:
    colour = drawing.COMPLETED if flight.outcome == "completed" else drawing.FELL
    when = "" if flight.lost_time is None else f" at {flight.lost_time:.1f} s"
    why = "" if flight.lost_reason is None else f'<br><span style="color:#667">{html.escape(flight.lost_reason)}</span>'
    return (
        f'<span class="outcome" style="background:{_hex(colour)};color:white;border-radius:4px;padding:0.1em 0.5em;'
        f'display:inline-block">{html.escape(flight.outcome.replace("_", " "))}{when}</span>{why}'
    )


def numbers(flight: Recording, time: float) -> str:
    """Return the moment in one or two lines."""
    now, jets = flight.at(time), flight.robot.jet_names
    parts = [
        f"attitude error {np.rad2deg(now.rotation_error):.1f}°",
        f"lean {np.rad2deg(now.lean):.1f}°",
        f"off course {np.linalg.norm(now.com - now.com_setpoint):.2f} m",
        f"{np.linalg.norm(now.com_velocity):.1f} m/s",
        f"height {now.com[2]:.1f} m",
        f"air {np.linalg.norm(now.aero_force.sum(axis=0)):.1f} N",
        "thrusts " + " · ".join(f"{name} {t:.0f}" for name, t in zip(jets, now.thrust, strict=True)) + " N",
    ]
    return (
        '<div style="padding:0.2em 1em;font-size:0.8em;color:#445;font-variant-numeric:tabular-nums">'
        + " &nbsp; ".join(f'<span style="white-space:nowrap">{part}</span>' for part in parts)
        + "</div>"
    )


def plot_data(solid: Recording, ghost: Recording | None, now: float) -> tuple[Any, ...]:
    """Return times [s], rotation error of both flights [deg], and a spike where we are."""
    times = np.linspace(0.0, _end(solid, ghost), POINTS)
    curves = [_curve(flight, times) for flight in (solid, ghost) if flight is not None]
    place = int(np.searchsorted(times, now))
    x = np.insert(times, place, [now] * 3)
    curves = [np.insert(curve, place, [np.interp(now, times, curve)] * 3) for curve in curves]
    spike = np.zeros(x.size)
    spike[place + 1] = _top(solid, ghost)
    return (x, *curves, spike)


def plot_scales(solid: Recording, ghost: Recording | None) -> dict[str, uplot.Scale]:
    """Ranges of the plot: NaN, after a fall, would spoil what it finds itself."""
    return {
        "x": uplot.Scale(time=False, range=(0.0, _end(solid, ghost))),
        "y": uplot.Scale(range=(0.0, _top(solid, ghost))),
    }


def _end(solid: Recording, ghost: Recording | None) -> float:
    return max(flight.duration for flight in (solid, ghost) if flight is not None)


def _top(solid: Recording, ghost: Recording | None) -> float:
    highest = max(flight.merit.rotation_error for flight in (solid, ghost) if flight is not None)
    return max(1.08 * float(np.rad2deg(highest)), 5.0)


def _curve(flight: Recording, times: Any) -> Any:
    error = np.rad2deg(np.interp(times, flight.signals["time"], flight.signals["rotation_error"]))
    return np.where(times <= flight.duration + 1e-9, error, np.nan)


def plot_series(has_ghost: bool) -> tuple[uplot.Series, ...]:
    """Lines of the plot, in the order of `plot_data`."""
    ghost = (
        (uplot.Series(label="ghost [°]", stroke=_hex(drawing.GHOST), width=1.5, dash=(5.0, 3.0)),) if has_ghost else ()
    )
    return (
        uplot.Series(label="time [s]"),
        uplot.Series(label="attitude error [°]", stroke=_hex(drawing.FELL), width=2),
        *ghost,
        uplot.Series(label="now", stroke="#334", width=1, points={"show": False}),
    )


def plot_axes() -> tuple[uplot.Axis, ...]:
    """Axes with their units."""
    return (
        uplot.Axis(label="time [s]", labelSize=18, size=26),
        uplot.Axis(label="attitude error [°]", labelSize=18, size=34),
    )


def legend(scales: Scales) -> str:
    """Return what the colours are, and how long a newton is."""
    rows = [
        (drawing.FORCE, f"aerodynamic force on a link: {100 * scales.force:.0f} cm per N"),
        (drawing.PLUME, f"thrust: {100 * scales.thrust * 100:.0f} cm per 100 N"),
        (drawing.WIND, f"wind: {100 * scales.wind * 10:.0f} cm per 10 m/s"),
        (drawing.REFERENCE, "centre of mass: reference"),
        (drawing.TRAIL, "centre of mass: trail"),
    ]
    lines = "".join(
        f'<div><span style="display:inline-block;width:1.4em;height:0.35em;border-radius:2px;margin-right:0.6em;'
        f'vertical-align:middle;background:{_hex(colour)}"></span>{text}</div>'
        for colour, text in rows
    )
    return f'<div style="padding:0.4em 1em 0.8em 1em;font-size:0.8em;line-height:1.5">{lines}</div>'
