"""What the controller neglects, split along a short flight."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from experiments.studies.force_rate import study as force_rate
from jax_aero.base import places
from paper_figs.figures import FIGURES
from paper_figs.runs import MissingRun

ROOT = Path(__file__).resolve().parents[2]
NAME = "test2--duration=12.0"


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """The first 12 s of TEST2: the wind rises, the climb begins."""
    folder = tmp_path_factory.mktemp("results")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(places, "RESULTS", folder)
        document = force_rate.STUDY.run("test2", {"duration": 12.0})
    return folder, document


def test_an_experiment_given_by_its_path_stays_where_it_is(tmp_path, monkeypatch, capsys):
    """The result has its name, beside those of the others, and not its path."""
    monkeypatch.setattr(places, "RESULTS", tmp_path / "results")
    path = tmp_path / "mine.toml"
    text = f'base = "{ROOT}/configs/experiments/test2.toml"\n'
    path.write_text(text)
    assert force_rate.main([str(path), "--set", "duration=3.1"]) == 0
    assert path.read_text() == text
    path.write_text(f"{text}wind = {{ velocity = [0, 0, 0] }}\n")  # another experiment of this name
    assert force_rate.main([str(path), "--set", "duration=3.1"]) == 2
    assert "holds the result of another configuration" in capsys.readouterr().err
    (folder,) = (tmp_path / "results" / "force_rate").iterdir()
    assert folder.name == "mine--duration=3.1"
    assert "mine" in json.loads((folder / "manifest.json").read_text())["sources"]["configurations"]
    assert force_rate.main([str(path), "--set", "duration=3.0"]) == 2
    assert "ends at 3 s; expected a `duration` beyond 3 s" in capsys.readouterr().err
    shipped = tmp_path / "test2.toml"
    shipped.write_text(text)
    assert force_rate.main([str(shipped)]) == 2
    assert "its result would take the place of that of configs/experiments/test2.toml" in capsys.readouterr().err
    folder.with_name("mine--duration=3.2").write_text("mine")
    assert force_rate.main([str(path), "--set", "duration=3.2"]) == 2
    assert folder.with_name("mine--duration=3.2").read_text() == "mine"


def test_the_parts_add_up_to_what_the_crate_saw(result):
    assert result[1]["summary"]["mismatch with differences of the log, rms over rms"] < 0.1


@pytest.mark.close_to_tolerance("the last row lies before the end of the ramp")
def test_the_wind_is_what_changes_the_force_while_it_rises(result, agree):
    data = xr.load_dataset(result[0] / f"force_rate/{NAME}/run.nc", engine="h5netcdf")
    rising = data.sel(time=slice(6.0, 9.9), six=["linear_x", "linear_y", "linear_z"])
    size = {name: float(np.sqrt((rising[name] ** 2).sum("six")).mean()) for name in force_rate.NEGLECTED}
    assert size["wind"] > 5 * max(size["attitude"], size["acceleration"])
    # F = ½ρ C w², w = 2 t: its rate grows linearly, to 2/5 of 13 N per second at the end.
    agree("force rate of the wind", float(np.abs(rising["wind"].isel(time=-1)).max()), 2 * 12.95 / 5, 0.05)


def test_lambda_a_has_no_linear_rows(result):
    data = xr.load_dataset(result[0] / f"force_rate/{NAME}/run.nc", engine="h5netcdf")
    assert float(np.abs(data["lambda_a"].isel(six=slice(0, 3))).max()) == 0.0


def test_the_manifest_and_the_figure(result):
    folder, document = result
    stored = json.loads((folder / f"force_rate/{NAME}/manifest.json").read_text())
    assert stored["engine"] == "casadi"
    assert stored["versions"]["casadi"]
    _, hashes = FIGURES["force_rate"].draw_from_results(folder / "flight", [NAME])
    assert hashes == {NAME: document["config_digest"]}
    with pytest.raises(MissingRun, match=r"make it with: jax-aero study force_rate test9"):
        FIGURES["force_rate"].draw_from_results(folder / "flight", ("test9",))
    with pytest.raises(MissingRun, match=r"force_rate test2 --set \.\.\. \(the changes in its name\)"):
        FIGURES["force_rate"].draw_from_results(folder / "flight", ("test2--duration=7.0",))
