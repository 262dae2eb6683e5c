"""Controllers of one's own: `own_controller = { file = "hold.py", name = "Hold" }` in a flight's file."""

from __future__ import annotations

import inspect
import sys
import traceback
from collections.abc import Callable, Mapping
from importlib import util
from pathlib import Path
from typing import Any, cast

from jax_aero.base.terminal import ConfigError


def load(config: Mapping[str, Any]) -> Callable[[Any], Any] | None:
    """Return the controller of a flight, if it has one: the function of that name, or an object of that class.

    The class is given the configuration; the file may import others of its folder.

    Raises
    ------
    ConfigError
        If the file cannot be run, or has no such name.
    """
    own = config.get("own_controller")
    if not own:
        return None
    file, name = own["file"], own["name"]
    try:
        found = getattr(_run(Path(file)), name, None)
        controller: Any = found if not inspect.isclass(found) else cast(Any, found)(config)
    except Exception as reason:
        raise ConfigError.of("own_controller.file", file, f"a program that runs; {_where(reason, file)}") from reason
    if not callable(controller):
        raise ConfigError.of("own_controller.name", name, f"the name of a function or class in {file}")

    def command(measurement: Any) -> Any:
        try:
            thrust_rate, joint_torque = controller(measurement)
        except Exception as reason:
            raise ValueError(f"own controller at {measurement.time:g} s: {_where(reason, file)}") from reason
        return thrust_rate, joint_torque

    return command


def _run(file: Path) -> Any:
    spec = util.spec_from_file_location(f"own_controller_{file.stem}", file)
    if spec is None or spec.loader is None:
        raise ImportError(f"{file.name} is no Python file")
    module = util.module_from_spec(spec)
    sys.modules[spec.name] = module  # classes look their module up
    sys.path.append(str(file.parent))
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(file.parent))
    return module


def _where(reason: Exception, file: str) -> str:
    lines = [str(frame.lineno) for frame in traceback.extract_tb(reason.__traceback__) if frame.filename == file]
    return f"{file}{''.join(f', line {line}' for line in lines[-1:])}: {type(reason).__name__}: {reason}"
