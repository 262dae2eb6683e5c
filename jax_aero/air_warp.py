"""The air of `jax_aero.air` in MuJoCo Warp and Newton: kernels for the forces on all links of all worlds.

    around = air.from_links(model, links)           # `model` of MuJoCo or Newton
    blow = air_warp.MujocoWarpAir(around, data)     # MuJoCo Warp: sets `xfrc_applied`
    warp_model.callback.control = blow
    blow = air_warp.NewtonAir(around, model)        # Newton: adds to `body_f`
    blow.add(state)
    blow.wind.assign(...)                           # one wind per world [m/s, world axes]

The forces are those of `jax_aero.aero.axisymmetric_forces` and `sphere_cylinder_forces` in single precision. A call
only launches one kernel; it neither allocates nor waits, so that it can be captured in a CUDA graph, and a captured
graph reads `wind` anew at every launch.

Equations M18 to M22 of `docs/model`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

from jax_aero.aero import Axisymmetric, SphereCylinder
from jax_aero.aero.pchip import Pchip
from jax_aero.air import Air, names_in

__all__ = ["MujocoWarpAir", "NewtonAir"]

SPEED_EPSILON = wp.constant(1e-9)
"""As in `jax_aero.aero.attack` [m/s]."""

wp.set_module_options({"enable_backward": False})


@wp.struct
class Links:
    """Links sorted by body, and the tables of their drag by Reynolds number, one after the other."""

    first: wp.array[int]
    """(n + 1,) first link of each body that carries links."""
    axes: wp.array[wp.vec3]
    """(L,) unit axes of symmetry, body axes."""
    centres: wp.array[wp.vec3]
    """(L,) points at which the forces act, body axes [m]."""
    factors: wp.array[float]
    """(L,) air density times reference area over two, or density over two where `areas` are areas."""
    areas: wp.array2d[float]
    """(L, 6) `w0 .. w5` of equation M20; [m²] or relative to the reference area."""
    reynolds_per_speed: wp.array[float]
    """(L,) [s/m]."""
    tables: wp.array2d[int]
    """(L, 2) first abscissa of the link's table and the one after its last; equal for a link without."""
    is_sphere: wp.array[bool]
    """(L,) whether drag below the table follows the formula of a sphere."""
    slow_drag: float
    """Drag coefficient of a sphere below Reynolds number 10."""
    x: wp.array[float]
    """(k,) abscissae of all tables."""
    cubics: wp.array[wp.vec4]
    """(k,) value and coefficients of the first three powers of the distance from each abscissa."""
    derive: bool
    """Whether derivatives are computed."""


@wp.func
def drag_by_reynolds(links: Links, link: int, reynolds: float) -> tuple[float, float]:
    """Return the factor on the areas of a link and its derivative; `interpolate` and `sphere_drag` of the JAX twin."""
    begin, end = links.tables[link, 0], links.tables[link, 1]
    if begin == end:
        return 1.0, 0.0
    if links.is_sphere[link] and reynolds <= links.x[begin]:
        if reynolds < 10.0:
            return links.slow_drag, 0.0
        power = 0.150 * wp.pow(reynolds, 0.681)
        late = 0.407 / (reynolds + 8710.0)
        value = 24.0 / reynolds * (1.0 + power) + late * reynolds
        slope = 24.0 / (reynolds * reynolds) * (-1.0 - 0.319 * power) + late * 8710.0 / (reynolds + 8710.0)
        return value, slope
    inside = wp.clamp(reynolds, links.x[begin], links.x[end - 1])
    segment = wp.clamp(wp.lower_bound(links.x, begin, end, inside) - 1, begin, end - 2)
    s = inside - links.x[segment]
    c = links.cubics[segment]
    slope = wp.where(inside == reynolds, c[1] + s * (2.0 * c[2] + 3.0 * s * c[3]), 0.0)
    return c[0] + s * (c[1] + s * (c[2] + s * c[3])), slope


