"""A panel model of the robot with wakes: a source of data where no free-stream CFD is available.

The panels i (area A, outward normal n, position x) are fixed to the links, which are cylinders closed by hemispheres.
In a wind of unit vector w a panel has c = −n·w, and every cluster k of panels sheds, from its centre, a wake of
strength S_k = Σ A max(c, 0):

    dx = max((x_i − x_k)·w, 0),   r = distance across the wind,   s² = κ S_k/π + (grow dx)²
    D_i = Σ_k σ((dx − x₀)/(x₀/4)) S_k/(2π s²) exp(−r²/2s²) exp(−dx/decay),      η_i = exp(−γ D_i)
    E_i = the sum D_i with dx = max((x_k − x_i)·w, 0), no growth, length up_length

η is the share of the dynamic pressure at the panel, E how far a body close downstream raises the base pressure. The
force area of link l in family f is linear in the family's twelve coefficients:

    F_l = Σ_m b_fm G_lm,   G = −Σ_i A n φ_m,   φ: see `TERMS`;   the last term is friction, Σ_i A η (w + c n)

This model is ours. Its coefficients come from published drag curves and from tunnel and CFD tables of all postures but
two, see `configs/aero/panels/surrogate.toml`.

Equation M30 of `docs/model.md`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jax_aero import tables
from jax_aero.aero.dataset import LINK_TWINS, LINKS, MIRROR_AXES, Floats, Indices
from jax_aero.aero.fit import FAMILIES
from jax_aero.aero.posture import link_frames
from jax_aero.robot import RobotModel
from jax_aero.types import Array

TERMS = (
    *("eta_c", "eta_c2", "eta_c3", "eta_front", "shadow_front", "shadow_c"),
    *("back", "back_c", "back_c2", "eta_back", "filled_back", "friction"),
)
"""The twelve terms: η c₊, η c₊², η c₊³, η [c>0], (1−η) [c>0], (1−η) c₊, [c<0], c₋, c₋², η [c<0], E [c<0], friction.

[c>0] is smooth, σ(c / `EDGE`)."""

TAU = 2.0 * np.pi
TINY = 1e-9
"""Area that keeps the centre of a wake source of zero strength finite [m²]."""
EDGE = 0.05
"""Width of the smooth transition of c from front to back."""
BLOCK = 64
"""Rows per call of the compiled function."""


class Wake(NamedTuple):
    """Parameters of the wakes; lengths in metres."""

    gamma: float
    kappa: float
    grow: float
    start: float
    """Distance x₀ at which a wake begins [m]."""
    decay: float
    up_length: float


class Panels(NamedTuple):
    """Panels of all links, in link axes."""

    area: Float[np.ndarray, " k"]
    """Areas [m²]."""
    normal_l: Float[np.ndarray, "k 3"]
    """Outward unit normals."""
    position_l: Float[np.ndarray, "k 3"]
    """Positions [m], link axes."""
    link: tuple[int, ...]
    """Index of the panel's link in `LINKS`."""
    cluster: tuple[int, ...]
    """Index of the panel's wake source."""


class Surrogate(NamedTuple):
    """The panel model: panels, wakes and coefficients."""

    panels: Panels
    wake: Wake
    coefficients: Float[np.ndarray, "L 12"]
    """Coefficients of each link, equal within a family."""


def capsule(
    diameter: float, length: float, spacing: float
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]]:
    """Return the panels of a cylinder about the z axis closed by hemispheres, or of a sphere if the length is 0.

    Returns areas [m²], outward normals and positions relative to the middle [m], about `spacing` apart. The areas add
    up to that of the body, and the panels have the body's planes of symmetry.
    """
    radius, half = 0.5 * diameter, 0.5 * length
    around = 2 * max(3, round(np.pi * diameter / spacing / 2))
    rings = max(2, round(0.5 * np.pi * radius / spacing))
    edges = np.cos(np.linspace(0.0, 0.5 * np.pi, rings + 1))
    # Rings as (area, polar angle of the normal, height of the middle): both caps, then the cylinder.
    table = []
    for high, low in itertools.pairwise(edges):
        area, polar = TAU * radius**2 * (high - low), np.arccos(0.5 * (high + low))
        table += [(area, polar, half), (area, np.pi - polar, -half)]
    if length > 0.0:
        count = max(1, round(length / spacing))
        heights = ((np.arange(count) + 0.5) / count - 0.5) * length
        table += [(TAU * radius * length / count, 0.5 * np.pi, height) for height in heights]
    area, polar, height = (np.repeat(column, around) for column in np.array(table).T)
    azimuth = np.tile((np.arange(around) + 0.5) * TAU / around, len(table))
    normal = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=1)
    return area / around, normal, radius * normal + height[:, None] * np.array([0.0, 0.0, 1.0])


