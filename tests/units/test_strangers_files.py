"""Files of others are refused by name when they are damaged, larger than they look, or hold data from elsewhere."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from functools import partial

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import xarray as xr

from experiments.report.judge import Record
from experiments.report.results import Results
from jax_aero.aero import dataset
from jax_aero.base import documents, files, netcdf, run_file, sizes, tables
from jax_aero.base.files import MAX_DEPTH, complete_folder, lock, parse_json, read_json
from jax_aero.base.parquet import read_table
from jax_aero.base.terminal import Refused
from jax_aero.figures import runs, sweeps
from jax_aero.results import record
from jax_aero.results.identity import Identity
from jax_aero.stored import keep
from jax_aero.view import recording

# --- NetCDF


def link_to_another_file(file, other):
    file["wind"] = h5py.ExternalLink(other, "secret")


def link_within(file, _):
    file["wind"] = h5py.SoftLink("/time")


def external_storage(file, other):
    file.create_dataset("wind", (4,), "u1", external=[(other, 0, 4)])


def virtual(file, other):
    layout = h5py.VirtualLayout((3,), "f8")
    layout[:] = h5py.VirtualSource(other, "secret", (3,))
    file.create_virtual_dataset("wind", layout)


def group(file, _):
    file.create_group("wind")


def small_numbers(file, _):
    """A byte for each number in the file, compressed; eight in memory."""
    file.create_dataset("wind", (netcdf.MAX_NUMBERS // 8, 1), "i1", chunks=(1 << 20, 1), compression="gzip")


def one_large_chunk(file, _):
    file.create_dataset("wind", (1,), "i1", chunks=(netcdf.MAX_NUMBERS // 8,), maxshape=(None,), compression="gzip")


def many_texts(file, _):
    file.create_dataset("wind", (1 << 28,), h5py.string_dtype(), chunks=(1 << 10,), compression="gzip")


def one_long_text_many_times(file, _):
    file.create_dataset("wind", (100_000,), h5py.string_dtype(), chunks=(1000,), fillvalue="x" * 60_000)


def many_texts_of_an_attribute(file, _):
    file["wind"] = np.zeros(100_000)
    file["wind"].attrs.create("units", ["x"] * 3000, dtype=h5py.string_dtype())


@pytest.mark.parametrize(
    "make",
    [
        link_to_another_file,
        link_within,
        external_storage,
        virtual,
        group,
        small_numbers,
        one_large_chunk,
        many_texts,
        one_long_text_many_times,
        many_texts_of_an_attribute,
    ],
)
def test_a_file_is_small_and_whole_or_it_is_not_read(make, tmp_path):
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["secret"] = np.arange(3.0)
    path = tmp_path / "run.nc"
    with h5py.File(path, "w") as file:
        file["time"] = np.arange(3.0)
        make(file, str(tmp_path / "other.h5"))
    assert path.stat().st_size < 2e6
    with pytest.raises(ValueError, match=r"^`wind` |^it holds \d+ "):
        netcdf.check(path)


@pytest.mark.parametrize("read", [run_file.read, runs.read, recording.read, partial(dataset.load, robot=None)])
def test_every_reader_of_such_files_checks_them(read, tmp_path):
    path = tmp_path / "run.nc"
    with h5py.File(path, "w") as file:
        file["wind"] = h5py.ExternalLink(__file__, "secret")
    with pytest.raises((ValueError, runs.NotDrawn), match=rf"{path}.*`wind` is a link"):
        read(path)
    path.unlink()
    os.mkfifo(path)
    with pytest.raises((ValueError, runs.NotDrawn), match=f"{path}"):
        read(path)


# --- JSON


OF_OTHER_TYPES = '{"config": [], "files": [], "finished": [], "claims": 1, "git": "", "title": {}}'
DAMAGES = {
    "deep": lambda path: path.write_text('{"config": ' + "[" * 10**5 + "]" * 10**5 + "}"),
    "deeper than ours": lambda path: path.write_text('{"config": {"a": ' + "[" * MAX_DEPTH + "]" * MAX_DEPTH + "}}"),
    "of other types": lambda path: path.write_text(OF_OTHER_TYPES),
    "a list": lambda path: path.write_text("[]"),
    "half a letter": lambda path: path.write_bytes(b'{"title": "\\ud800"}'),
    "a pipe": os.mkfifo,
    "a circle": lambda path: path.symlink_to(path),
    "a folder": os.mkdir,
}
damage = pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)


@damage
@pytest.mark.parametrize("form", [documents.Manifest, documents.FinishedSweep, Record])
def test_a_damaged_document_is_named(damage, form, tmp_path):
    path = tmp_path / "it.json"
    damage(path)
    with pytest.raises(Refused, match=rf"{path} (is damaged|cannot be read): "):
        read_json(path, form)


def test_what_we_write_is_not_deep():
    assert parse_json(b"[" * MAX_DEPTH + b"]" * MAX_DEPTH) == eval("[" * MAX_DEPTH + "]" * MAX_DEPTH)


@damage
def test_a_damaged_manifest_is_named_by_every_reader_and_overwritten(damage, tmp_path):
    folder, flight = tmp_path / "flight" / "mine", xr.Dataset()
    record.write_run(folder, flight, {"config_digest": "d"})
    path = folder / "manifest.json"
    path.unlink()
    damage(path)
    with pytest.raises(Refused, match=f"{path} (is damaged|cannot be read): "):
        recording.read(folder)
    with pytest.raises(Refused, match=f"{path} (is damaged|cannot be read): "):
        _ = Results(tmp_path).flights
    with pytest.raises(Refused, match=rf"mine holds no finished result \({path} .*--overwrite it"):
        record.find_existing(folder, Identity("d"), documents.Manifest, overwrite=False)
    if damage is not os.mkdir:
        assert record.find_existing(folder, Identity("d"), documents.Manifest, overwrite=True) is None
        record.write_run(folder, flight, {"config_digest": "d"}, replace=True)
        assert record.read_manifest(folder)["config_digest"] == "d"


@damage
def test_a_damaged_description_of_a_sweep_is_named_by_every_reader_and_overwritten(damage, tmp_path):
    folder = tmp_path / "sweeps" / "mine"
    folder.mkdir(parents=True)
    (folder / "cells.parquet").touch()
    path = folder / "sweep.json"
    damage(path)
    with pytest.raises(Refused, match=r"sweep\.json (is damaged|cannot be read): .*--overwrite it"):
        record.find_existing(folder, Identity("d"), documents.FinishedSweep, overwrite=False)
    with pytest.raises(Refused, match=f"{path} (is damaged|cannot be read): "):
        _ = Results(tmp_path).sweeps
    with pytest.raises(runs.NotDrawn, match=f"{path} (is damaged|cannot be read): "):
        sweeps.load(folder.parent, "mine")
    if damage is not os.mkdir:
        (folder / "cells.parquet").unlink()
        assert record.find_existing(folder, Identity("d"), documents.FinishedSweep, overwrite=True) is None


def test_a_table_of_a_sweep_is_bounded_and_regular(tmp_path, monkeypatch):
    path = tmp_path / "cells.parquet"
    pq.write_table(pa.table({"cell": np.zeros(10**5)}), path)
    assert path.stat().st_size < 1e4
    assert read_table(path).num_rows == 10**5
    monkeypatch.setattr(sizes, "MAX_TABLE", 10**5)
    with pytest.raises(Refused, match=rf"{path} is damaged \(it holds \d+ bytes of numbers or more"):
        read_table(path)
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(Refused, match=rf"{path} is damaged \(cells\.parquet: expected a regular file"):
        read_table(path)


def one_long_text():
    return pa.table({"cell": pa.array(["x" * 10**5]).take(pa.array(np.zeros(10**4, np.int64)))})


def texts_that_share_their_beginning():
    return pa.table({"cell": ["x" * 10**5 + str(number) for number in range(10)]})


def lists():
    return pa.table({"cell": pa.array([[0.0] * 10**5])})


@pytest.mark.parametrize("make", [one_long_text, texts_that_share_their_beginning, lists])
def test_texts_and_lists_of_a_table_are_bounded(make, tmp_path, monkeypatch):
    path, options = tmp_path / "cells.parquet", {}
    if make is texts_that_share_their_beginning:
        options = {"use_dictionary": False, "column_encoding": {"cell": "DELTA_BYTE_ARRAY"}}
    pq.write_table(make(), path, compression="zstd", **options)
    assert path.stat().st_size < 1e4
    monkeypatch.setattr(sizes, "MAX_TABLE", 1 << 22)
    with pytest.raises(Refused, match=rf"{path} is damaged \((it holds \d+ bytes of texts|column `.*cell.*` (is|has))"):
        read_table(path)


def test_a_table_reads_as_it_was_written(tmp_path):
    """Texts pass through dictionaries, whose size is known, and are texts again."""
    written = pa.table({"name": ["a", None, "bb"], "number": [1.0, np.nan, 3.0], "of": pa.array([1, 2, None])})
    pq.write_table(written, tmp_path / "cells.parquet")
    read = read_table(tmp_path / "cells.parquet")
    assert (read.schema, read["name"].to_pylist()) == (written.schema, ["a", None, "bb"])


def test_a_table_whose_rows_become_objects_is_small(tmp_path, monkeypatch):
    """Each number of a report's cells takes some hundred bytes."""
    pq.write_table(pa.table({"cell": np.zeros(10**5)}), tmp_path / "cells.parquet")
    monkeypatch.setattr(sizes, "MAX_OBJECTS", 10**4)
    with pytest.raises(Refused, match=r"cells\.parquet is damaged \(it holds 100000 values"):
        read_table(tmp_path / "cells.parquet", sizes.MAX_OBJECTS)
    with pytest.raises(ValueError, match="it holds 20001 values"):
        parse_json(b"[" + b"0," * 20_000 + b"0]")


