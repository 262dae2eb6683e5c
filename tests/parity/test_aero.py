"""Link forces against formulas written independently from the paper and from the published tables.

The axisymmetric formula stands here as printed, with its arc cosine and its division by sin α; the tables of the
sphere and cylinder model are interpolated by scipy.
"""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from jax_aero import rust
from jax_aero.rust import Robot

ROOT = Path(__file__).resolve().parents[2]
AERO = ROOT / "configs" / "aero"
SAMPLES = 400
TOLERANCE = 1e-10


@pytest.fixture(scope="module")
def iron_cub():
    return Robot(ROOT / "configs" / "robot" / "ironcub_mk1.toml")


@pytest.fixture(scope="module")
def table(iron_cub):
    return tomllib.loads(iron_cub.toml_text)


def load(name):
    return tomllib.loads((AERO / f"{name}.toml").read_text(encoding="utf-8"))


def samples(links):
    """Random axes and winds from a breath to a storm, none nearer to an axis than a milliradian or so."""
    rng = np.random.default_rng(20260103)
    for _ in range(SAMPLES):
        axes = rng.normal(size=(links, 3))
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        v_air = rng.normal(size=(links, 3))
        v_air *= np.exp(rng.uniform(np.log(1e-2), np.log(60), (links, 1))) / np.linalg.norm(
            v_air, axis=1, keepdims=True
        )
        yield axes, v_air


def compare(agree, quantity, ours, theirs):
    """Per link, relative to its own force."""
    for force, expected in zip(ours, theirs, strict=True):
        agree(quantity, force, expected, TOLERANCE)


# --- axisymmetric ------------------------------------------------------------------------------------------------


def printed_force(cda, cna, axis, v_air, air_density):
    """F = −k_a |v_a| C_D A(α) v_a + k_a C_N A(α)/sin α (v_a × k̂) × v_a,   v_a = −v_air,   k_a = ρ/2."""
    v_a = -v_air
    speed = np.linalg.norm(v_a)
    alpha = np.arccos(axis @ v_a / (speed + 1e-9))
    w0, w1, w2, w3, w4 = cda
    drag_area = w0 + w1 * np.cos(alpha) + w2 * np.sin(alpha) ** 2 + w3 * np.sin(alpha) ** 3 + w4 * np.cos(alpha) ** 3
    normal_area = cna * np.sin(alpha) ** 2 * np.cos(alpha)
    k_a = air_density / 2
    return -k_a * speed * drag_area * v_a + k_a * normal_area / np.sin(alpha) * np.cross(np.cross(v_a, axis), v_a)


@pytest.mark.parametrize("coefficients", ["published", "corrected", "signed", "alternative"])
def test_axisymmetric_forces_follow_the_printed_formula(iron_cub, table, coefficients, agree):
    aero = load(f"axisymmetric_{coefficients}")
    assert aero["coefficients"] == coefficients
    sets = [table["coefficients"][coefficients][link["family"]] for link in table["aero_links"]]
    for axes, v_air in samples(len(sets)):
        theirs = [
            printed_force(areas["cda"], areas["cna"], axis, v, aero["air_density"])
            for areas, axis, v in zip(sets, axes, v_air, strict=True)
        ]
        compare(agree, f"axisymmetric, {coefficients}", rust.aero_forces(iron_cub, aero, axes, v_air), theirs)


# --- spheres and cylinders -----------------------------------------------------------------------------------------


class PublishedTables:
    """Coefficients as the published controller computes them from its tables."""

    def __init__(self, aero):
        cylinder, sphere = aero["cylinder"], aero["sphere"]
        self.cylinder = cylinder
        self.crosswind = PchipInterpolator(cylinder["reynolds"], cylinder["crosswind_drag"])
        self.finite = PchipInterpolator(cylinder["diameter_over_length"], cylinder["finite_length_drag"])
        self.axial = PchipInterpolator(cylinder["length_over_diameter"], cylinder["axial_drag"])
        self.sphere = PchipInterpolator(sphere["reynolds"], sphere["drag"])
        self.sphere_low, self.sphere_high = sphere["reynolds"][0], sphere["reynolds"][-1]
        self.last, self.slow = sphere["drag"][-1], sphere["drag_below_reynolds_10"]

    def sphere_drag(self, reynolds):
        if reynolds < 10:
            return self.slow
        if reynolds <= self.sphere_low:
            return 24 / reynolds * (1 + 0.150 * reynolds**0.681) + 0.407 / (1 + 8710 / reynolds)
        return self.sphere(reynolds) if reynolds <= self.sphere_high else self.last

    def cylinder_coefficients(self, reynolds, alpha, diameter, length):
        infinite = self.crosswind(reynolds)
        at_reference = np.interp(1e5, self.cylinder["reynolds"], self.cylinder["crosswind_drag"])
        crosswind = infinite * self.finite(diameter / length) / 1.19
        axial = self.axial(length / diameter) / 1.17 * (np.pi / 4) / (length / diameter) * infinite / at_reference
        drag = axial + (crosswind - axial) * np.abs(np.sin(alpha)) ** 3
        return drag, crosswind * np.sin(alpha) * np.cos(alpha)

    def force(self, link, axis, v, density, viscosity):
        diameter, length = link["diameter"], link["length"]
        speed = np.linalg.norm(v)
        reynolds = density * speed * diameter / viscosity
        if link.get("is_sphere"):
            drag, normal, area = self.sphere_drag(reynolds), 0.0, np.pi / 4 * length * diameter
        else:
            alpha = np.arccos(axis @ -v / (speed + 1e-9))
            drag, normal = self.cylinder_coefficients(reynolds, alpha, diameter, length)
            area = length * diameter
        return density / 2 * area * (drag * speed * v + normal * np.cross(np.cross(v, axis), v))


def test_sphere_and_cylinder_forces_follow_the_published_tables(iron_cub, table, agree):
    aero = load("sphere_cylinder")
    tables = PublishedTables(aero)
    links = table["aero_links"]
    reynolds = []
    for axes, v_air in samples(len(links)):
        theirs = [
            tables.force(link, axis, v, aero["air_density"], aero["dynamic_viscosity"])
            for link, axis, v in zip(links, axes, v_air, strict=True)
        ]
        compare(agree, "sphere and cylinder", rust.aero_forces(iron_cub, aero, axes, v_air), theirs)
        reynolds += [np.linalg.norm(v) * link["diameter"] for v, link in zip(v_air, links, strict=True)]
    # Both the laminar end and the drag crisis of both tables were visited.
    scale = aero["air_density"] / aero["dynamic_viscosity"]
    assert min(reynolds) * scale < 200
    assert max(reynolds) * scale > 5e5
