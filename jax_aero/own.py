"""Controllers of one's own: `own_controller = { file = "hold.py", name = "Hold" }` in a flight's file.

Each flight's runs in a process of its own, which holds nothing of the simulator: it receives what is measured, the
set-point and the time, and a class beforehand what `view` leaves of the configuration.
"""

from __future__ import annotations

import inspect
import json
import os
import pickle
import subprocess
import sys
import time
import traceback
import weakref
from collections.abc import Mapping
from importlib import util
from pathlib import Path
from typing import Any, cast

from jax_aero.base.terminal import ConfigError

KNOWN = ("duration", "jets", "fall")
"""Keys of the simulator that a controller is given."""


class Own:
    """The controller of a flight: the function of that name, or an object of that class.

    The class is given `view` of the configuration; the file may import others of its folder.

    Raises
    ------
    ConfigError
        If the file cannot be run, or has no such name.
    """

    def __init__(self, config: Mapping[str, Any], robot: Any) -> None:
        own = config["own_controller"]
        words = [sys.executable, "-c", "from jax_aero import own; own.serve()"]
        self._process = subprocess.Popen(  # in a session of its own: Ctrl-C ends the flight, and with it this one
            words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
        )
        weakref.finalize(self, _stop, self._process)
        self.times: list[float] = []
        """Time that each tick took [s]."""
        answer = self._ask((own["file"], own["name"], view(config, robot)))
        if "reason" in answer:
            raise ConfigError.of("own_controller.file", own["file"], f"a program that runs; {answer['reason']}")
        if not answer["is_callable"]:
            expected = f"the name of a function or class in {own['file']}"
            raise ConfigError.of("own_controller.name", own["name"], expected)

    def __call__(self, measurement: Any) -> Any:
        """Return thrust rates and joint torques; raise `ValueError` if the controller raises or leaves."""
        answer = self._ask(measurement)
        if "reason" in answer:
            raise ValueError(f"own controller at {measurement.time:g} s: {answer['reason']}")
        self.times.append(answer["seconds"])
        return answer["thrust_rate"], answer["joint_torque"]

    def _ask(self, question: Any) -> dict[str, Any]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            pickle.dump(question, self._process.stdin)
            self._process.stdin.flush()
            answer: dict[str, Any] = json.loads(self._process.stdout.readline())
        except (OSError, ValueError):
            return {"reason": "its process has ended"}
        return answer


def view(config: Mapping[str, Any], robot: Any) -> dict[str, Any]:
    """Return what a controller of a robot is given: it, mission, controller, engines, lengths of tick and flight.

    Wind, air, sensors and disturbances are replaced by none, the start by another one.
    """
    simulator = config["simulator"]
    start = {key: [0.0] * len(value) for key, value in simulator["initial"].items() if isinstance(value, list)}
    start["thrust"] = list(robot.thrust_min)
    start["joint_position"] = [min(max(lower, 0.0), upper) for lower, upper in robot.joint_limits]
    known = {key: simulator[key] for key in KNOWN} | {"aero": {"model": "off"}, "initial": start}
    still = {"profile": "constant", "velocity": [0.0] * 3}
    return {key: config[key] for key in ("robot", "controller", "mission")} | {"simulator": known, "wind": still}


def serve() -> None:
    """Answer the process of the flight; what the controller prints goes to the terminal's error output."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    questions = sys.stdin.buffer
    file, name, config = pickle.load(questions)

    def reply(**answer: Any) -> None:
        answers.write(json.dumps(answer) + "\n")
        answers.flush()

    try:
        named = getattr(_run(Path(file)), name, None)
        controller: Any = named if not inspect.isclass(named) else cast(Any, named)(config)
    except Exception as reason:
        reply(reason=_where(reason, file))
        return
    reply(is_callable=callable(controller))
    while True:
        try:
            measurement = pickle.load(questions)
        except EOFError:  # the flight has ended
            return
        started = time.perf_counter()
        try:
            command = [[float(x) for x in part] for part in controller(measurement)]
            thrust_rate, joint_torque = command
        except Exception as reason:
            reply(reason=_where(reason, file))
        else:
            seconds = time.perf_counter() - started
            reply(thrust_rate=thrust_rate, joint_torque=joint_torque, seconds=seconds)


def _stop(process: subprocess.Popen[bytes]) -> None:
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            pipe.close()
    process.kill()  # a controller that computes for ever reads no end
    process.wait()


def _run(file: Path) -> Any:
    spec = util.spec_from_file_location(f"own_controller_{file.stem}", file)
    if spec is None or spec.loader is None:
        raise ImportError(f"{file.name} is no Python file")
    module = util.module_from_spec(spec)
    sys.modules[spec.name] = module  # classes look their module up
    sys.path.append(str(file.parent))
    spec.loader.exec_module(module)
    return module


def _where(reason: Exception, file: str) -> str:
    lines = [str(frame.lineno) for frame in traceback.extract_tb(reason.__traceback__) if frame.filename == file]
    return f"{file}{''.join(f', line {line}' for line in lines[-1:])}: {type(reason).__name__}: {reason}"
