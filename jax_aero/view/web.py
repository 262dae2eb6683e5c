"""The page of `rust/lab/page`: recorded flights, the simulator in WebAssembly, or both, written into it; its server."""

from __future__ import annotations

import base64
import copy
import errno
import http.server
import json
import lzma
import os
import re
import socket
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jax_aero import rust
from jax_aero.base.files import complete_file, read_bytes, read_json, resolve
from jax_aero.base.keys import get, set_key
from jax_aero.base.places import CONFIGS, HOME, RESULTS
from jax_aero.base.result import is_repeated, labels_of
from jax_aero.view import Refused, check_out, drawing
from jax_aero.view.recording import Recording
from jax_aero.view.shapes import Look, Mount, Shape, look_of

TEMPLATE = Path(__file__).with_name("page.html")
"""The page without data, which `make lab` builds."""

SIMULATOR = Path(__file__).with_name("simulator.wasm.xz")
"""The simulator, which `make lab` builds."""

PLACE = "/*DATA*/null"
"""Text in the template that is replaced by the data."""

RATE = 50.0
"""Samples of a recorded flight in the page [1/s]."""

FOLDER = CONFIGS / "experiments"
"""Folder from which the page's paths start."""

NETWORKS = CONFIGS / "aero/networks"

INCLUDED = (
    "aero/*.toml",
    "control/aero_aware.toml",
    "control/observer.toml",
    "control/mpc.toml",
    "law/*.toml",
    "mission/in_line.*",
    "mission/hover.*",
    "mission/closed_circuit.*",
    "mission/min_time.*",
    "aero/networks/default.*",
)
"""Files of `configs/` that the page's choices build on."""


def write_page(recordings: Sequence[Recording], out: Path) -> None:
    """Write one HTML file that plays a flight, with a second one as its ghost; written completely or not at all.

    Raises
    ------
    Refused
        If the page is not built, or if `out` is not an `.html` file in an existing folder.
    """
    check_out(out, ".html")
    page = fill_page(recordings)
    with complete_file(out) as draft:
        draft.write_text(page, encoding="utf-8")


def fill_page(
    recordings: Sequence[Recording],
    config: rust.Config | None = None,
    networks: bool = True,
    folders: Sequence[Path] = (),
) -> str:
    """Return the page that plays flights and, with a configuration, flies it with changes.

    Parameters
    ----------
    recordings
        Flights: the first one is solid, a second one its ghost. Without them the configuration is flown.
    config
        Resolved configuration of the first robot, with absolute paths.
    networks
        Whether all networks of `configs/aero/networks` can be chosen, or only the default one.
    folders
        Folders whose files the page may contain, beside `configs/`, `results/` and those of the recordings. A
        configuration may be another's and name any file.

    Raises
    ------
    Refused
        If the page is not built.
    """
    own = [CONFIGS, RESULTS, *(one.folder for one in recordings if one.folder is not None), *folders]
    robots = {str(one.robot_path): (one.look, one.robot) for one in recordings}
    if config is not None and not robots:
        robot = rust.Robot(config["robot"])
        robots[config["robot"]] = look_of(robot, Path(config["robot"])), robot
    table = {
        "version": rust.__version__,
        "looks": [look_table(*robot) for robot in robots.values()],
        "flights": [flight_table(one) | {"look": list(robots).index(str(one.robot_path))} for one in recordings],
        "simulator": None if config is None else simulator_table(config, networks, own),
    }
    # Within a script, `<` may begin its end or a comment.
    words = json.dumps(table, allow_nan=False).replace("<", "\\u003c")
    return _built(TEMPLATE).decode().replace(PLACE, words, 1)


def _built(path: Path) -> bytes:
    if not path.is_file():
        raise Refused(f"there is no `{path.name}` beside `{Path(__file__).name}`; `make lab` builds it (with npm)")
    return path.read_bytes()


def simulator_table(config: rust.Config, networks: bool, folders: Sequence[Path]) -> dict[str, Any]:
    """Return simulator and configuration, with the files in some folders that it and the page's choices name."""
    placed = copy.deepcopy(config)
    files = [path for included in INCLUDED for path in sorted(CONFIGS.glob(included))]
    for key in rust.path_keys(config):
        path = Path(get(config, key))
        if path.is_file():  # the simulator names one that is not
            files.append(path)
            set_key(placed, key, os.path.relpath(path, FOLDER))
    others = ("default", "ensemble")
    cards = [path for path in sorted(NETWORKS.glob("**/*.json")) if networks and path.stem not in others]
    files += cards
    inside = [path for path in files if _is_within(path, folders)]
    inside += [companion for path in inside for companion in _companions(path) if _is_within(companion, folders)]
    contents = {os.path.relpath(path, HOME): read_bytes(path) for path in inside}
    weights = {name for name in contents if name.endswith(".safetensors")}
    return {
        "wasm": base64.b64encode(lzma.decompress(_built(SIMULATOR))).decode(),
        "config": placed,
        "networks": [card.relative_to(NETWORKS).with_suffix("").as_posix() for card in cards],
        "files": {name: contents[name].decode() for name in contents.keys() - weights},
        "binary": {name: base64.b64encode(contents[name]).decode() for name in weights},
    }


def _is_within(path: Path, folders: Sequence[Path]) -> bool:
    return any(resolve(path).is_relative_to(resolve(folder)) for folder in folders)


def _companions(path: Path) -> list[Path]:
    """Return the URDF of a robot's file, the weights of a network's card."""
    if path.suffix.lower() == ".toml":
        named = tomllib.loads(path.read_text(encoding="utf-8")).get("urdf")
    else:
        named = read_json(path).get("weights", {}).get("file") if path.suffix.lower() == ".json" else None
    return [] if named is None else [path.parent / named]


