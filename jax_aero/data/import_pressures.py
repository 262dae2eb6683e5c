"""Convert surface pressures of the wind tunnel into a dataset: `jax-aero data import-pressures --clone DIR`.

The files are the means `data_GVPM/TID_*_PT*.prm`, with a row for each port, and `Pressure_Sensors_Map.csv`, beside the
balance files of `jax-aero data import-tunnel`. Cp = Δp / q with the q of the balance file; zeros are kept beside it and
not subtracted; blockage is not corrected. Taps that a campaign exchanged are mended, as the output states; doubtful
ones are flagged. Positions and flags: configs/tables/pressure_taps.toml. Writes one NetCDF file per robot.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from jax_aero import rust
from jax_aero.aero.dataset import Floats, number
from jax_aero.base import places, tables
from jax_aero.base.arguments import Parser
from jax_aero.base.files import read_bytes, write_netcdf
from jax_aero.base.terminal import Refused, exit_status
from jax_aero.data import tunnel
from jax_aero.data.import_cfd import OUT
from jax_aero.data.import_tunnel import files_by_test, folders, known_tests

TAPS = places.CONFIGS / "tables" / "pressure_taps.toml"
MAP = "Pressure_Sensors_Map.csv"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return its exit status."""
    parser = Parser("data import-pressures", __doc__)
    about = "a local clone of element_cfd-simulation"
    parser.add_argument("--clone", type=Path, required=True, metavar="DIR", help=about)
    about = "folder for pressures_ROBOT.nc (default results/datasets)"
    parser.add_argument("--out", type=Path, default=OUT, metavar="DIR", help=about)
    given = parser.parse_args(arguments)

    def work() -> None:
        for robot, data in from_clone(given.clone):
            path = given.out / f"pressures_{robot}.nc"
            write_netcdf(path, data)
            print(summary(data), path, sep="\n")

    return exit_status(work)


def from_clone(clone: Path) -> Iterator[tuple[str, xr.Dataset]]:
    """Yield each robot with its points."""
    tests, facts = known_tests(), tables.read(TAPS)
    parts: dict[str, list[xr.Dataset]] = {}
    for campaign, folder in folders(clone).items():
        if not (folder / MAP).is_file():
            continue
        ports = read_map((folder / MAP).read_text(encoding="utf-8"), f"{campaign}/{MAP}")
        about = next(entry for entry in facts["campaign"] if entry["name"] == campaign)
        means = files_by_test(folder, ".prm")
        for test, path in files_by_test(folder, ".gvp").items():
            if (known := tests.get((campaign, test))) is None or f"{test}_PT0001" not in means:
                continue
            gvp = tunnel.read_gvp(read_bytes(path).decode("utf-8", "replace"), f"{campaign}/{path.name}")
            points = tunnel.points_of(test, known, gvp)
            rows = [_means(means.get(f"{test}_PT{row:04}"), ports) for row in range(1, len(gvp) + 1)]
            pressures, on = np.array(rows), gvp[:, 8] >= tunnel.WIND_OFF
            zero = pressures[~on][-1] if (~on).any() else np.full(len(ports), np.nan)
            parts.setdefault(known.robot, []).append(to_dataset(points, pressures[on], zero, ports, about, facts))
    if not parts:
        raise Refused(f"{clone} has no pressures (TID_*_PT*.prm, {MAP}) of a test that tunnel_tests.toml names")
    for robot, sets in sorted(parts.items()):
        yield robot, xr.concat(sets, "point", data_vars="minimal", combine_attrs="drop_conflicts")


def read_map(text: str, source: str) -> dict[int, str]:
    """Return the tap of every port of the scanners."""
    table = rust.read_csv(text, source, {"Scanner ID": "number", "Sensor ID": "text"})
    taps = dict(zip(map(int, table.numbers["Scanner ID"]), table.texts["Sensor ID"], strict=True))
    if not taps:
        raise ValueError(f"{source}: no map of ports; expected `Scanner ID;Sensor ID` and rows such as 101;I1")
    return taps