def build_panels(robot: RobotModel, spacing: float, cluster_size: float) -> Panels:
    """Cover every link with a capsule about its axis and centre; a right link gets the left link's mirror image.

    Parameters
    ----------
    robot
        Robot whose aerodynamic links are those of the tables.
    spacing
        Desired distance between panels [m].
    cluster_size
        Edge of the link-fixed cubes, each of whose panels form one wake source [m].
    """
    links = robot.aero_links
    straight = link_frames(robot, np.zeros((1, 19)))
    bodies: list[tuple[Floats, Floats, Floats]] = []
    numbers: list[Indices] = []
    for index, name in enumerate(LINKS):
        twin = int(LINK_TWINS[index])
        if twin < index:  # the right one of a pair; left ones come first
            area, normal, position = bodies[twin]
            mirror = straight.rotations[0, index].T @ np.diag(MIRROR_AXES)
            turn = mirror @ straight.rotations[0, twin]
            shift = mirror @ straight.positions[0, twin]
            shift = shift - straight.rotations[0, index].T @ straight.positions[0, index]
            bodies.append((area, normal @ turn.T, position @ turn.T + shift))
            numbers.append(numbers[twin])
            continue
        length = 0.0 if links.is_sphere[index] else float(links.lengths[index])
        area, normal, position = capsule(float(links.diameters[index]), length, spacing)
        # Cubes are centred on the link, so that the sources of a symmetric link are symmetric.
        _, number = np.unique(np.floor(position / cluster_size + 0.5), axis=0, return_inverse=True)
        numbers.append(number.reshape(-1).astype(np.int64))
        turn = _rotation_from_z(np.asarray(links.axes[index]), name)
        centre = np.asarray(links.centres[index])
        if twin == index:
            # A millimetre off the robot's plane of symmetry is a manufacturing tolerance.
            lateral = straight.rotations[0, index, 1]
            centre = centre - lateral * (lateral @ centre + straight.positions[0, index, 1])
        bodies.append((area, normal @ turn.T, position @ turn.T + centre))
    first = np.cumsum([0, *(number.max() + 1 for number in numbers)])
    return Panels(
        area=np.concatenate([body[0] for body in bodies]),
        normal_l=np.concatenate([body[1] for body in bodies]),
        position_l=np.concatenate([body[2] for body in bodies]),
        link=tuple(int(index) for index, body in enumerate(bodies) for _ in body[0]),
        cluster=tuple(int(first[index] + n) for index, number in enumerate(numbers) for n in number),
    )


def _rotation_from_z(axis: Floats, name: str) -> Floats:
    """Return a rotation that maps z to the given coordinate axis, and coordinate planes to coordinate planes."""
    for place, rows in ((2, [0, 1, 2]), (1, [1, 2, 0]), (0, [2, 0, 1])):
        if abs(axis[place]) > 1.0 - 1e-9:
            # A cyclic permutation is a rotation; the sign is irrelevant, since both ends of a capsule are equal.
            return np.eye(3)[:, rows].T
    raise ValueError(f"axis of `{name}` is {axis.tolist()}; expected one of the link's own axes")


def features_of(
    panels: Panels, wake: Wake
) -> Callable[[Float[Array, "L 3 3"], Float[Array, "L 3"], Float[Array, "3"]], Float[Array, "L 12 3"]]:
    """Return the function of rotations, positions [m] and wind that gives G [m²], base axes."""
    link, cluster = np.array(panels.link), np.array(panels.cluster)
    of_cluster = (np.arange(cluster.max() + 1)[:, None] == cluster).astype(float)
    of_link = (np.arange(len(LINKS))[:, None] == link).astype(float)

    def features(rotations: Array, positions: Array, wind: Array) -> Array:
        dtype = wind.dtype
        area = jnp.asarray(panels.area, dtype)
        # The reduced precision of matrix units would shift positions by centimetres.
        with jax.default_matmul_precision("highest"):
            normal = jnp.einsum("iab,ib->ia", rotations[link], jnp.asarray(panels.normal_l, dtype))
            place = jnp.einsum("iab,ib->ia", rotations[link], jnp.asarray(panels.position_l, dtype)) + positions[link]
            c = -normal @ wind
            front, back = jnp.maximum(c, 0.0), jnp.maximum(-c, 0.0)
            shed = jnp.asarray(of_cluster, dtype) * (area * front)
            strength = shed.sum(axis=1)
            # A cluster of zero strength has no centre; its position has no effect.
            source = shed @ place / jnp.maximum(strength, TINY)[:, None]
            eta, filled = _wakes(wake, place, source, strength, wind)
            # Smooth, so that panels edge-on to the wind, such as rows of a capsule, do not switch with rounding of c.
            is_front, is_back = jax.nn.sigmoid(c / EDGE), jax.nn.sigmoid(-c / EDGE)
            lost = 1.0 - eta
            pressure = jnp.stack(
                [
                    *(eta * front, eta * front**2, eta * front**3, eta * is_front, lost * is_front, lost * front),
                    *(is_back, back, back**2, eta * is_back, filled * is_back),
                ]
            )
            pushes = -(area * pressure)[:, :, None] * normal
            friction = (area * eta)[:, None] * (wind + c[:, None] * normal)
            return jnp.einsum("li,mia->lma", jnp.asarray(of_link, dtype), jnp.concatenate([pushes, friction[None]]))

    return features


