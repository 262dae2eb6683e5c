"""MATLAB 7.3 logs of iRonCub's own software (HDF5): the groups of `robot_logger_device`.

Every leaf has `data`, a row for each of its `timestamps` [s], `dimensions`, `elements_names` and `units_of_measure`; a
column is named by the groups to its leaf and by the element: `joints_state/positions/l_knee`. Joints are listed in
`description_list`. A flight of ours has a leaf for every signal, and title, outcome and configuration in `flight`.
`robot-log-visualizer` reads the same; MATLAB itself was not tried.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from jax_aero import rust
from jax_aero.base import netcdf, sizes, typed_config
from jax_aero.base.files import complete_file, parse_json
from jax_aero.base.places import did_you_mean
from jax_aero.view import Refused, check_out, require
from jax_aero.view.export import METADATA, facts_of
from jax_aero.view.recording import Recording, axes_of, entries_of, with_zeros

ROOT = "robot_logger_device"
"""Group of the logger."""
POSITIONS = "joints_state/positions"
JOINTS = {
    POSITIONS: "joint_position",
    "joints_state/velocities": "raw_joint_velocity",
    "joints_state/torques": "joint_torque_measured",
}
"""Leaves that the robot's logger has, and our signals."""

Array = NDArray[np.float64]
Columns = dict[str, tuple[Array, Array]]
"""Times and numbers by the name of the column."""


def write_mat(recording: Recording, out: Path) -> None:
    """Write the log of a flight.

    Raises
    ------
    Refused
        If `out` is not a `.mat` file in an existing folder, or if the package `h5py` is not installed.
    """
    check_out(out, ".mat")
    require(["h5py"], "writing a MATLAB file", "logs")
    import h5py

    leaves = JOINTS | {signal: signal for signal in recording.signals}
    times, robot = recording.signals["time"], recording.robot
    with complete_file(out) as draft:
        with h5py.File(draft, "w", userblock_size=512) as file:
            root = _struct(file, ROOT)
            _text(root, "yarp_robot_name", robot.name)
            _text(root, METADATA, msgspec.json.encode(facts_of(recording)).decode())
            _cells(root, "description_list", robot.joint_names)
            for leaf, signal in leaves.items():
                if signal not in recording.signals:
                    continue
                rows, group = recording.rows(signal), _struct(root, leaf)
                names = ["/".join(entry) or "value" for entry in entries_of(signal, robot)]
                _numbers(group, "data", rows[:, None, :])
                _numbers(group, "timestamps", times[:, None])
                _numbers(group, "dimensions", np.array([[rows.shape[1]], [1.0], [times.size]]))
                _cells(group, "elements_names", names)
                _cells(group, "units_of_measure", [rust.signals()[signal].unit] * len(names))
                _text(group, "name", leaf.replace("/", "::"))
        with draft.open("r+b") as raw:
            raw.write(b"MATLAB 7.3 MAT-file, Platform: jax-aero".ljust(124) + b"\x00\x02IM")


def _struct(parent: Any, name: str) -> Any:
    group = parent.require_group(name)
    while group.name != "/":
        group.attrs["MATLAB_class"], group = np.bytes_(b"struct"), group.parent
    return parent[name]


def _numbers(group: Any, name: str, values: Array) -> None:
    group.create_dataset(name, data=values).attrs["MATLAB_class"] = np.bytes_(b"double")


def _text(group: Any, name: str | None, text: str) -> Any:
    codes = np.frombuffer(text.encode("utf-16-le"), np.uint16)[:, None]
    dataset = group.create_dataset(name, data=codes)
    dataset.attrs["MATLAB_class"], dataset.attrs["MATLAB_int_decode"] = np.bytes_(b"char"), np.int32(2)
    return dataset


def _cells(group: Any, name: str, texts: Sequence[str]) -> None:
    import h5py

    held = group.file.require_group("#refs#")
    cells = [_text(held, f"text{len(held)}", text).ref for text in texts]
    dataset = group.create_dataset(name, (1, len(cells)), h5py.ref_dtype, data=np.array([cells], h5py.ref_dtype))
    dataset.attrs["MATLAB_class"] = np.bytes_(b"cell")


