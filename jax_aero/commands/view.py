"""The commands `view`, `view video`, `view snapshot` and `export`."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from jax_aero import rust
from jax_aero.base.arguments import Parser
from jax_aero.base.places import find, name_of
from jax_aero.base.references import copy_named
from jax_aero.base.terminal import ConfigError, Progress, exit_status, progress_bar
from jax_aero.view import Refused, recording
from jax_aero.view.ros2 import BAG

RESULT = "a folder or run.nc that `jax-aero fly NAME` wrote, the NAME of one in results/flight, or a log"


def view(words: Sequence[str]) -> int:
    """Serve the page until Ctrl-C."""
    parser = Parser(
        "view",
        "Show a flight in the browser, beside another one as a ghost if two are given, and repeat it "
        "with other wind, controller, aerodynamics. Without RESULT the baseline is flown.",
    )
    parser.add_argument("results", nargs="*", metavar="RESULT", help=f"{RESULT}; at most two")
    _add_reading(parser)
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on (default: this machine only)")
    parser.add_argument("--port", type=int, default=8080, help="port; the next free one if it is taken (default 8080)")
    given = parser.parse_args(words)
    return exit_status(lambda: _serve(given))


def _serve(given: Any) -> int:
    if len(given.results) > 2:
        raise Refused(f"{len(given.results)} results are given; expected at most two")
    from jax_aero.view.web import fill_page, serve

    with serve(given.host, given.port) as server:
        recordings = [_read(result, given) for result in given.results]
        for flight in recordings[:1]:
            for reason in flight.look.missing:
                print(f"not drawn, or as the aerodynamic models have it: {reason}")
        config = recordings[0].config if recordings else rust.load_config("test1")
        folders = [Path(given.robot).parent] if given.robot else []
        server.page = fill_page(recordings, config, folders=folders).encode()
        shown = "localhost" if given.host in ("127.0.0.1", "0.0.0.0") else given.host
        title = recordings[0].title if recordings else "the flight lab"
        print(f"http://{shown}:{server.server_port} shows {title}; Ctrl-C ends it", flush=True)
        server.serve_forever()
    return 0


def video(words: Sequence[str]) -> int:
    """Write a video."""
    parser = Parser("view video", "Film flights as MP4 or, where --out ends so, as .gif or .webp.")
    _add_common_options(parser, Path("flight.mp4"), "1280x720")
    second = parser.add_mutually_exclusive_group()
    second.add_argument("--ghost", metavar="RESULT", help="another flight in the same scene, drawn translucent")
    second.add_argument("--beside", nargs="+", default=[], metavar="RESULT", help="other flights, to the right of it")
    parser.add_argument("--titles", nargs="+", default=[], metavar="TEXT", help="titles of flights side by side")
    parser.add_argument("--fps", type=float, default=30.0, help="pictures per second (default 30)")
    parser.add_argument("--speed", type=float, default=1.0, help="flight seconds per second of video (default 1)")
    parser.add_argument("--start", type=float, default=0.0, metavar="S", help="start time [s]")
    parser.add_argument("--end", type=float, metavar="S", help="end time [s] (default: the end of the flight)")
    given = parser.parse_args(words)

    def work(progress: Progress) -> None:
        from jax_aero.view.video import write_video

        write_video(
            _read(given.result, given),
            given.out,
            ghost=None if given.ghost is None else _read(given.ghost, given),
            beside=[_read(result, given) for result in given.beside],
            titles=given.titles,
            renderer=given.renderer,
            fps=given.fps,
            speed=given.speed,
            size=given.size,
            viewpoint=given.camera,
            start=given.start,
            end=given.end,
            progress=progress,
        )

    return _write(given, "frame", work)


def snapshot(words: Sequence[str]) -> int:
    """Write a picture."""
    parser = Parser("view snapshot", "Draw one moment of a flight, or several in one picture.")
    _add_common_options(parser, Path("flight.png"), "1920x1080")
    parser.add_argument(
        "--at", type=float, nargs="+", default=[], metavar="S", help="times [s] (default: six, evenly spaced)"
    )
    given = parser.parse_args(words)

    def work(progress: Progress) -> None:
        from jax_aero.view.video import write_snapshot

        flight = _read(given.result, given)
        drawn = {"renderer": given.renderer, "size": given.size, "viewpoint": given.camera}
        write_snapshot(flight, given.out, given.at, **drawn, progress=progress)

    return _write(given, "picture", work)


def export(words: Sequence[str]) -> int:
    """Write a file for another viewer."""
    parser = Parser("export", "Write a flight as one file: a page for any browser, or a log for other viewers.")
    formats = parser.add_mutually_exclusive_group(required=True)
    for name, about in FORMATS.items():
        formats.add_argument(f"--{name}", dest="format", action="store_const", const=name, help=about)
    parser.add_argument("--ghost", metavar="RESULT", help="another flight, drawn translucent beside it, with --html")
    about = "messages of the MCAP file: JSON for Foxglove (default), or standard types of ROS 2"
    parser.add_argument("--profile", choices=("json", "ros2"), metavar="PROFILE", help=f"{about}; json or ros2")
    parser.add_argument("--signals", nargs="+", default=[], metavar="NAME", help="signals of a CSV file (default: all)")
    _files(parser, None)
    given = parser.parse_args(words)
    given.out = given.out or Path(name_of(given.result) if given.format == "config" else f"flight.{given.format}")

    def work(progress: Progress) -> None:
        from jax_aero.view.export import write_csv, write_mcap
        from jax_aero.view.matlab import write_mat
        from jax_aero.view.web import write_page

        if given.ghost is not None and given.format != "html":
            raise Refused(f"--ghost is given with --{given.format}; expected --html, which alone shows two flights")
        if given.profile is not None and given.format != "mcap":
            raise Refused(f"--profile is given with --{given.format}; expected --mcap, which alone has profiles")
        if given.signals and given.format != "csv":
            raise Refused(f"--signals is given with --{given.format}; expected --csv, which alone has a choice")
        if given.format == "config":
            _load(copy_named(find("experiments", given.result), given.out, replace=given.overwrite))
            return
        results = [given.result] if given.ghost is None else [given.result, given.ghost]
        flight, *ghost = [_read(result, given) for result in results]
        if given.format == "html":
            write_page([flight, *ghost], given.out)
        elif given.format == "mcap":
            write_mcap(flight, given.out, progress, given.profile or "json")
        elif given.format == "mat":
            write_mat(flight, given.out)
        else:
            write_csv(flight, given.out, given.signals)

    return _write(given, "tick", work)


def _load(path: Path) -> None:
    """Refuse a file that is neither what runs on board nor an experiment, which has more keys."""
    try:
        rust.load_onboard(path)
    except ConfigError as refusal:
        if refusal.key not in rust.schemas()["experiments"]["properties"]:
            raise
        rust.load_config(path)


FORMATS = {
    "html": "a page that any browser plays, of two flights with --ghost",
    "mcap": "every signal, poses and the robot's URDF, for Foxglove, PlotJuggler and Rerun",
    "csv": "every signal as a table, for PlotJuggler and spreadsheets",
    "config": "folder of an experiment or a file of configs/onboard, RESULT, with every file that it needs",
    "mat": "every signal as iRonCub's own logger writes it (MATLAB 7.3), for robot-log-visualizer",
}
"""Formats of `jax-aero export`; those of files are their suffixes."""


def _files(parser: Parser, out: Path | None) -> None:
    parser.add_argument("result", metavar="RESULT", help=RESULT)
    default = out or "flight, with the suffix of the format"
    parser.add_argument("--out", type=Path, default=out, metavar="FILE", help=f"file to write (default {default})")
    parser.add_argument("--overwrite", action="store_true", help="replace an existing file")
    _add_reading(parser)


def _add_common_options(parser: Parser, out: Path, size: str) -> None:
    _files(parser, out)
    parser.add_argument("--size", type=_size, default=_size(size), metavar="WxH", help=f"pixels (default {size})")
    parser.add_argument("--camera", choices=("chase", "side"), default="chase", help="point of view (default chase)")
    parser.add_argument(
        "--renderer",
        choices=("mujoco", "pillow"),
        default="mujoco",
        help="what draws: MuJoCo with OpenGL, or Pillow alone, without shadows on the robot (default mujoco)",
    )


def _read(result: str | Path, given: Any) -> recording.Recording:
    """Read a flight's result, or a log of a robot."""
    from jax_aero.view import logs, matlab, measured

    path = Path(result)
    if path.suffix.lower() == ".mat" and given.map is None:
        return matlab.read_recording(path, given.robot)
    if path.suffix.lower() in logs.FORMATS:
        config = None if given.experiment is None else rust.load_config(given.experiment)
        return measured.read_flight(path, config, given.map, given.robot)
    return recording.read(result, given.robot)


def _add_reading(parser: Parser) -> None:
    parser.add_argument("--robot", metavar="FILE", help="TOML file of the robot, if a result does not name it")
    parser.add_argument("--experiment", metavar="NAME", help="experiment whose robot a CSV log is of")
    parser.add_argument("--map", type=Path, metavar="FILE", help="TOML file that names the columns of a log of others")


def _write(given: Any, unit: str, work: Callable[[Progress], None]) -> int:
    """Write the file `given.out`, whose progress has this unit; return the exit status."""

    def write() -> None:
        beside = [given.out.with_name(BAG)] if vars(given).get("profile") == "ros2" else []
        for path in (given.out, *beside):
            if path.exists() and not given.overwrite:
                raise Refused(f"`{path}` is there already; choose another --out, or --overwrite it")
        with progress_bar(unit) as show:
            work(show)
        print(given.out)

    return exit_status(write)


def _size(text: str) -> tuple[int, int]:
    try:
        width, height = (int(edge) for edge in text.lower().split("x"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"size is {text!r}; expected WIDTHxHEIGHT, e.g. 1280x720") from None
    return width, height
