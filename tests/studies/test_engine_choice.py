"""The command line of battery against fuel."""

from __future__ import annotations

import json

import pytest

from jax_aero.cli import main


def test_the_command_prints_and_writes_it(tmp_path, capsys):
    assert main(["study", "engine_choice", "--out", str(tmp_path)]) == 0
    assert "4.61 kg" in capsys.readouterr().out
    found = json.loads((tmp_path / "engine_choice.json").read_text())
    assert [jet["engine"] for jet in found["engines"]] == ["P160", "P160", "P220", "P220"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--specific-energy", "1"], "`specific_energy` is 1; expected more than 83.3333 Wh/kg"),
        (["--specific-energy", "0"], "`specific_energy` is 0.0; expected a number > 0"),
        (["--minutes", "nan"], "`minutes` is NaN; expected a finite number"),
        (["--jet-consumption", "900"], "`jet_consumption` is 900; expected less than 5.5 l/min"),
    ],
)
def test_what_cannot_lift_itself_is_refused(words, message, tmp_path, capsys):
    assert main(["study", "engine_choice", "--out", str(tmp_path), *words]) == 2
    shown = capsys.readouterr()
    assert shown.err.startswith(f"error: engine_choice: {message}")
    assert shown.out == ""
    assert not list(tmp_path.iterdir())
