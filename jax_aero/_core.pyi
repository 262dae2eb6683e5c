"""Types of the compiled module; the crate itself is `rust/py`.

Names with a leading underscore exist only for the type checker. `tests/project/test_stub.py`
checks that the others are exactly the names that the module exports.
"""

from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from typing import Any, Literal, TypedDict, final

import numpy as np
from numpy.typing import NDArray

__version__: str

class PanicException(RuntimeError): ...

_Array = NDArray[np.float64]
_Progress = Callable[[int, int], None]

class _QpAnswer(TypedDict):
    status: str
    status_code: int
    iterations: int
    kkt: float
    active: int

class _FlightResult(TypedDict):
    log: dict[str, _Array]
    joint_setpoint: _Array
    outcome: Literal["completed", "off_course", "fell", "diverged"]
    lost_time: float | None
    lost_reason: str | None
    summary: dict[str, float]

@final
class Robot:
    def __new__(cls, path: str | PathLike[str]) -> Robot: ...
    @property
    def name(self) -> str: ...
    @property
    def mass(self) -> float: ...
    @property
    def gravity(self) -> float: ...
    @property
    def joint_names(self) -> list[str]: ...
    @property
    def joint_limits(self) -> list[tuple[float, float]]: ...
    @property
    def joint_stops(self) -> list[tuple[float, float]]: ...
    @property
    def joint_groups(self) -> dict[str, list[str]]: ...
    @property
    def body_names(self) -> list[str]: ...
    @property
    def aero_link_names(self) -> list[str]: ...
    @property
    def jet_names(self) -> list[str]: ...
    @property
    def thrust_max(self) -> list[float]: ...
    @property
    def foot_names(self) -> list[str]: ...
    @property
    def toml_text(self) -> str: ...
    @property
    def urdf_text(self) -> str: ...
    def dynamics(
        self, base_position: _Array, base_rotation: _Array, joint_position: _Array, velocity: _Array
    ) -> dict[str, _Array]: ...
    def frame_jacobian(
        self, frame: str, base_position: _Array, base_rotation: _Array, joint_position: _Array, velocity: _Array
    ) -> tuple[_Array, _Array]: ...
    def forward_dynamics(
        self, base_position: _Array, base_rotation: _Array, joint_position: _Array, velocity: _Array, force: _Array
    ) -> _Array: ...

@final
class ControllerState:
    def with_posture_control(
        self, posture: _Array, inertia_0_b: _Array, velocity_error_integral: _Array
    ) -> ControllerState: ...

@final
class Controller:
    def __new__(cls, config_json: str) -> Controller: ...
    state: ControllerState | None
    def start(
        self,
        time: float,
        base_position: _Array,
        base_rotation: _Array,
        joint_position: _Array,
        velocity: _Array,
        thrust: _Array,
        wind: _Array,
        foot_wrenches: _Array | None = None,
    ) -> None: ...
    def tick(
        self,
        time: float,
        base_position: _Array,
        base_rotation: _Array,
        joint_position: _Array,
        velocity: _Array,
        thrust: _Array,
        wind: _Array,
        setpoint: Mapping[str, _Array] | None = None,
        foot_wrenches: _Array | None = None,
    ) -> dict[str, Any]: ...
    def replace_command(self, thrust_rate: _Array, joint_torque: _Array) -> None: ...

class _Measurement(TypedDict):
    time: float
    base_position: _Array
    base_rotation: _Array
    joint_position: _Array
    velocity: _Array
    thrust: _Array
    wind: _Array

@final
class Plant:
    def __new__(cls, config_json: str) -> Plant: ...
    def reset(self) -> None: ...
    def measure(self) -> _Measurement: ...
    def step(self, thrust_rate: _Array, joint_torque: _Array, link_forces: _Array | None) -> _Array: ...

@final
class BoxQpSolver:
    def __new__(cls, n: int, solver: str = "active_set") -> BoxQpSolver: ...
    def solve(self, h: _Array, g: _Array, lower: _Array, upper: _Array) -> tuple[_Array, _QpAnswer]: ...
    def reset(self) -> None: ...

def kkt_residual(h: _Array, g: _Array, lower: _Array, upper: _Array, x: _Array) -> float: ...
def aero_forces(robot: Robot, aero_json: str, axes: _Array, v_air: _Array) -> _Array: ...
def link_forces(
    robot: Robot,
    aero_json: str,
    base_position: _Array,
    base_rotation: _Array,
    joint_position: _Array,
    velocity: _Array,
    wind: _Array,
) -> _Array: ...
def setpoint_trajectory(config_json: str, com: _Array, rotation: _Array) -> dict[str, _Array]: ...
def wind_velocity(wind_json: str, times: _Array) -> _Array: ...
def schemas() -> str: ...
def signals() -> str: ...
def figures() -> str: ...
def resolve_config(path: str | PathLike[str]) -> str: ...
def check_config(config_json: str) -> None: ...
def config_digest(config_json: str) -> str: ...
def fly(config_json: str, progress: _Progress | None = None) -> _FlightResult: ...
def fly_batch(
    config_jsons: Sequence[str],
    threads: int | None = None,
    progress: _Progress | None = None,
    full_log: bool = False,
) -> list[_FlightResult]: ...
