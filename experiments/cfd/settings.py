"""Numbers of a simulation: mesh, solver, air, and the tests that a result must pass."""

from __future__ import annotations

import math

from jax_aero import tables
from jax_aero.tables import Count, Fraction, Natural, Positive


class Shell(tables.Table, frozen=True):
    """Cells within a distance of the surface are at least of this level."""

    distance: Positive
    """[m]"""
    level: Count


class Mesh(tables.Table, frozen=True):
    """A cube of cubes, halved towards the surface: a cell of level n has the edge `base / 2^n`.

    The mesher finds the surface by lines from cell centre to cell centre, which miss a body that is thinner than the
    first cells. Shells find it whatever its size, if the n-th reaches half the diagonal of a cell of level n − 1.
    """

    half_width: Positive = 5.0
    """Of the cube [m]."""
    base: Positive = 0.72
    """Edge of a cell of level 0, at most [m]."""
    surface_level: Count = 6
    """Of the cells at the surface."""
    shells: tuple[Shell, ...] = (
        Shell(distance=0.023, level=6),
        Shell(distance=0.05, level=5),
        Shell(distance=0.15, level=4),
        Shell(distance=0.4, level=3),
        Shell(distance=1.2, level=2),
    )

    def __post_init__(self) -> None:
        if self.surface_level not in (levels := [shell.level for shell in self.shells]):
            raise ValueError(f"`shells` have the levels {levels}; expected one of surface_level, {self.surface_level}")
        for shell in self.shells:
            reach = math.sqrt(3.0) * self.edge(shell.level)
            if shell.distance < reach:
                raise ValueError(
                    f"`shells` of level {shell.level} reach {shell.distance} m; expected at least {reach:.4f} m"
                )

    @property
    def cells_across(self) -> int:
        """Return the number of cells of level 0 along an edge of the cube."""
        return math.ceil(2.0 * self.half_width / self.base - 1e-9)  # a base that divides the cube is kept

    def edge(self, level: int) -> float:
        """Return the edge of a cell of a level [m]."""
        return 2.0 * self.half_width / self.cells_across * 0.5**level

    @property
    def finest(self) -> float:
        """Return the edge of a cell at the surface [m]."""
        return self.edge(self.surface_level)


class Air(tables.Table, frozen=True):
    """The free stream."""

    speed: Positive = 17.0
    """[m/s]; of the public simulations."""
    density: Positive = 1.225
    """[kg/m³]"""
    viscosity: Positive = 1.469e-5
    """Kinematic [m²/s]."""
    turbulence_intensity: Positive = 1e-3
    viscosity_ratio: Positive = 1.0
    """Turbulent over molecular viscosity far away."""


class Solver(tables.Table, frozen=True):
    """Iterations of SIMPLEC."""

    upwind_iterations: Natural = 16
    """The first ones, with first-order convection: a start from rest would diverge without."""
    iterations: Count = 100
    """All of them, without extensions."""
    window: Count = 40
    """The last ones, over which forces are averaged."""
    sampling: Count = 4
    """Iterations between two samples of the forces."""
    extensions: Natural = 0
    """How often a solve that is not steady goes on by the length of a window, over which it is then judged anew."""
    ranks: Count = 1
    """Processes of one solve (MPI)."""

    def __post_init__(self) -> None:
        if self.upwind_iterations + self.window > self.iterations:
            raise ValueError(
                f"`iterations` is {self.iterations}; expected at least upwind_iterations + window, "
                f"{self.upwind_iterations + self.window}"
            )
        if self.window < 8 * self.sampling:
            raise ValueError(f"`window` is {self.window}; expected at least 8 samples, {8 * self.sampling}")


class Accept(tables.Table, frozen=True):
    """What a result must keep to; one that does not is left out of the dataset, with the reason in its file."""

    drift: Fraction = 0.02
    """Mean force of the window's second half less that of its first, over the size of the mean."""
    oscillation: Fraction = 0.05
    """Standard deviation of the force in the window, over the size of the mean."""
    finest_share: Fraction = 0.5
    """Cells of the surface's level, over surface area / (edge of such a cell)²."""


class Settings(tables.Table, frozen=True):
    """Everything that decides the result of a posture and a wind, but for the robot."""

    mesh: Mesh = Mesh()
    air: Air = Air()
    solver: Solver = Solver()
    accept: Accept = Accept()


class FlowConfig(tables.Table, frozen=True):
    """A flow that is kept for pictures; here, as the schema of files must not need the packages of `flow.py`."""

    title: str
    posture: str
    """A name of `configs/tables/postures.toml`."""
    pitch_deg: float
    """Of the robot's vertical axis above the horizontal wind."""
    yaw_deg: float = 0.0
    settings: Settings = Settings()
