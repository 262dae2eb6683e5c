"""Settings of a simulation: mesh, solver, air, and acceptance criteria of a result."""

from __future__ import annotations

import math

from jax_aero.base import tables
from jax_aero.base.tables import Count, Fraction, Natural, Positive
from jax_aero.base.terminal import ConfigError


class Shell(tables.Table, frozen=True):
    """Cells within a distance of the surface have at least this level."""

    distance: Positive
    """Distance from the surface [m]."""
    level: Count


class Mesh(tables.Table, frozen=True):
    """A cube of cubic cells, halved towards the surface: a cell of level n has the edge `base / 2^n`.

    The mesher finds the surface along lines between cell centres, which miss a body thinner than the first cells.
    Shells find every body, if the n-th shell reaches half the diagonal of a cell of level n − 1.
    """

    half_width: Positive = 5.0
    """Half the edge of the cube [m]."""
    base: Positive = 0.72
    """Greatest edge of a cell of level 0 [m]."""
    surface_level: Count = 6
    """Level of the cells at the surface."""
    shells: tuple[Shell, ...] = (
        Shell(distance=0.023, level=6),
        Shell(distance=0.05, level=5),
        Shell(distance=0.15, level=4),
        Shell(distance=0.4, level=3),
        Shell(distance=1.2, level=2),
    )

    def __post_init__(self) -> None:
        if self.surface_level not in (levels := [shell.level for shell in self.shells]):
            raise ConfigError.of("surface_level", self.surface_level, f"one of the levels of `shells`, {levels}")
        for index, shell in enumerate(self.shells):
            reach = math.sqrt(3.0) * self.edge(shell.level)
            if shell.distance < reach:
                expected = f"at least {reach:.4f} m at level {shell.level}"
                raise ConfigError.of(f"shells[{index}].distance", shell.distance, expected)

    @property
    def cells_across(self) -> int:
        """Return the number of level-0 cells along an edge of the cube."""
        return math.ceil(2.0 * self.half_width / self.base - 1e-9)  # keeps a base that divides the cube

    def edge(self, level: int) -> float:
        """Return the edge of a cell of this level [m]."""
        return 2.0 * self.half_width / self.cells_across * 0.5**level

    @property
    def finest(self) -> float:
        """Return the edge of a cell at the surface [m]."""
        return self.edge(self.surface_level)


class Air(tables.Table, frozen=True):
    """The free stream."""

    speed: Positive = 17.0
    """Speed [m/s], as in the public simulations."""
    density: Positive = 1.225
    """Density [kg/m³]."""
    viscosity: Positive = 1.469e-5
    """Kinematic viscosity [m²/s]."""
    turbulence_intensity: Positive = 1e-3
    viscosity_ratio: Positive = 1.0
    """Turbulent over molecular viscosity in the free stream."""


class Solver(tables.Table, frozen=True):
    """Iterations of the SIMPLEC solver."""

    upwind_iterations: Natural = 16
    """Initial iterations with first-order convection, without which a start from rest diverges."""
    iterations: Count = 100
    """Number of all iterations, without extensions."""
    window: Count = 40
    """Number of last iterations over which forces are averaged."""
    sampling: Count = 4
    """Iterations between two samples of the forces."""
    extensions: Natural = 0
    """Greatest number of extensions by one window; after each, an unsteady solution is judged again."""
    ranks: Count = 1
    """Processes per solution (MPI)."""

    def __post_init__(self) -> None:
        if self.upwind_iterations + self.window > self.iterations:
            least = self.upwind_iterations + self.window
            raise ConfigError.of("iterations", self.iterations, f"at least upwind_iterations + window, {least}")
        if self.window < 8 * self.sampling:
            raise ConfigError.of("window", self.window, f"at least 8 samples, {8 * self.sampling}")


class Accept(tables.Table, frozen=True):
    """Acceptance criteria of a result; a refused one is left out of the dataset, with the reason in its file."""

    drift: Fraction = 0.02
    """Difference of the mean forces in the two halves of the window, relative to the mean."""
    oscillation: Fraction = 0.05
    """Standard deviation of the force in the window, relative to the mean."""
    finest_share: Fraction = 0.5
    """Number of cells of the surface's level, relative to the surface area / (edge of such a cell)²."""


class Settings(tables.Table, frozen=True):
    """Everything except the robot that determines the result of a posture and a wind."""

    mesh: Mesh = Mesh()
    air: Air = Air()
    solver: Solver = Solver()
    accept: Accept = Accept()


# Defined here, since the schema must not need the packages of `flow.py`.
class FlowConfig(tables.Table, frozen=True):
    """A flow stored for pictures."""

    title: str
    posture: str
    """A name in `configs/tables/postures.toml`."""
    pitch_deg: float
    """Angle of the robot's vertical axis above the horizontal wind."""
    yaw_deg: float = 0.0
    settings: Settings = Settings()
