"""Compare battery and fuel of a hovering robot, with the numbers of the paper or with others."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from experiments import Refused
from experiments.report.engines import PAPER_BATTERY, PAPER_FUEL, Choice, engines, results
from jax_aero.base import places, plain, tables
from jax_aero.base.files import write_json
from jax_aero.base.terminal import exit_status
from jax_aero.cli import Parser


def main(arguments: Sequence[str]) -> int:
    """Print the comparison and the engines; write both beside the other results."""
    parser = Parser("study engine_choice", __doc__)
    for name, value in plain.to_builtins(Choice()).items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=float, default=value, metavar="X")
    parser.add_argument("--out", type=Path, default=places.RESULTS, metavar="DIR", help="folder of engine_choice.json")
    given = vars(parser.parse_args(arguments))
    out: Path = given.pop("out")
    return exit_status(lambda: _compare(tables.convert(given, Choice, "engine_choice"), out))


def _compare(choice: Choice, out: Path) -> None:
    least = 1e3 * max(choice.fan_power / choice.fan_thrust, 1.0) * choice.minutes / 60.0
    if choice.specific_energy <= least:
        raise Refused(
            f"engine_choice: `specific_energy` is {choice.specific_energy:g}; expected more than {least:g} Wh/kg, "
            f"with which a battery lifts itself alone for {choice.minutes:g} min"
        )
    most = choice.jet_thrust / (choice.fuel_density * choice.minutes)
    if choice.jet_consumption >= most:
        raise Refused(
            f"engine_choice: `jet_consumption` is {choice.jet_consumption:g}; expected less than {most:g} l/min, "
            f"with which an engine lifts its fuel alone for {choice.minutes:g} min"
        )
    found = results(choice)
    print(f"{choice.robot_mass:g} kg robot, {choice.minutes:g} min of hovering")
    print(
        f"  battery  {found['battery_kg']:6.2f} kg  from {choice.fan_power:g} kW for {choice.fan_thrust:g} kg of thrust"
    )
    print(
        f"  battery  {found['battery_at_1_kW_per_kg_kg']:6.2f} kg  from 1 kW per kg; the paper prints {PAPER_BATTERY}"
    )
    print(f"  fuel     {found['fuel_kg']:6.2f} kg  burnt on the way; the paper prints {PAPER_FUEL}")
    print("engines of the robot")
    for jet in engines():
        print(f"  {jet['jet']:<12} {jet['engine']:<5} up to {jet['thrust_max_N']:.0f} N")
    write_json(out / "engine_choice.json", {**found, "engines": engines()})