class Server(http.server.ThreadingHTTPServer):
    """Answers with `page`, which is set once the address is known to be free."""

    page = b""

    def __init__(self, host: str, port: int) -> None:
        self.own = host
        super().__init__((host, port), _Handler)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print nothing, as of a browser that leaves."""


def serve(host: str, port: int) -> Server:
    """Return a server of a page; if the port is taken, at the next free one.

    Raises
    ------
    Refused
        If `host` and `port` are no address of this machine.
    """
    if not 0 <= port <= 65535:
        raise Refused(f"port is {port}; expected 0 (any) to 65535")
    for tried in range(port, min(port + 100, 65536)):
        try:
            return Server(host, tried)
        except OSError as reason:
            if reason.errno != errno.EADDRINUSE:
                words = f"cannot listen on `{host}` ({reason.strerror or reason}); expected an address of this machine"
                raise Refused(words) from None
    raise Refused(f"ports {port} to {tried} are taken; expected a free --port")


class _Handler(http.server.BaseHTTPRequestHandler):
    """Answers with the page, under its own name alone."""

    server: Server
    timeout = 60.0  # s, for which half a request is waited for

    def do_GET(self) -> None:
        if not is_own(self.server.own, self.headers.get_all("Host") or []):
            self.send_error(403, "this page is served to its own host alone")
        elif self.path not in ("/", "/index.html"):
            self.send_error(404)
        else:
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(self.server.page)))
            self.send_header("Cache-Control", "no-store")
            self.end_headers()
            self.wfile.write(self.server.page)

    def log_message(self, *_words: Any) -> None:
        """Print nothing."""


def is_own(own: str, hosts: Sequence[str]) -> bool:
    """Return whether a request's `Host` is a name of this machine or an address, for a server that listens on `own`.

    Another name may belong to a site that resolves it to this machine, whose scripts could read the page (DNS
    rebinding). Otherwise browsers give the page to no script of another site.
    """
    names = "|".join(re.escape(name) for name in {"localhost", own, socket.gethostname()})
    address = r"\d+\.\d+\.\d+\.\d+|\[[0-9a-fA-F:.]+\]"
    return len(hosts) == 1 and re.fullmatch(rf"({names}|{address})(:\d+)?", hosts[0], re.ASCII) is not None


def look_table(look: Look, robot: rust.Robot) -> dict[str, Any]:
    """Return shapes, jets, links, names of parts, colours and scales as plain tables."""
    names = ("FORCE", "WIND", "REFERENCE", "TRAIL", "PLUME", "GHOST")
    return {
        "shapes": [_shape(shape) for shape in look.shapes],
        "jets": [_mount(mount) for mount in look.jets],
        "links": [_mount(mount) for mount in look.links],
        "labels": {dim: list(names) for dim, names in labels_of(robot).items()},
        "colours": {name.lower(): getattr(drawing, name) for name in names} | dict(drawing.ROLES),
        "scales": drawing.SCALES,
        "plume_radius": drawing.PLUME_RADIUS,
        "overhead": drawing.OVERHEAD,
    }


def flight_table(recording: Recording) -> dict[str, Any]:
    """Return a flight's signals and the poses of its bodies in single precision, `RATE` samples per second."""
    times = recording.signals["time"]
    step = max(round(1.0 / RATE / (times[1] - times[0])), 1) if times.size > 1 else 1
    shown = np.arange(0, times.size, step)
    instants = [recording.at(time) for time in times[shown]]
    columns = [np.swapaxes(now.body_rotations, 1, 2)[:, :2].reshape(-1, 6) for now in instants]
    poses = np.concatenate([columns, [now.body_positions for now in instants]], axis=2)
    declared = rust.signals()
    names = [name for name in recording.signals if not is_repeated(name, recording.signals)]
    numbers = {name: recording.signals[name][shown] for name in names}
    return {
        "title": recording.title,
        "outcome": recording.outcome,
        "lost_time": recording.lost_time,
        "lost_reason": recording.lost_reason,
        "timeStep": float(times[step] - times[0]) if times.size > step else 1.0,
        "rows": int(shown.size),
        "signals": [
            {
                "name": name,
                "unit": declared[name].unit,
                "dims": declared[name].dims,
                "width": recording.rows(name).shape[1],
            }
            for name in names
        ],
        "numbers": {name: _pack(signal) for name, signal in (numbers | {"body_poses": poses}).items()},
    }


def _pack(numbers: Any) -> str:
    return base64.b64encode(np.asarray(numbers, dtype="<f4").tobytes()).decode()


def _shape(shape: Shape) -> dict[str, Any]:
    pose = shape.body_from_shape
    table: dict[str, Any] = {
        "kind": shape.kind,
        "size": shape.size,
        "role": shape.role,
        "body": shape.body,
        "rotation": _round_numbers(pose.rotation.T),  # by columns
        "position": _round_numbers(pose.position),
    }
    if shape.mesh is not None:
        faces = base64.b64encode(shape.mesh.faces.astype("<u4").tobytes()).decode()
        table |= {"vertices": _pack(shape.mesh.vertices * shape.size), "faces": faces}
    return table


def _mount(mount: Mount) -> dict[str, Any]:
    return {
        "name": mount.name,
        "body": mount.body,
        "position": _round_numbers(mount.position),
        "axis": _round_numbers(mount.axis),
    }


def _round_numbers(numbers: Any) -> list[float]:
    return [round(float(number), 6) for number in numbers.ravel()]