@wp.func
def link_force(links: Links, link: int, axis: wp.vec3, v: wp.vec3) -> tuple[wp.vec3, wp.mat33]:
    """Return the force on a link in air of relative velocity `v` [N], and its derivative by `v` [N s/m] if requested.

        F = f c(Re) ( |v| D v + N (v × k̂) × v )
        D = w₀ + w₁ cos α + w₂ sin² α + w₃ sin³ α + w₄ cos³ α,   N = w₅ sin α cos α

    With v̂, n̂ normal to it towards k̂, b̂ = v̂ × n̂ and M = N sin α this is f c |v|² (D v̂ + M n̂), with the derivative

        f |v| ( (2 c + Re c') (D v̂ + M n̂) v̂ᵀ + c ((D' − M) v̂ + (D + M') n̂) n̂ᵀ + c (D + N cos α) b̂ b̂ᵀ )

    where D' and M' are by α, c' by Re.
    """
    speed = wp.length(v)
    regular = speed + SPEED_EPSILON
    side = wp.cross(v, axis)
    cos = wp.clamp(-wp.dot(axis, v) / regular, -1.0, 1.0)
    sin = wp.min(wp.sqrt(wp.length_sq(side) + SPEED_EPSILON * (speed + regular)) / regular, 1.0)
    reynolds = links.reynolds_per_speed[link] * speed
    c, slope = drag_by_reynolds(links, link, reynolds)
    w0, w1, w2 = links.areas[link, 0], links.areas[link, 1], links.areas[link, 2]
    w3, w4, w5 = links.areas[link, 3], links.areas[link, 4], links.areas[link, 5]
    drag = w0 + cos * (w1 + w4 * cos * cos) + sin * sin * (w2 + w3 * sin)
    normal = w5 * sin * cos
    factor = links.factors[link]
    towards = wp.cross(side, v)
    force = factor * c * (speed * drag * v + normal * towards)
    if not links.derive:
        return force, wp.mat33()

    along = v / regular
    toward = wp.normalize(towards)
    if wp.length_sq(toward) == 0.0:  # wind along the axis, about which the derivative is symmetric
        toward = wp.normalize(
            wp.cross(along, wp.where(wp.abs(along[0]) < 0.5, wp.vec3(1.0, 0.0, 0.0), wp.vec3(0.0, 1.0, 0.0)))
        )
    across = wp.cross(along, toward)
    lift = normal * sin
    sin = wp.length(side) / regular  # without ε, of whose square root the derivative would be
    drag_turn = sin * (-w1 - 3.0 * w4 * cos * cos + cos * (2.0 * w2 + 3.0 * w3 * sin))
    lift_turn = w5 * sin * (2.0 * cos * cos - sin * sin)
    by_speed = (2.0 * c + reynolds * slope) * (drag * along + lift * toward)
    by_turn = c * ((drag_turn - lift) * along + (drag + lift_turn) * toward)
    by_side = c * (drag + normal * cos) * across
    derivative = wp.outer(by_speed, along) + wp.outer(by_turn, toward) + wp.outer(by_side, across)
    return force, factor * speed * derivative


@wp.func
def body_wrench(
    links: Links,
    group: int,
    wind: wp.vec3,
    rotation: wp.mat33,
    origin: wp.vec3,
    com: wp.vec3,
    linear: wp.vec3,
    angular: wp.vec3,
) -> tuple[wp.spatial_vector, wp.spatial_matrix]:
    """Return the wrench of the links of a body about its centre of mass, and its derivative by the body's twist there.

    Both with the linear part first, world axes; `linear` is the velocity of the centre of mass [m/s].
    """
    force, torque = wp.vec3(), wp.vec3()
    ff, ft, tf, tt = wp.mat33(), wp.mat33(), wp.mat33(), wp.mat33()
    for link in range(links.first[group], links.first[group + 1]):
        arm = origin + rotation @ links.centres[link] - com
        v = wind - linear - wp.cross(angular, arm)
        pushed, by_air = link_force(links, link, rotation @ links.axes[link], v)
        force += pushed
        torque += wp.cross(arm, pushed)
        turn = wp.skew(arm)
        ff -= by_air
        ft += by_air @ turn
        tf -= turn @ by_air
        tt += turn @ by_air @ turn
    derivative = wp.spatial_matrix()
    for i in range(3):
        for j in range(3):
            derivative[i, j] = ff[i, j]
            derivative[i, j + 3] = ft[i, j]
            derivative[i + 3, j] = tf[i, j]
            derivative[i + 3, j + 3] = tt[i, j]
    return wp.spatial_vector(force, torque), derivative


