"""Results: nothing is lost, nothing is silently wrong; what makes a number counts in its digest."""

import errno
import json
import os
import re
import resource
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from jax_aero import cli, rust
from jax_aero.base import files, keys, places, terminal
from jax_aero.base.terminal import Refused
from jax_aero.cli import main
from jax_aero.figures import runs
from jax_aero.results import flight, identity, manifest, record
from jax_aero.results.identity import Identity
from jax_aero.sweep import run, spec
from jax_aero.sweep.design import Design
from jax_aero.view import recording

ROOT = Path(__file__).resolve().parents[2]
SWEEP = {
    "title": "t",
    "description": "d",
    "base": "test2",
    "set": {"simulator.duration": 0.02},
    "axis": [{"name": "speed", "key": "wind.speed", "values": [5, 10, 15]}],
    "chunk": 1,
}


def design(**changes) -> Design:
    return Design(spec.from_table("made_up", SWEEP | changes))


@pytest.fixture
def flown(monkeypatch, make_flight):
    """Make flights up instead of flying them."""
    monkeypatch.setattr(rust, "fly", lambda *_: make_flight(step=0.5))


# --- digests


CHANGES = {
    ".toml": lambda content: content.replace(b"gravity", b"# less\ngravity").replace(b'name = "', b'name = "other '),
    ".json": lambda content: content.replace(b"{", b'{"other": 1,', 1),
}
"""Changes of what a file says."""


def test_every_file_that_a_flight_names_counts_in_its_digest(tmp_path):
    """A new kind of path in the configuration that the digest lacks fails here."""
    config = rust.load_config("test4")
    for place, key in ((config, "wind"), (config["disturbances"], "controller_wind"), (config, "mission")):
        (tmp_path / f"{key}.csv").write_text(key)
        place[key] = {"profile": "file", "path": str(tmp_path / f"{key}.csv")}
    config["mission"] = {"file": config["mission"]["path"]}
    config["controller"]["aero"] = dict(config["simulator"]["aero"])
    named = rust.path_keys(config)
    assert sorted(key.split(".")[-1] for key in named) == ["card", "card", "file", "path", "path", "robot"]
    for number, key in enumerate(named):
        folder, original = tmp_path / str(number), Path(keys.get(config, key))
        folder.mkdir()
        for path in {original, *original.parent.glob(f"{original.stem}.urdf")}:
            (folder / path.name).write_bytes(path.read_bytes())
        before = rust.config_digest(config)
        keys.set_key(config, key, str(folder / original.name))
        assert rust.config_digest(config) == before, "where a file lies counts"
        for path in folder.iterdir():
            said = CHANGES.get(path.suffix, b"\n")
            if path.suffix in CHANGES:
                path.write_bytes(b"\n" + path.read_bytes())
                assert rust.config_digest(config) == before, f"the layout of {path.name} counts"
            path.write_bytes(said(path.read_bytes()) if callable(said) else path.read_bytes() + said)
            after = rust.config_digest(config)
            assert after != before, f"{path.name} does not count"
            before = after


@pytest.mark.parametrize(
    ("key", "name"), [("simulator.aero.card", "card.json"), ("wind.path", "wind.csv"), ("mission.file", "ref.csv")]
)
def test_a_file_that_a_level_names_by_a_dotted_key_counts_and_starts_at_the_sweep(tmp_path, key, name):
    axis = f'[[axis]]\nname = "a"\nlevel = [{{ label = "x", set = {{ "{key}" = "{name}" }} }}]\n'
    (tmp_path / "s.toml").write_text(f'title = "t"\ndescription = "d"\nbase = "test4"\n{axis}')
    digests = set()
    for text in ("one", "other"):
        (tmp_path / name).write_text(text)
        digests.add(Design(spec.load(str(tmp_path / "s.toml"))).digest)
    assert len(digests) == 2


