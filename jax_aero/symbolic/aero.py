"""Aerodynamic force on a link from its velocity relative to the air, following the paper.

Equations M19 to M22 of `docs/model`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np
from scipy.interpolate import PchipInterpolator

from jax_aero.symbolic.robot import AeroLink, Robot
from jax_aero.symbolic.spatial import SX

ANGLE_EPSILON = 1e-9
"""Added to the speed in the angle of attack [m/s]. Source: the published controller."""

ROOT_FLOOR = 1e-24
"""Added under the root of the speed [m²/s²]: negligible, but it makes derivatives at rest finite. Ours."""

LinkForce = Callable[[int, SX, SX], Any]
"""Force (`SX`) [N] on link `i`, from its unit axis and its velocity relative to the air [m/s], inertial axes."""


def link_force(config: Mapping[str, Any], robot: Robot) -> LinkForce:
    """Return the model that a table of `configs/aero` describes."""
    match config["model"]:
        case "off":
            return lambda _link, _axis, _v_a: ca.SX.zeros(3)
        case "axisymmetric":
            return _axisymmetric(config, robot)
        case "sphere_cylinder":
            return _sphere_cylinder(config, robot.aero_links)
        case model:
            raise ValueError(f"aerodynamic model `{model}` is unknown; expected off, axisymmetric or sphere_cylinder")


def _attack(axis: SX, v_a: SX) -> tuple[SX, SX, SX, SX]:
    """Return |v_a|, cos α, sin α and (v_a × k̂) × v_a, with α the angle between v_a and the axis k̂.

    The published epsilon keeps the cosine below 1, so the root in sin α has a derivative for wind along the axis.
    """
    speed = ca.sqrt(ca.dot(v_a, v_a) + ROOT_FLOOR)
    cos = ca.dot(axis, v_a) / (speed + ANGLE_EPSILON)
    return speed, cos, ca.sqrt(1 - cos**2), ca.cross(ca.cross(v_a, axis), v_a)


def _axisymmetric(config: Mapping[str, Any], robot: Robot) -> LinkForce:
    """Paper, eq. `aero-force-model`: F = −k_a |v_a| C_D A v_a + k_a C_N A (v_a × k̂ × v_a)/sin α, k_a = ρ/2."""
    k_a = 0.5 * config["air_density"]
    areas = robot.coefficients[config["coefficients"]] if robot.aero_links else ()

    def force(link: int, axis: SX, v_a: SX) -> Any:
        w0, w1, w2, w3, w4, w5 = areas[link].tolist()
        speed, cos, sin, normal = _attack(axis, v_a)
        drag_area = w0 + w1 * cos + w2 * sin**2 + w3 * sin**3 + w4 * cos**3
        normal_area_over_sin = w5 * sin * cos  # C_N A = w₅ sin² α cos α
        return k_a * (normal_area_over_sin * normal - speed * drag_area * v_a)

    return force


def _sphere_cylinder(config: Mapping[str, Any], links: Sequence[AeroLink]) -> LinkForce:
    """Spheres and finite cylinders with drag from the literature; M21 and M22 of `docs/model`.

    With the Reynolds number ρ|v|d/μ, the crosswind drag C₉₀ of a finite cylinder (on d l) and the axial drag C₀, the
    drag is C₀ + (C₉₀ − C₀) sin³ α and the normal force C₉₀ sin² α cos α, which is then divided by sin α.
    """
    rho, mu = config["air_density"], config["dynamic_viscosity"]
    cylinder, sphere = config["cylinder"], config["sphere"]
    crosswind = _table(cylinder["reynolds"], cylinder["crosswind_drag"])
    reference = float(np.interp(cylinder["reference_reynolds"], cylinder["reynolds"], cylinder["crosswind_drag"]))
    finite = PchipInterpolator(cylinder["diameter_over_length"], cylinder["finite_length_drag"])
    axial = PchipInterpolator(cylinder["length_over_diameter"], cylinder["axial_drag"])
    sphere_table = _table(sphere["reynolds"], sphere["drag"])
    first = sphere["reynolds"][0]

    def sphere_drag(re: SX) -> SX:
        # Brown and Lawler (2003) up to the table. Both branches are differentiated, so Re = 0 must be avoided.
        re = ca.fmax(re, 1e-6)
        formula = 24 / re * (1 + 0.150 * re**0.681) + 0.407 / (1 + 8710 / re)
        low = ca.if_else(re < 10, sphere["drag_below_reynolds_10"], formula)
        return ca.if_else(re <= first, low, sphere_table(re))

    def force(number: int, axis: SX, v_a: SX) -> Any:
        link = links[number]
        d, length = link.diameter, link.length
        speed, cos, sin, normal = _attack(axis, v_a)
        re = rho * speed * d / mu
        if link.is_sphere:
            return -0.5 * rho * (np.pi / 4 * d * length) * sphere_drag(re) * speed * v_a
        c90 = crosswind(re) * float(finite(d / length)) / max(cylinder["finite_length_drag"])
        # Referred to the area d l instead of π d²/4.
        c0 = np.pi / 4 * d / length * float(axial(length / d)) / max(cylinder["axial_drag"]) * crosswind(re) / reference
        drag = c0 + (c90 - c0) * sin**3
        return 0.5 * rho * d * length * (c90 * sin * cos * normal - speed * drag * v_a)

    return force


def _table(x: Sequence[float], y: Sequence[float]) -> Callable[[SX], SX]:
    """Return SciPy's PCHIP through a table as an expression, constant beyond its ends.

    It is the sum of the increments of all pieces up to the argument; no piece is evaluated outside its own interval.
    """
    pieces = PchipInterpolator(x, y).c.T

    def interpolate(value: SX) -> SX:
        result = ca.SX(y[0])
        for left, right, (c3, c2, c1, _) in zip(x[:-1], x[1:], pieces, strict=True):
            step = ca.fmin(ca.fmax(value, left), right) - left
            result += step * (c1 + step * (c2 + step * c3))
        return result

    return interpolate