def read_mat(path: Path) -> tuple[Columns, dict[str, Any]]:
    """Return times [s], from the first of all, and numbers of every column; and the text of a flight of ours.

    Raises
    ------
    Refused
        For a file that is no such log, has data in other files, or more than the limits of `sizes`.
    """
    require(["h5py"], f"reading `{path}`", "logs")
    import h5py

    try:
        with h5py.File(path, "r", rdcc_nbytes=sizes.MAX_PART) as file:
            numbers: dict[str, Any] = {}
            file.visititems(lambda name, item: numbers.update({name: item}) if isinstance(item, h5py.Dataset) else None)
            sizes.expect("variables", len(numbers), netcdf.MAX_TEXTS)
            needed = sum(netcdf.size_of(name, item) for name, item in numbers.items())
            sizes.expect("bytes of numbers", needed, sizes.MAX_NUMBERS)
            columns: Columns = {}
            for name, data in numbers.items():
                leaf, _, last = name.rpartition("/")
                stamps = numbers.get(f"{leaf}/timestamps")
                if name.startswith(f"{ROOT}/") and last == "data" and stamps is not None and data.dtype.kind in "fiub":
                    cells = numbers.get(f"{leaf}/elements_names")
                    columns |= _leaf(file, leaf.removeprefix(f"{ROOT}/"), data, stamps, cells)
            text = numbers.get(f"{ROOT}/{METADATA}")
            facts = {} if text is None else parse_json(_letters(text).encode())
    except Refused:
        raise
    except Exception as reason:  # HDF5 raises many types for damaged files
        raise Refused(f"`{path}` is damaged, or no log of MATLAB 7.3 ({type(reason).__name__}: {reason})") from None
    if not columns:
        raise Refused(f"`{path}` has no data in `{ROOT}`; expected a log of the robot's own software")
    start = min(times[0] for times, _ in columns.values())
    if "config" in facts:
        facts["config"] = typed_config.make_paths_absolute(parse_json(facts["config"].encode()))
    return {name: (times - start, rows) for name, (times, rows) in columns.items()}, facts


def _leaf(file: Any, leaf: str, data: Any, stamps: Any, cells: Any) -> Columns:
    """Return the columns of a leaf: its data have a row for each of its times."""
    times = np.asarray(stamps, np.float64).ravel()
    if times.size == 0 or data.size % times.size:
        raise Refused(f"`{leaf}` has {data.size} numbers and {times.size} times; expected as many in every row")
    rows = np.asarray(data, np.float64).reshape(times.size, -1)
    names = [] if cells is None else [_letters(file[cell]) for cell in np.ravel(cells)]
    if len(names) != rows.shape[1]:
        names = [str(place) for place in range(rows.shape[1])]
    return {f"{leaf}/{name}": (times, rows[:, place]) for place, name in enumerate(names)}


def _letters(text: Any) -> str:
    """Return the text of a dataset of letters."""
    sizes.expect("bytes of letters", netcdf.size_of(text.name, text), sizes.MAX_PART)
    return np.asarray(text, np.uint16).tobytes().decode("utf-16-le")


def read_recording(path: Path, robot_path: str | Path | None) -> Recording:
    """Return a log as a flight to view. What a robot does not log is zero: its base stays upright where it is."""
    columns, facts = read_mat(path)
    config = facts.get("config")
    named = robot_path or (config or {}).get("robot")
    if named is None:
        raise Refused(f"`{path}` does not name its robot; give it with --robot FILE")
    place = Path(named)
    robot = rust.Robot(place)

    def rows(signal: str, leaf: str) -> Array | None:
        names = ["/".join((leaf, *(entry or ("value",)))) for entry in entries_of(signal, robot)]
        parts = [columns[name] for name in names if name in columns]
        if len(parts) < len(names) or any(series[0].size != times.size for series in parts):
            return None
        shape = (times.size, *(len(names) for names in axes_of(signal, robot)))
        return np.column_stack([series[1] for series in parts]).reshape(shape)

    first = f"{POSITIONS}/{robot.joint_names[0]}"
    if first not in columns:
        raise Refused(f"`{path}` has no column `{first}`{did_you_mean(first, columns)}")
    times = columns[first][0]
    declared = [name for name, signal in rust.signals().items() if signal.dims[0] == "time" and name != "time"]
    signals = {"time": times} | {name: values for name in declared if (values := rows(name, name)) is not None}
    if (values := rows("joint_position", POSITIONS)) is None:
        raise Refused(f"`{path}` lacks the position of a joint of `{robot.name}` at some of its times")
    signals.setdefault("joint_position", values)
    return Recording(
        title=str(facts.get("title", path.stem)),
        signals=with_zeros(signals, robot),
        robot=robot,
        robot_path=place,
        outcome=str(facts.get("outcome", "logged")),
        lost_time=None,
        lost_reason=None,
        config=config,
    )