def test_a_file_stands_for_the_files_that_it_names(tmp_path):
    (tmp_path / "robot.toml").write_text('urdf = "robot.urdf"\nbase = "other.toml"\n')
    (tmp_path / "other.toml").write_text('base = "robot.toml"\n')
    hashes = []
    for text in ("one", "other"):
        (tmp_path / "robot.urdf").write_text(text)
        hashes.append(Identity.of({}, [tmp_path / "robot.toml"]).digest)
    (tmp_path / "other.toml").write_text('base = "robot.toml"\nmass = 1\n')
    hashes.append(Identity.of({}, [tmp_path / "robot.toml"]).digest)
    assert len(set(hashes)) == 3


def test_a_result_of_other_numerics_is_refused_and_flown_again_for_a_study(flown, tmp_path, capsys, monkeypatch):
    assert main(["fly", "test1", "--out", str(tmp_path / "flight")]) == 0
    monkeypatch.setitem(identity.VERSIONS, "crate", 9)
    assert main(["fly", "test1", "--out", str(tmp_path / "flight")]) == 2
    assert "was made by other numerics" in capsys.readouterr().err
    monkeypatch.setattr(places, "RESULTS", tmp_path)
    path = flight.obtain("test1")
    assert json.loads(path.with_name("manifest.json").read_text())["numerics"] == {"crate": 9}
    written = path.stat().st_mtime_ns
    assert flight.obtain("test1").stat().st_mtime_ns == written, "what is of today is not flown again"


# --- damage


def test_a_sweep_flies_damaged_chunks_again_and_ends_with_the_same_bytes(tmp_path, capsys, stopped_sweep):
    whole = run.run(design(), workers=1, out=tmp_path / "whole")
    stopped_sweep(design(), 2, tmp_path)
    first, second = sorted((tmp_path / ".made_up.work").rglob("*.part"))
    first.write_bytes(second.read_bytes())
    folder = run.run(design(), workers=1, out=tmp_path)
    assert "0000000-0000001.part is damaged, and made again" in capsys.readouterr().err
    assert all((folder / name).read_bytes() == (whole / name).read_bytes() for name in run.TABLES)
    assert not (tmp_path / ".made_up.work").exists()


def test_a_damaged_table_of_a_finished_sweep_is_refused(tmp_path):
    folder = run.run(design(), workers=1, out=tmp_path)
    for name, expected in (("table.parquet", "is not what was written"), ("sweep.json", "is damaged")):
        (folder / name).write_bytes((folder / name).read_bytes()[:-9])
        with pytest.raises(Refused, match=f"{name} {expected}.*--overwrite"):
            run.run(design(), workers=1, out=tmp_path)
        folder = run.run(design(), workers=1, out=tmp_path, overwrite=True)


def test_a_damaged_result_of_a_flight_is_refused_and_flown_again(flown, tmp_path, capsys):
    assert main(["fly", "test1", "--out", str(tmp_path)]) == 0
    path = tmp_path / "test1" / "run.nc"
    path.write_bytes(path.read_bytes()[:-1])
    assert main(["fly", "test1", "--out", str(tmp_path)]) == 2
    assert "run.nc is not what was written there; --overwrite makes it again" in capsys.readouterr().err
    assert main(["fly", "test1", "--out", str(tmp_path), "--overwrite"]) == 0


def test_overwrite_removes_only_what_was_written(flown, tmp_path, capsys):
    """Also what is hidden, or deeper."""
    sweep = tmp_path / "sweep.toml"
    words = {
        "test1": ["fly", "test1", "--out", str(tmp_path), "--overwrite"],
        "made_up": ["sweep", str(sweep), "--out", str(tmp_path), "--overwrite"],
    }
    sweep.write_text(
        'name = "made_up"\ntitle = "t"\ndescription = "d"\nbase = "test2"\nset = { "simulator.duration" = 0.02 }\n'
        '[[axis]]\nname = "a"\nkey = "wind.speed"\nvalues = [1]\n'
    )
    for folder, command in words.items():
        assert main(command) == 0
        for name in (".notes", "mine/run.nc"):
            path = tmp_path / folder / name
            path.parent.mkdir(exist_ok=True)
            path.write_text("mine")
            capsys.readouterr()
            assert main(command) == 2
            assert name in capsys.readouterr().err
            assert path.read_text() == "mine"
            path.unlink()
        assert main(command) == 0


