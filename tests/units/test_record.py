import dataclasses

import h5py
import numpy as np
import pytest
import xarray as xr

from jax_aero import rust
from jax_aero.base import places
from jax_aero.base.files import write_netcdf
from jax_aero.results import record


@pytest.fixture
def dataset(make_flight, robot):
    return record.to_dataset(make_flight(), robot, title="made up", config_digest="f" * 64)


def test_a_run_reads_back_as_it_was_flown(make_flight, robot, dataset, tmp_path):
    flight = make_flight()
    write_netcdf(tmp_path / "run.nc", dataset)
    with xr.open_dataset(tmp_path / "run.nc", engine="h5netcdf") as stored:
        for name, values in flight.log.items():
            np.testing.assert_array_equal(stored[name].values, values)
        np.testing.assert_array_equal(stored["joint_setpoint"], flight.joint_setpoint)
        assert stored["joint"].values.tolist() == robot.joint_names
        assert stored["link"].values.tolist() == robot.aero_link_names
        assert stored["jet"].values.tolist() == robot.jet_names
        assert stored["joint_group"].sel(joint="l_knee") == "left_leg"
        assert stored["qp"].values.tolist() == ["momentum", "torque"]
        assert stored.attrs["outcome"] == "completed"
        assert np.isnan(stored.attrs["lost_time"])
        assert stored.attrs["lost_reason"] == ""
        assert stored.attrs["backend"] == "rust"
        assert stored.attrs["config_hash"] == "f" * 64


def test_a_file_has_what_the_crate_declares(make_flight, dataset):
    declared = {name: signal for name, signal in rust.signals().items() if not signal.is_of_ground}
    figures = {name: rust.figures()[name] for name in make_flight().summary}
    assert dataset.data_vars.keys() | {"time"} == declared.keys() | figures.keys()
    for name, signal in {**declared, **figures}.items():
        variable = dataset[name]
        assert variable.dims == signal.dims, name
        assert (variable.attrs["units"], variable.attrs["long_name"]) == (signal.unit, signal.meaning)
        assert np.issubdtype(variable.dtype, np.integer) == (signal.numbers != "real"), name


def test_codes_are_named_as_cf_does_and_no_coordinate_has_a_fill_value(dataset, tmp_path):
    write_netcdf(tmp_path / "run.nc", dataset)
    with h5py.File(tmp_path / "run.nc", "r") as stored:
        assert "_FillValue" not in stored["time"].attrs
        status, modes = stored["qp_status"].attrs, stored["degraded_modes"].attrs
        assert dict(zip(status["flag_values"], status["flag_meanings"].split(), strict=True))[1] == "iteration_limit"
        named = dict(zip(modes["flag_meanings"].split(), modes["flag_masks"].tolist(), strict=True))
        assert named == rust.MODES
        assert stored["joint_condition"].attrs["flag_meanings"].split() == ["healthy", "stuck", "weak", "free"]
        assert modes["flag_masks"].dtype == stored["degraded_modes"].dtype


def test_an_integer_that_is_unknown_stays_so(make_flight, robot, tmp_path):
    """The last tick of a flight that diverges has no answer of a controller where JAX flies."""
    flight = make_flight()
    modes = np.append(flight["degraded_modes"][:-1], np.nan)
    flight = dataclasses.replace(flight, log={**flight.log, "degraded_modes": modes})
    write_netcdf(tmp_path / "run.nc", record.to_dataset(flight, robot, title="made up", config_digest=""))
    with xr.open_dataset(tmp_path / "run.nc", engine="h5netcdf") as stored:
        np.testing.assert_array_equal(stored["degraded_modes"].values, modes)
        assert stored["qp_status"].dtype == np.int32


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"thrust": None}, "no `thrust`"),
        ({"thrust": np.zeros((7, 4))}, "`thrust` has shape"),
        ({"mystery": np.zeros(501)}, "declares no signal mystery"),
    ],
)
def test_a_log_that_does_not_fit_the_schema_is_refused_by_name(make_flight, robot, change, message):
    flight = make_flight()
    log = {name: values for name, values in {**flight.log, **change}.items() if values is not None}
    with pytest.raises(ValueError, match=message):
        record.to_dataset(dataclasses.replace(flight, log=log), robot, title="", config_digest="")


def test_a_folder_appears_complete_or_not_at_all_and_is_replaced_so(tmp_path):
    def seen():
        return {path.relative_to(tmp_path).as_posix(): path.read_text() for path in tmp_path.rglob("*.nc")}

    before = {}
    for text in ("first", "second"):
        with pytest.raises(KeyboardInterrupt), record.complete_folder(tmp_path / "run", replace=bool(before)) as draft:
            (draft / "run.nc").write_text("half")
            raise KeyboardInterrupt
        assert seen() == before
        with record.complete_folder(tmp_path / "run", replace=bool(before)) as draft:
            (draft / "run.nc").write_text(text)
            assert (tmp_path / "run").exists() == bool(before)
        before = {"run/run.nc": text}
        assert seen() == before
        assert [entry.name for entry in tmp_path.iterdir()] == ["run"]


def test_a_folder_that_appears_meanwhile_is_not_replaced(tmp_path):
    with pytest.raises(OSError, match="run"), record.complete_folder(tmp_path / "run") as draft:
        (draft / "run.nc").write_text("mine")
        (tmp_path / "run").mkdir()
        (tmp_path / "run" / "run.nc").write_text("theirs")
    assert (tmp_path / "run" / "run.nc").read_text() == "theirs"


def test_a_manifest_counts_where_it_is_one(tmp_path):
    assert record.read_manifest(tmp_path) is None
    (tmp_path / places.MANIFEST_FILE).write_text('{"title": "made up"}')
    assert record.read_manifest(tmp_path) == {"title": "made up"}
    (tmp_path / places.MANIFEST_FILE).write_text("[]")
    assert record.read_manifest(tmp_path) is None