def _wakes(wake: Wake, place: Array, source: Array, strength: Array, wind: Array) -> tuple[Array, Array]:
    """Share of the dynamic pressure η, and base pressure rise E, at each panel; (I,) each."""
    offset = place[:, None, :] - source[None, :, :]
    dx = offset @ wind
    across = jnp.maximum(jnp.sum(offset**2, axis=-1) - dx**2, 0.0)
    width = wake.kappa * strength / jnp.pi + TINY
    down, up = jnp.maximum(dx, 0.0), jnp.maximum(-dx, 0.0)

    def share(spread: Array, distance: Array, length: float) -> Array:
        begun = jax.nn.sigmoid((distance - wake.start) * (4.0 / wake.start))
        profile = strength / (TAU * spread) * jnp.exp(-across / (2.0 * spread) - distance / length)
        return jnp.sum(begun * profile, axis=1)

    deficit = share(width + (wake.grow * down) ** 2, down, wake.decay)
    return jnp.exp(-wake.gamma * deficit), share(width, up, wake.up_length)


Features: TypeAlias = Callable[[Floats, Floats], Floats]


def batched_features(robot: RobotModel, panels: Panels, wake: Wake, dtype: Any = np.float32) -> Features:
    """Return the function (joint angles (N, 19) [deg], winds (N, 3)) → G (N, 13, 12, 3) [m²], base axes.

    Rows pass through one compiled function in blocks of equal size. On a CPU the rows of a block are evaluated one by
    one, since the data of one row fit into the cache; on an accelerator all at once.
    """
    features = features_of(panels, wake)
    if jax.default_backend() == "cpu":
        mapped = jax.jit(lambda *rows: jax.lax.map(lambda row: features(*row), rows))
    else:
        mapped = jax.jit(jax.vmap(features))

    def evaluate(joint_position_deg: Floats, wind_b: Floats) -> Floats:
        frames = link_frames(robot, joint_position_deg)
        found = []
        for start in range(0, len(wind_b), BLOCK):
            rows = np.arange(start, start + BLOCK).clip(max=len(wind_b) - 1)
            arrays = (frames.rotations[rows], frames.positions[rows], wind_b[rows])
            block = mapped(*(jnp.asarray(array, dtype) for array in arrays))
            found.append(np.asarray(block, dtype=np.float64)[: len(wind_b) - start])
        return np.concatenate(found)

    return evaluate


class _File(tables.Table, frozen=True):
    panels: dict[str, tables.Positive]
    wake: dict[str, tables.Positive]
    coefficients: dict[str, tuple[float, ...]]

    def __post_init__(self) -> None:
        expected = {"panels": ("spacing", "cluster_size"), "wake": Wake._fields, "coefficients": tuple(FAMILIES)}
        for section, keys in expected.items():
            if set(found := getattr(self, section)) != set(keys):
                raise ValueError(f"`{section}` has {', '.join(found) or 'nothing'}; expected {', '.join(keys)}")
        for family, weights in self.coefficients.items():
            if len(weights) != len(TERMS):
                raise ValueError(f"`coefficients.{family}` has {len(weights)} numbers; expected {len(TERMS)} numbers")


def load_surrogate(path: str | PathLike[str], robot: RobotModel) -> Surrogate:
    """Read `configs/aero/panels/surrogate.toml` or a file like it.

    Raises
    ------
    ValueError
        If the content is invalid; the message names the key, its value and what was expected.
    """
    file = tables.load(Path(path), _File)
    rows = {link: weights for family, weights in file.coefficients.items() for link in FAMILIES[family]}
    return Surrogate(
        panels=build_panels(robot, **file.panels),
        wake=Wake(**file.wake),
        coefficients=np.array([rows[link] for link in LINKS], dtype=np.float64),
    )


def force_areas(
    coefficients: Float[np.ndarray, "L 12"], features: Float[np.ndarray, "B L 12 3"]
) -> Float[np.ndarray, "B L 3"]:
    """Return the force areas [m²], base axes, from coefficients and features [m²]."""
    areas: Floats = np.einsum("lm,nlma->nla", coefficients, features)
    return areas