def test_a_result_behind_a_link_is_overwritten_each_time(flown, tmp_path):
    elsewhere, results = tmp_path / "elsewhere", tmp_path / "results"
    results.mkdir()
    for name in ("test1", "made_up"):
        (results / name).symlink_to(elsewhere / name)
    for _ in range(3):
        assert main(["fly", "test1", "--out", str(results), "--overwrite"]) == 0
        run.run(design(), workers=1, out=results, overwrite=True)
    assert sorted(path.name for path in elsewhere.iterdir()) == ["made_up", "test1"]
    assert [path.is_symlink() for path in results.iterdir()] == [True, True]


def test_a_number_that_json_lacks_is_null_however_deep_it_stands():
    summary = {"a": np.inf, "flight": {"com_error": np.nan, "outcome": "fell"}}
    document = manifest.build("x", "x", {}, Identity("0"), summary=summary, command=["x"], backend="rust")
    assert document["summary"] == {"a": None, "flight": {"com_error": None, "outcome": "fell"}}


def test_every_file_of_a_study_counts_as_its_own(tmp_path):
    for value in ("old", "new"):
        record.write_run(tmp_path / "a", xr.Dataset(), {}, replace=value == "new", texts={f"{value}.csv": value})
    assert sorted(files.checksums(tmp_path / "a")) == ["manifest.json", "new.csv", "run.nc"]


def test_a_flight_is_written_without_xarray_as_by_it(tmp_path, make_flight):
    """Names, values, attributes and how they are packed; and no package that takes longer to import than a flight."""
    path = tmp_path / "run.nc"
    made = record.to_variables(make_flight(), rust.Robot(places.ROBOT), title="made up", config_digest="abc")
    files.write_variables(path, made)
    files.write_netcdf(tmp_path / "other.nc", xr.Dataset(*made))
    with xr.open_dataset(path) as found, xr.open_dataset(tmp_path / "other.nc") as expected:
        xr.testing.assert_identical(found, expected)
        for name in expected.variables:
            packing = [{**of[name].encoding, "source": ""} for of in (found, expected)]
            assert repr(packing[0]) == repr(packing[1]), name
    words = ["fly", "test2", "--set", "simulator.duration=0.02", "--out", str(tmp_path)]
    code = f"""import sys
from jax_aero.cli import main
assert main({words}) == 0
print({{"xarray", "pandas"}} & {{*sys.modules}})"""
    shown = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout
    assert shown.endswith("set()\n")


@pytest.mark.parametrize("command", ["sweep", "fly", "figures", "air", "train", "view snapshot", "robot waypoints"])
def test_an_empty_path_is_refused(command, capsys):
    with pytest.raises(SystemExit):
        cli.main([*command.split(), "name", "--out", ""])
    assert "the path is empty; expected a file or folder" in capsys.readouterr().err


# --- one process at a time


HOLDS = (
    "import sys, time; from pathlib import Path; from jax_aero.base.files import lock\nwith lock(Path(sys.argv[1])):"
)