@wp.kernel
def set_mujoco(
    links: Links,
    bodies: wp.array[int],
    wind: wp.array[wp.vec3],
    roots: wp.array[int],
    xpos: wp.array2d[wp.vec3],
    xmat: wp.array2d[wp.mat33],
    xipos: wp.array2d[wp.vec3],
    subtree_com: wp.array2d[wp.vec3],
    cvel: wp.array2d[wp.spatial_vector],
    xfrc: wp.array2d[wp.spatial_vector],
    derivatives: wp.array2d[wp.spatial_matrix],
) -> None:
    """Set the rows of `xfrc_applied` of one body in one world; `cvel` is the twist at the tree's centre of mass."""
    world, group = wp.tid()
    body = bodies[group]
    twist = cvel[world, body]
    com = xipos[world, body]
    angular = wp.spatial_top(twist)
    linear = wp.spatial_bottom(twist) + wp.cross(angular, com - subtree_com[world, roots[body]])
    wrench, derivative = body_wrench(
        links, group, wind[world], xmat[world, body], xpos[world, body], com, linear, angular
    )
    xfrc[world, body] = wrench
    if links.derive:
        derivatives[world, group] = derivative


@wp.kernel
def add_newton(
    links: Links,
    groups: wp.array[int],
    bodies: wp.array[int],
    worlds: wp.array[int],
    wind: wp.array[wp.vec3],
    body_com: wp.array[wp.vec3],
    body_q: wp.array[wp.transform],
    body_qd: wp.array[wp.spatial_vector],
    body_f: wp.array[wp.spatial_vector],
    derivatives: wp.array[wp.spatial_matrix],
) -> None:
    """Add to `body_f` of one body; `body_qd` is the twist at its centre of mass, the linear part first."""
    index = wp.tid()
    body = bodies[index]
    pose = body_q[body]
    twist = body_qd[body]
    wrench, derivative = body_wrench(
        links,
        groups[index],
        wind[wp.max(worlds[body], 0)],
        wp.quat_to_matrix(wp.transform_get_rotation(pose)),
        wp.transform_get_translation(pose),
        wp.transform_point(pose, body_com[body]),
        wp.spatial_top(twist),
        wp.spatial_bottom(twist),
    )
    body_f[body] += wrench
    if links.derive:
        derivatives[index] = derivative


class MujocoWarpAir:
    """The air in MuJoCo Warp. It is a function for `callback.control` of its model.

    Parameters
    ----------
    around
        The air around the links of the `mujoco.MjModel` from which the model of MuJoCo Warp is made.
    data
        Data of MuJoCo Warp, for the number of worlds and the device.
    derivatives
        Whether to compute them.

    Attributes
    ----------
    wind
        (nworld,) velocity of the air [m/s, world axes], a Warp array that the caller writes; zero at first.
    bodies
        Indices of the bodies that carry links.
    derivatives
        (nworld, len(bodies)) derivatives of the wrench of each body, as in `xfrc_applied`, by the velocity of its
        centre of mass and its angular velocity, 6×6 [N s/m, N s, N m s]; no entries unless requested.

    Raises
    ------
    ValueError
        If the model of `around` is a network or one of a user, which have no kernel.
    """

    def __init__(self, around: Air, data: Any, derivatives: bool = False) -> None:
        device = data.xpos.device
        self._links, carriers = _links(around, device, derivatives)
        self.bodies = [around.bodies[body] for body in carriers]
        self._bodies = wp.array(self.bodies, dtype=int, device=device)
        self.wind = wp.zeros(data.nworld, dtype=wp.vec3, device=device)
        shape = (data.nworld if derivatives else 0, len(carriers))
        self.derivatives = wp.zeros(shape, dtype=wp.spatial_matrix, device=device)

    def __call__(self, model: Any, data: Any) -> None:
        """Set the rows of `xfrc_applied` of bodies that carry links, from current positions and velocities."""
        wp.launch(
            set_mujoco,
            dim=(len(self.wind), len(self.bodies)),
            inputs=[
                self._links, self._bodies, self.wind, model.body_rootid,
                data.xpos, data.xmat, data.xipos, data.subtree_com, data.cvel,
            ],
            outputs=[data.xfrc_applied, self.derivatives],
            device=self.wind.device,
        )  # fmt: skip