@pytest.mark.parametrize("key", ["title", "design", "finished", "levels", "error"])
def test_a_description_of_a_sweep_without_a_key_is_named(key, tmp_path):
    folder = tmp_path / "sweeps" / "mine"
    folder.mkdir(parents=True)
    (folder / "cells.parquet").touch()
    document = {
        **dict.fromkeys(("title", "description", "panels", "config_digest", "backend"), ""),
        **dict.fromkeys(("repeats", "seed", "rows"), 1),
        "drawing": "map",
        "design": "grid",
        "git": None,
        "perturbation": {},
        "axes": [{"name": "a", "label": "a", "unit": "", "levels": [1.0]}],
        "device": {"cores": 1},
        "finished": {
            "created": "",
            "flights": 1,
            "seconds": 1.0,
            "flights_per_minute": 1.0,
            "outcomes": {"completed": 1, "fell": 0, "error": 0},
        },
    }
    for table in (document, document["axes"][0], document["finished"]["outcomes"]):
        table.pop(key, None)
    (folder / "sweep.json").write_text(json.dumps(document))
    with pytest.raises(Refused, match=f"sweep.json is damaged: Object missing required field `{key}`"):
        keep.of_sweep(folder)


def test_links_that_lead_to_themselves_are_named(tmp_path):
    path = tmp_path / "mine"
    path.symlink_to(path)
    for use in (lock, complete_folder):
        with pytest.raises(Refused, match=f"{path} is a symbolic link that leads to itself"), use(path):
            pass