def test_who_holds_a_sweep_is_named_and_a_dead_holder_followed(tmp_path, start):
    code = f"{HOLDS}\n    print('held', flush=True); time.sleep(600)"
    holder = start(sys.executable, "-c", code, tmp_path / "made_up", cwd=ROOT, stdout=subprocess.PIPE)
    assert holder.stdout.readline() == b"held\n"
    with pytest.raises(Refused, match=rf"made_up is being written by process {holder.pid} on \S+ since 20\d\d-"):
        run.run(design(), workers=1, out=tmp_path)
    assert not (tmp_path / "made_up").exists()
    (tmp_path / "link").symlink_to(tmp_path / "made_up")
    with pytest.raises(Refused, match="is being written"), files.lock(tmp_path / "link"):
        pass
    (tmp_path / "link").unlink()
    holder.kill()
    holder.wait()
    assert (tmp_path / ".made_up.lock").exists()
    run.run(design(), workers=1, out=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["made_up"]


def test_a_flight_that_another_process_flies_is_not_flown(flown, tmp_path, capsys, monkeypatch):
    with files.lock_work(tmp_path / "test1"), monkeypatch.context() as patched:
        patched.setattr(rust, "fly", lambda *_: pytest.fail("it is flown"))
        assert main(["fly", "test1", "--out", str(tmp_path)]) == 2
    assert f".test1.work is being written by process {os.getpid()}" in capsys.readouterr().err
    assert main(["fly", "test1", "--out", str(tmp_path)]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["test1"]


def test_a_lock_of_another_machine_is_left_alone(tmp_path):
    lock = tmp_path / ".a.lock"
    lock.write_text(json.dumps({"pid": 1, "host": "elsewhere.invalid", "since": "2026"}))
    expected = r"process 1 on elsewhere.invalid since 2026; if .* has ended, wait \d+ s or remove .*\.a\.lock"
    with pytest.raises(Refused, match=expected), files.lock(tmp_path / "a"):
        pass
    for nothing in ("", "[" * 4096):
        lock.write_text(nothing)
        with files.lock(tmp_path / "a"):
            assert json.loads(lock.read_text())["pid"] == os.getpid()


def test_a_lock_of_another_machine_that_is_not_renewed_is_taken_over(tmp_path, monkeypatch):
    """As by a job that a cluster starts anew on another node; one that is held is renewed."""
    lock = tmp_path / ".a.lock"
    holder = json.dumps({"pid": 1, "host": "elsewhere.invalid", "since": "2026"})
    lock.write_text(holder)
    os.utime(lock, times=(0, time.time() - 0.9 * files.STALE))
    with pytest.raises(Refused, match=r"wait \d+ s or remove"), files.lock(tmp_path / "a"):
        pass
    os.utime(lock, times=(0, time.time() - 1.1 * files.STALE))
    message = (
        r"\.a\.lock of process 1 on elsewhere\.invalid since 2026 was not renewed for 3 minutes, and is taken over"
    )
    with pytest.warns(UserWarning, match=message), files.lock(tmp_path / "a"):
        assert json.loads(lock.read_text())["pid"] == os.getpid()
    assert not lock.exists()
    monkeypatch.setattr(files, "RENEWAL", 0.01)
    with files.lock(tmp_path / "a"):
        os.utime(lock, times=(0, 0))
        while lock.stat().st_mtime < time.time() - 60.0:
            time.sleep(0.01)
    assert not any(thread.name.endswith("(_renew)") for thread in threading.enumerate())


def test_the_lock_of_another_user_says_whose_it_is(tmp_path, monkeypatch):
    lock, opened = tmp_path / ".a.lock", os.open

    def of_another(path, *rest):
        if path == lock:
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return opened(path, *rest)

    monkeypatch.setattr(os, "open", of_another)
    with pytest.raises(PermissionError), files.lock(tmp_path / "a"):  # of the folder
        pass
    os.close(opened(lock, os.O_CREAT))
    message = rf"\.a\.lock is a lock of user {os.getuid()}, who removes it .* choose another --out"
    with pytest.raises(Refused, match=message), files.lock(tmp_path / "a"):
        pass


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP", "SIGINT"])
def test_a_command_that_is_stopped_leaves_no_lock(name, tmp_path, start):
    code = (
        "import signal, sys, time; from pathlib import Path; from jax_aero.base import files, terminal\n"
        "signal.signal(signal.SIGHUP, signal.SIG_DFL); signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "def work():\n    with files.complete_folder(Path(sys.argv[1])):\n"
        "        print('held', flush=True); time.sleep(60)\n"
        "sys.exit(terminal.run_with_output(lambda: terminal.exit_status(work)))"
    )
    holder = start(sys.executable, "-c", code, tmp_path / "a", cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert holder.stdout.readline() == b"held\n"
    holder.send_signal(getattr(signal, name))
    assert (holder.wait(), b"interrupted" in holder.stderr.read()) == (130, True)
    assert [*tmp_path.iterdir()] == []


def test_a_signal_that_is_ignored_stays_so(monkeypatch):
    """As SIGHUP by `nohup`."""
    monkeypatch.setattr(signal, "getsignal", {signal.SIGTERM: signal.SIG_DFL, signal.SIGHUP: signal.SIG_IGN}.get)
    caught = []
    monkeypatch.setattr(signal, "signal", lambda number, handler: caught.append((number, handler)))
    terminal.run_with_output(lambda: 0)
    assert caught == [(signal.SIGTERM, signal.default_int_handler)]


@pytest.mark.parametrize("name", [b"gr\xf6\xdfe", b"\xff", b"caf\xe9 x"])
def test_a_folder_whose_name_is_no_text_has_results(name, tmp_path, capsys):
    """As an archive of an old Windows writes them; a configuration in such a folder is refused."""
    folder = tmp_path / os.fsdecode(name)
    try:
        folder.mkdir()
    except OSError:
        pytest.skip("the file system has names in UTF-8 only")
    changes = ["--set", "simulator.duration=0.1"]
    assert main(["fly", "test1", *changes, "--out", str(folder)]) == 0
    (manifest,) = folder.rglob("manifest.json")
    assert "--out" in json.loads(manifest.read_text())["command"]
    capsys.readouterr()
    (folder / "own.toml").write_text('base = "test1.toml"\n')
    assert main(["fly", str(folder / "own.toml"), *changes]) == 2
    assert "is not UTF-8; expected one that is" in capsys.readouterr().err


# --- a disk that is full, or read-only


@contextmanager
def longest_file(size: int):
    """Let this process write no file that is longer [bytes]: the system's error is like that of a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_what_cannot_be_written_is_one_line_and_leaves_nothing_half(flown, tmp_path, capsys):
    """Written as HDF5 onto the disk, a flight ended the process here."""
    with longest_file(20_000):
        assert main(["fly", "test1", "--out", str(tmp_path)]) == 2
    assert re.fullmatch(r"error: \S+run\.nc: File too large\n", capsys.readouterr().err)
    assert list(tmp_path.iterdir()) == []

    with longest_file(500), pytest.raises(OSError, match=r"File too large: '\S+0000000-0000001\.part'"):
        run.run(design(), workers=1, out=tmp_path)
    assert list((tmp_path / ".made_up.work").rglob("*.part")) == []
    run.run(design(), workers=1, out=tmp_path)


# --- reading what is damaged


def test_the_viewer_reads_a_damaged_result_whole_or_refuses_it(tmp_path, make_flight):
    """Bits turned, ends cut, values exchanged: 150 times, with and without the checksum."""
    config = rust.load_config("test2")
    folder = tmp_path / "run"
    dataset = record.to_dataset(make_flight(step=5.0), rust.Robot(config["robot"]), title="t", config_digest="")
    record.write_run(folder, dataset, {"config": config})
    whole = {path.name: path.read_bytes() for path in folder.iterdir()}
    recording.read(folder)
    rng = np.random.default_rng(0)
    refused = 0
    for trial in range(150):
        name = ("run.nc", "manifest.json")[trial % 2]
        content = bytearray(whole[name])
        if trial % 3 == 0:
            del content[rng.integers(len(content)) :]
        else:
            for place in rng.integers(len(content), size=1 + trial % 7):
                content[place] = rng.integers(256)
        manifest = json.loads(whole["manifest.json"])
        if trial % 4 < 2:  # a result from before there were checksums
            del manifest["files"]
        (folder / "manifest.json").write_text(json.dumps(manifest))
        (folder / name).write_bytes(content)
        try:
            recording.read(folder).at(3.0)
        except Refused:
            refused += 1
        for other, bytes_ in whole.items():
            (folder / other).write_bytes(bytes_)
    assert refused > 75
    recording.read(folder)


def test_a_figure_calls_a_damaged_result_missing(flown, tmp_path):
    assert main(["fly", "test1", "--out", str(tmp_path / "flight")]) == 0
    path = tmp_path / "flight" / "test1" / "run.nc"
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(runs.MissingRun, match=r"run\.nc is damaged .*; remove its folder and make it again"):
        runs.load(tmp_path, "test1")
