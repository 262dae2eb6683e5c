"""Three controllers after an engine stops, in a short flight."""

import numpy as np
import pytest
import xarray as xr

from experiments import Refused
from experiments.studies.ahead import study as ahead
from jax_aero.base import places
from paper_figs.figures import FIGURES


def test_the_signals_of_every_controller(tmp_path, monkeypatch):
    monkeypatch.setattr(places, "RESULTS", tmp_path)
    found = ahead.STUDY.run("engine", {"duration": 18.8, "every": 20})["summary"]
    assert list(found) == ["aware", "observer", "predictive"]
    folders = list((tmp_path / "ahead").iterdir())
    data = xr.load_dataset(folders[0] / "run.nc", engine="h5netcdf")
    assert data["rotation"].shape == (3, len(data["time"]))
    np.testing.assert_allclose(np.diff(data["time"]), 0.2, atol=1e-9)
    after = data["rotation"].sel(time=slice(ahead.STOP, None))
    assert after.sel(controller="predictive").max() < 0.5 * after.sel(controller="observer").max()
    figure = FIGURES["ahead"].draw(data, data)
    assert len(figure.axes) == 3
    assert all(len(axes.lines) >= 3 for axes in figure.axes)


def test_a_part_that_does_not_exist_is_named():
    with pytest.raises(Refused, match="there is no part `engines`; did you mean engine"):
        ahead.compute("engines", ahead.Ahead())