class NewtonAir:
    """The air in Newton, around all bodies of a `newton.Model` that carry the names of those of `around`.

    Attributes
    ----------
    wind
        (worlds,) velocity of the air [m/s, world axes], a Warp array that the caller writes; zero at first.
    bodies
        Indices of the bodies that carry links, of all worlds.
    derivatives
        (len(bodies),) derivatives of the entries of `body_f` by those of `body_qd`, 6×6; no entries unless requested.

    Raises
    ------
    ValueError
        If the model lacks a body, or if the model of `around` has no kernel.
    """

    def __init__(self, around: Air, model: Any, derivatives: bool = False) -> None:
        device = model.device
        self._links, carriers = _links(around, device, derivatives)
        groups = {around.names[body]: group for group, body in enumerate(carriers)}
        names = names_in(model, "body")
        if missing := groups.keys() - names:
            raise ValueError(f"the model has no body `{min(missing)}`")
        self.bodies = [body for body, name in enumerate(names) if name in groups]
        self._bodies = wp.array(self.bodies, dtype=int, device=device)
        self._groups = wp.array([groups[names[body]] for body in self.bodies], dtype=int, device=device)
        self._model = model
        self.wind = wp.zeros(max(model.world_count, 1), dtype=wp.vec3, device=device)
        self.derivatives = wp.zeros(len(self.bodies) if derivatives else 0, dtype=wp.spatial_matrix, device=device)

    def add(self, state: Any) -> None:
        """Add the wrenches to `state.body_f`; call it after `state.clear_forces()` and before the solver's step."""
        wp.launch(
            add_newton,
            dim=len(self.bodies),
            inputs=[
                self._links, self._groups, self._bodies, self._model.body_world, self.wind, self._model.body_com,
                state.body_q, state.body_qd,
            ],
            outputs=[state.body_f, self.derivatives],
            device=self.wind.device,
        )  # fmt: skip


def _links(around: Air, device: Any, derive: bool) -> tuple[Any, list[int]]:
    """Return the links on a device, and the bodies of the robot that carry some, in the order of `Links.first`."""
    aero, rigid = around.aero, around.robot.aero_links
    count = rigid.count
    tables: list[Pchip] = []
    reynolds, of_link, is_sphere, slow = np.zeros(count), np.zeros((count, 2), dtype=int), np.zeros(count, bool), 0.0
    if isinstance(aero, Axisymmetric):
        factors, areas = np.full(count, float(aero.k_a)), np.asarray(aero.areas)
    elif isinstance(aero, SphereCylinder):
        tables = [aero.cylinder, aero.sphere]
        is_sphere = np.asarray(aero.is_sphere)
        split = len(aero.cylinder.x)
        of_link = np.where(is_sphere[:, None], [split, split + len(aero.sphere.x)], [0, split])
        factors, reynolds = np.asarray(aero.half_density_area), np.asarray(aero.reynolds_per_speed)
        slow, areas = float(aero.drag_below_reynolds_10), np.zeros((count, 6))
        areas[:, 0] = np.where(is_sphere, 1.0, aero.axial)
        areas[~is_sphere, 3] = (aero.crosswind - aero.axial)[~is_sphere]
        areas[~is_sphere, 5] = np.asarray(aero.crosswind)[~is_sphere]
    else:
        known = "expected an axisymmetric or a sphere and cylinder model"
        raise ValueError(f"the model is a {type(aero).__name__}, which has no kernel for Warp; {known}")
    order = np.argsort(rigid.bodies, kind="stable")
    carriers, first = np.unique(np.array(rigid.bodies, dtype=int), return_counts=True)
    rotations = np.asarray(rigid.rotations)
    centres = np.asarray(rigid.positions) + np.einsum("lij,lj->li", rotations, rigid.centres)
    cubics = [_cubics(table) for table in tables]

    def put(values: Any, dtype: Any) -> Any:
        return wp.array(np.asarray(values), dtype=dtype, device=device)

    links = Links()
    links.first = put(np.concatenate([[0], np.cumsum(first)]), int)
    links.axes = put(np.einsum("lij,lj->li", rotations, rigid.axes)[order], wp.vec3)
    links.centres = put(centres[order], wp.vec3)
    links.factors, links.areas = put(factors[order], float), put(areas[order], float)
    links.reynolds_per_speed = put(reynolds[order], float)
    links.tables, links.is_sphere, links.slow_drag = put(of_link[order], int), put(is_sphere[order], bool), slow
    links.x = put(np.concatenate([np.asarray(table.x) for table in tables] or [np.zeros(0)]), float)
    links.cubics = put(np.concatenate(cubics or [np.zeros((0, 4))]), wp.vec4)
    links.derive = derive
    return links, carriers.tolist()


def _cubics(table: Pchip) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return value and coefficients of the powers from each abscissa of a table (k, 4); the last row is unused."""
    x, y, slopes = (np.asarray(column, dtype=np.float64) for column in (table.x, table.y, table.slopes))
    h = np.diff(x)
    secant, a, b = np.diff(y) / h, slopes[:-1], slopes[1:]
    rows = np.stack([y[:-1], a, (3.0 * secant - 2.0 * a - b) / h, (a + b - 2.0 * secant) / h**2], axis=1)
    return np.vstack([rows, np.zeros(4)])