@pytest.mark.parametrize("depth", [100, 10**5])
def test_a_deep_configuration_is_named(depth, tmp_path):
    path = tmp_path / "deep.toml"
    path.write_text(f"a = {'[' * depth}{']' * depth}")
    with pytest.raises(Refused, match=r"deep\.toml: "):
        tables.read(path)


# --- machines that lack what ours has


def test_a_result_is_written_where_there_are_no_locks(tmp_path, monkeypatch):
    """On a file system without them, with a warning; on Windows, whose Python has neither `fcntl` nor `os.pread`."""

    def refuse(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(files.fcntl, "flock", refuse)
    message = r"the file system of .* has no locks .* no other command writes mine"
    with pytest.warns(UserWarning, match=message), complete_folder(tmp_path / "mine") as draft:
        (draft / "a").touch()
    monkeypatch.setattr(files, "HAS_LOCKS", False)
    monkeypatch.delattr(files.os, "pread")
    with complete_folder(tmp_path / "mine", replace=True) as draft:
        (draft / "b").touch()
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["b"]


def test_a_current_folder_that_was_deleted_is_named(tmp_path):
    (tmp_path / "here").mkdir()
    program = (
        f"import os; os.rmdir({str(tmp_path / 'here')!r}); from jax_aero.cli import main; exit(main(['fly', '--list']))"
    )
    run = subprocess.run([sys.executable, "-P", "-c", program], cwd=tmp_path / "here", capture_output=True, text=True)
    assert (run.returncode, run.stderr) == (
        2,
        "error: the current folder has been deleted; expected one that is there: cd to another one\n",
    )