def _means(path: Path | None, ports: Mapping[int, str]) -> list[float]:
    """Return the pressure of every port [Pa] in its file; NaN without one."""
    if path is None:
        return [np.nan] * len(ports)
    rows = [line.split() for line in read_bytes(path).decode("utf-8", "replace").splitlines() if line.strip()]
    values = {int(float(row[0])): number(row[1], path.name, "mean") for row in rows if len(row) == 2}
    if missing := [port for port in ports if port not in values]:
        raise ValueError(f"{path.name}: no port {missing[0]}; expected a row for each of {len(ports)} ports")
    return [values[port] for port in ports]


def to_dataset(
    points: tunnel.Points,
    pressures: Floats,
    zero: Floats,
    ports: Mapping[int, str],
    about: Mapping[str, Any],
    facts: Mapping[str, Any],
) -> xr.Dataset:
    """Return the points of a test with the taps of its robot.

    Parameters
    ----------
    pressures, zero
        Pressure differences of the ports at the points (N, ports), and without wind [Pa].
    ports
        Tap of each port, as labelled.
    about, facts
        What is wrong with the campaign, and the table of taps.
    """
    renamed = {old: new for pair in about.get("exchanged", ()) for old, new in (pair, pair[::-1])}
    labels = [renamed.get(tap, tap) for tap in ports.values()]
    known, flags = facts[points.robot], about.get("flags", {})
    taps = [tap for tap in known if tap in labels]
    order = [labels.index(tap) for tap in taps]
    nowhere = [np.nan] * 3
    n, pair = len(points), ("point", "tap")
    variables = {
        "cp": (pair, pressures[:, order] / points.dynamic_pressure[:, None], {"long_name": "pressure coefficient"}),
        "zero": (pair, np.tile(zero[order], (n, 1)), {"units": "Pa", "long_name": "last reading without wind"}),
        # Why stands in the table of taps: as many texts as pairs are refused by the reader of results.
        "flag": (pair, np.array([[tap in flags for tap in taps]] * n).astype("i1"), {"long_name": "a doubtful tap"}),
        "dynamic_pressure": ("point", points.dynamic_pressure, {"units": "Pa"}),
        "speed": ("point", points.speed, {"units": "m s-1"}),
        "pitch": ("point", points.pitch_deg, {"units": "degree"}),
        "yaw": ("point", points.yaw_deg, {"units": "degree"}),
        "number": ("point", np.array(points.point), {"long_name": "number of the point in its test"}),
        "position": (("tap", "xyz"), [known[tap].get("position", nowhere) for tap in taps], {"units": "m"}),
        "normal": (("tap", "xyz"), [known[tap].get("normal", nowhere) for tap in taps], {}),
    }
    coords = {name: ("point", list(getattr(points, name))) for name in ("campaign", "test", "kind", "posture")}
    coords |= {"marks": ("point", [", ".join(marks) for marks in points.marks])}
    coords |= {"tap": ("tap", taps), "link": ("tap", [known[tap].get("link", "") for tap in taps])}
    mended = {f"exchanged_{about['name']}": ", ".join(map(" and ".join, about.get("exchanged", ())))}
    return xr.Dataset(variables, coords, {"robot": points.robot} | {key: text for key, text in mended.items() if text})


def summary(data: xr.Dataset) -> str:
    """Return a description of a dataset: its size, what was exchanged, and its flagged taps."""
    lines = [f"{data.attrs['robot']}: {data.sizes['point']} points, {data.sizes['tap']} taps"]
    lines += [
        f"  {key.replace('_', ' ', 1)}: {text}" for key, text in data.attrs.items() if key.startswith("exchanged")
    ]
    for campaign in dict.fromkeys(data["campaign"].values):
        first = data["flag"].values[int((data["campaign"].values == campaign).argmax())]
        doubtful = [tap for tap, flag in zip(data["tap"].values, first, strict=True) if flag]
        lines.append(f"  doubtful in {campaign}: {', '.join(doubtful) or 'none'}")
    return "\n".join(lines)
