"""The training commands from end to end, on a small made-up dataset."""

import csv
import importlib
import json
import sys
from collections import namedtuple
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from PIL import Image
from tqdm import tqdm

from jax_aero.aero.dataset import load, save
from jax_aero.aero.network_card import load_network
from jax_aero.base import files, places, plain_values, tables
from jax_aero.base.terminal import INTERRUPTED, Refused
from jax_aero.body.robot import load_robot
from jax_aero.cli import main
from jax_aero.commands import train as command
from jax_aero.commands.figures import main as draw
from jax_aero.results import record
from jax_aero.train import Interrupted, config, predict_areas
from jax_aero.train.result import card_facts
from tests import cfd_table

Found = namedtuple("Found", "error")

# A small plain network: what is compiled is what takes the time.
SMALL = {
    "network.features": '["wind", "joints"]',
    "network.frame": "base",
    "network.layout": "component",
    "network.mirror": "false",
    "training.epochs": "4",
    "training.batch": "32",
    "training.validate_every": "2",
    "network.hidden": "[8]",
    "ensemble.members": "2",
    "distillation.samples": "40",
    "distillation.training.epochs": "2",
    "distillation.training.batch": "32",
    "distillation.training.validate_every": "1",
    "validation.fraction": "0.333333",  # as many rows as a fold: the same shapes, compiled once
    "validation.folds": "3",
    "validation.folds_run": "2",
    "chosen_on": '["posture0"]',
}


@pytest.fixture(scope="module")
def data(made_up_dataset, tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "made_up.nc"
    save(made_up_dataset, path)
    return path


def words(data, out, **changes):
    settings = SMALL | {key.replace("__", "."): value for key, value in changes.items()}
    options = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
    return ["train", "compact", "--dataset", str(data), "--out", str(out), *options]


@pytest.fixture(scope="module")
def result(data, tmp_path_factory):
    results = tmp_path_factory.mktemp("results")
    out = results / "training" / "compact"
    assert main([*words(data, out), "--write", str(results / "networks" / "small.json")]) == 0
    return results


def test_a_network_may_be_of_another_robot():
    """It has the outputs of that robot's links and corrects one of its coefficient sets, no other's."""
    path = places.CONFIGS / "training" / "open.toml"
    robot = {"robot": "../robot/ironcub_mk3.toml"}
    training, _ = config.read(path, {**robot, "network.baseline": "estimated"})
    model = training.robot_model
    assert training.start(0).layers[-1].bias.shape[-1] == 3 * len(model.aero_links.names) == 48
    with pytest.raises(Refused, match=r'`network\.baseline` is "signed"; expected one of none, cfd, estimated'):
        config.read(path, robot)


@pytest.mark.slow
def test_a_result_holds_errors_of_both_splits_beside_baselines(result, made_up_dataset, agree):
    document = json.loads((result / "training" / "compact" / "manifest.json").read_text())
    assert document["dataset"] == made_up_dataset.add_mirror_images().sha256
    errors = document["summary"]["errors"]
    assert set(errors) == {"random", "grouped"}
    assert errors["grouped"]["folds"] == 2
    assert "axisymmetric, signed" in errors["grouped"]["baselines"]
    table = xr.load_dataset(result / "training" / "compact" / "run.nc", engine="h5netcdf")
    predicted = table["area_grouped"].values
    held = np.isfinite(predicted[:, 0, 0])
    assert held.sum() == 4 * 24 * 2
    # Whole postures, their mirror images with them, and no others.
    assert len(set(table["posture"].values[held])) == 4
    assert not set(table["posture"].values[held]) & set(table["posture"].values[~held])
    mse = np.mean(np.sum((predicted[held] - table["area"].values[held]) ** 2, axis=(1, 2)))
    agree("grouped error", errors["grouped"]["mse"], mse, 1e-5)
    elsewhere = [value for name, value in errors["grouped"]["by_posture"].items() if name != "posture0"]
    agree("error at other postures", errors["grouped"]["elsewhere_mse"], np.mean(elsewhere), 1e-12)
    for network in ("member-1", "student"):
        assert np.isfinite(table["train_loss"].sel(curve=f"grouped-0-0-{network}").values[:2]).all()


def test_the_weights_are_written_where_flights_find_them(result, ironcub, made_up_dataset):
    written, kept = result / "networks" / "small.json", result / "training" / "compact" / "compact.json"
    card, of_result = (json.loads(path.read_text()) for path in (written, kept))
    assert card["training"]["dataset_sha256"] == made_up_dataset.add_mirror_images().sha256
    assert card["training"]["errors"]["grouped"]["mse"] > 0.0
    assert card["weights"]["sha256"] == of_result["weights"]["sha256"]
    network = load_network(written, ironcub)
    error = predict_areas(network, ironcub, made_up_dataset) - made_up_dataset.force_area_b
    assert np.mean(error**2) < np.mean(made_up_dataset.force_area_b**2)


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("data/outputParameters.csv at 0d43057", "that the authors of the paper made public"),
        ("OpenFOAM (simpleFoam, k-omega SST) around primitives", "simulations by an open solver"),
        ("mine.csv", "no part of this project"),
    ],
)
def test_a_card_says_whose_data_they_are(made_up_dataset, source, words):
    data = replace(made_up_dataset, provenance={"source": source})
    facts = card_facts(data, {}, epochs=1, seed=1, source="data.nc", held_out="")
    assert words in facts["note"]


@pytest.mark.slow
def test_figures_are_drawn_from_the_result(result, tmp_path):
    flights = ["--results", str(result), "--out", str(tmp_path)]
    assert draw(["fig4_network", "training", *flights]) == 0
    for name in ("fig4_network", "training"):
        with Image.open(tmp_path / f"{name}.png") as picture:
            assert "compact config" in picture.info["Description"]


def test_an_interrupted_run_goes_on_and_ends_as_if_nothing_had_been(result, data, tmp_path, monkeypatch, capsys):
    out = tmp_path / "compact"
    run = command.parts.run
    done, bars = [], []

    class Bar(tqdm):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            bars.append(self)

    monkeypatch.setattr(command, "tqdm", Bar)

    def stop_at_the_second(part, *arguments):
        done.append(part.name)
        if len(done) == 2:
            raise Interrupted
        return run(part, *arguments)

    monkeypatch.setattr(command.parts, "run", stop_at_the_second)
    assert main(words(data, out)) == INTERRUPTED
    assert "the same command goes on" in capsys.readouterr().err
    assert not out.exists()
    assert main(words(data, out)) == 0
    assert done == ["grouped-0-0", "grouped-0-1", "grouped-0-1", "random-56", "final"]
    # Epochs of the first call count as done, and not as done in no time.
    all_epochs = bars[0].total
    assert [(bar.initial, bar.n) for bar in bars] == [(0, all_epochs // 4), (all_epochs // 4, all_epochs)]
    whole = result / "training" / "compact" / "compact.safetensors"
    assert (out / "compact.safetensors").read_bytes() == whole.read_bytes()


def test_without_out_the_folder_names_what_was_set(data, tmp_path, monkeypatch):
    trained = []
    monkeypatch.setattr(command, "RESULTS", tmp_path)
    monkeypatch.setattr(command, "_train", lambda *given: trained.append(given[-1].folder) or sys.exit("trained"))
    for options in ([], ["--set", "training.epochs=20"]):
        with pytest.raises(SystemExit, match="trained"):
            main(["train", "compact", "--dataset", str(data), *options])
    assert trained == [tmp_path / ".compact.work", tmp_path / ".compact--training.epochs=20.work"]


def test_another_result_is_not_replaced(result, made_up_dataset, data, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(command, "_train", lambda *_: sys.exit("trained"))
    other = tmp_path / "other.nc"
    save(made_up_dataset.take(np.arange(96)), other)
    out, flight = result / "training" / "compact", tmp_path / "flight"
    record.write_run(flight, xr.Dataset(), {"config_digest": "f" * 64})
    for arguments in (words(other, out), words(data, out, seed="7"), words(data, flight)):
        assert main(arguments) == 2
        assert "holds the result of another configuration; choose another name or --out" in capsys.readouterr().err
        with pytest.raises(SystemExit, match="trained"):
            main([*arguments, "--overwrite"])
    (flight / "notes.txt").touch()
    assert main([*words(data, flight), "--overwrite"]) == 2
    assert "flight holds more than a result (notes.txt), so it is not overwritten" in capsys.readouterr().err


def test_a_finished_training_is_kept_and_its_weights_can_be_written_again(result, data, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(command, "_train", lambda *_: sys.exit("trained"))
    out, written = result / "training" / "compact", tmp_path / "again.json"
    assert main([*words(data, out), "--write", str(written)]) == 0
    printed = capsys.readouterr().out
    assert "compact is finished already" in printed
    assert "worst fold" in printed
    card, kept = json.loads(written.read_text()), json.loads((out / "compact.json").read_text())
    assert (card.pop("name"), card["weights"].pop("file")) == ("again", "again.safetensors")
    assert (kept.pop("name"), kept["weights"].pop("file")) == ("compact", "compact.safetensors")
    assert card == kept
    assert written.with_suffix(".safetensors").read_bytes() == (out / "compact.safetensors").read_bytes()


def test_two_processes_do_not_train_into_one_folder(data, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with files.lock_work(tmp_path / "one"):
        for arguments in (words(data, "one"), ["train", "ensemble", "--dataset", str(data), "--out", "one"]):
            assert main(arguments) == 2
            assert ".one.work is being written by process" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_folder_is_named_by_where_it_is(data, tmp_path, monkeypatch, capsys):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    for part in ("compact", "ensemble"):
        assert main(["train", part, "--dataset", str(data), "--out", "."]) == 2
        assert "holds no finished result; choose another name or --out, or --overwrite it" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changes", "options", "message"),
    [
        ({}, ["--write", "weights.safetensors"], "path is 'weights.safetensors'; expected the card's name"),
        ({"network__baseline": "best"}, [], "`network.baseline` is"),
        ({"validation__folds_run": "9"}, [], "`validation.folds_run` is 9; expected at most 3"),
        ({"training__noise": "{ colour = 1.0 }"}, [], '`training.noise` is ["colour"]; expected blocks'),
        ({"validation__folds": "1", "validation__folds_run": "1"}, [], "folds is 1; expected 2 to 6"),
        (
            {"validation__fraction": "1e-9"},
            [],
            "`validation.fraction` is 1e-09, which holds out 0 of 288 rows; expected some of them, not all",
        ),
        (
            {"network__features": '["wind", "wind"]'},
            [],
            '`network.features` is ["wind","wind"]; expected one value or more',
        ),
        ({"validation__random_seeds": "[1, 1]"}, [], "`validation.random_seeds` is [1,1]; expected each seed once"),
        ({"validation__fold_seeds": "[2, 2]"}, [], "`validation.fold_seeds` is [2,2]; expected each seed once"),
    ],
)
def test_what_is_wrong_or_cannot_end_is_refused_before_the_training(
    data, tmp_path, monkeypatch, capsys, changes, options, message
):
    monkeypatch.setattr(command, "_train", lambda *_: sys.exit("trained"))
    assert main([*words(data, tmp_path / "out", **changes), *options]) == 2
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_refused_training_does_not_hold_the_next_one_up(data, tmp_path, monkeypatch, capsys):
    assert main(words(data, tmp_path / "out", training__batch="1000")) == 2
    assert "`batch` is 1000; there are 192 rows" in capsys.readouterr().err
    monkeypatch.setattr(command, "_train", lambda *_: sys.exit("trained"))
    with pytest.raises(SystemExit, match="trained"):
        main(words(data, tmp_path / "out"))


def test_a_search_keeps_its_trials_and_goes_on(data, tmp_path, capsys):
    pytest.importorskip("optuna", reason="optuna is not installed: make setup")
    base = tmp_path / "base.toml"
    table = tables.read(places.CONFIGS / "training" / "plain.toml")
    table |= {"robot": str(places.ROBOT)}
    table["training"] |= {"epochs": 2, "batch": 32, "validate_every": 1}
    base.write_text(plain_values.toml(table))
    search = tmp_path / "small.toml"
    search.write_text(
        'base = "base.toml"\ntrials = 2\nseed = 1\nfold_seed = 0\nfolds = 3\nfolds_run = 1\n[space]\n'
        '"network.hidden" = { choices = [[4], [6]] }\n'
        '"training.learning_rate" = { low = 1e-3, high = 1e-2, log = true }\n'
    )
    out = tmp_path / "out"
    arguments = ["train", "search", str(search), "--dataset", str(data), "--out", str(out)]
    assert main([*arguments, "--trials", "1"]) == 0
    assert main(arguments) == 0
    assert "trial 2 of 2" in capsys.readouterr().out
    rows = table_of(out / "trials.csv")
    assert len(rows) == 2
    document = json.loads((out / "manifest.json").read_text())
    assert document["summary"]["trials"] == 2
    assert document["dataset"] == load(data, load_robot(places.ROBOT)).sha256
    assert (document["config"]["folds"], document["config"]["base"]["network"]["features"]) == (3, ["wind", "joints"])
    assert document["config"]["space"].keys() == {"network.hidden", "training.learning_rate"}
    # One that is not interrupted draws the same, and not twice.
    assert main([*arguments[:-1], str(tmp_path / "whole")]) == 0
    whole = table_of(tmp_path / "whole" / "trials.csv")
    drawn, again = ([row["training.learning_rate"] for row in found] for found in (rows, whole))
    assert drawn == again
    assert drawn[0] != drawn[1]


@pytest.fixture
def search():
    """The module of searches, whose package is not always there."""
    pytest.importorskip("optuna", reason="optuna is not installed: make setup")
    return importlib.import_module("jax_aero.train.search")


@pytest.fixture
def small_search(search, data, tmp_path):
    """A search in the learning rate: how to write its command, with a folder for the result."""
    settings = tmp_path / "small.toml"
    settings.write_text(
        f'base = "{places.CONFIGS}/training/plain.toml"\ntrials = 3\nseed = 1\nfold_seed = 0\nfolds = 3\n'
        'folds_run = 1\n[space]\n"training.learning_rate" = { low = 1e-3, high = 1e-2 }\n'
    )
    return lambda name: ["train", "search", str(settings), "--dataset", str(data), "--out", str(tmp_path / name)]


def test_an_interrupted_search_draws_what_it_would_have_drawn(small_search, tmp_path, monkeypatch, capsys):
    calls = []

    def stop_at_the_second(training, *_):
        calls.append(training.training.learning_rate)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return training.training.learning_rate

    monkeypatch.setattr("jax_aero.train.search.error_of", stop_at_the_second)
    assert main(small_search("stopped")) == INTERRUPTED
    assert capsys.readouterr().err == "interrupted; the same command goes on with the next trial\n"
    assert main(small_search("stopped")) == 0
    assert main(small_search("whole")) == 0
    assert calls[1] == calls[2]
    assert [calls[0], *calls[2:4]] == calls[4:]
    assert [path.name for path in (tmp_path / "stopped").iterdir()] == ["manifest.json", "trials.csv"]
    stopped, whole = (table_of(tmp_path / name / "trials.csv") for name in ("stopped", "whole"))
    assert stopped == whole


def table_of(path):
    """The trials of a search, without their times."""
    with path.open() as stream:
        return [{key: value for key, value in row.items() if key != "seconds"} for row in csv.DictReader(stream)]


def test_a_search_replaces_no_other_result(small_search, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("jax_aero.train.search.error_of", lambda *_: 1.0)
    record.write_run(tmp_path / "flight", xr.Dataset(), {})
    assert main(small_search("search")) == 0
    assert json.loads((tmp_path / "search" / "manifest.json").read_text())["name"] == "search"
    settings = tmp_path / "small.toml"
    settings.write_text(settings.read_text().replace("seed = 1\n", "seed = 2\n"))
    for name in ("flight", "search"):
        before = files.checksums(tmp_path / name)
        assert main(small_search(name)) == 2
        assert f"{name} holds the result of another configuration; choose another" in capsys.readouterr().err
        assert files.checksums(tmp_path / name) == before


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("low = 1e-2, high = 1e-3", "expected a number below high, 0.001"),
        ("low = 0.0, high = 1e-3, log = true", "expected a number above 0, as its logarithm is searched"),
        ("choices = []", "expected a list of 1 or more"),
    ],
)
def test_a_range_that_holds_nothing_is_refused_before_the_search(small_search, tmp_path, capsys, text, expected):
    settings = tmp_path / "small.toml"
    settings.write_text(settings.read_text().replace("low = 1e-3, high = 1e-2", text))
    assert main(small_search("out")) == 2
    said = capsys.readouterr().err
    assert "small.toml: `space.training.learning_rate" in said
    assert expected in said
    assert not (tmp_path / "out").exists()


def test_a_search_starts_from_a_file_that_leaves_noise_at_its_default(search):
    path = places.CONFIGS / "training" / "compact.toml"
    table = tables.read(path)
    kept = search.replace_keys(path, table, {"network.features": ["link_wind"]})
    assert set(kept.training.noise) == {"link_wind"}
    del table["training"]["noise"]
    assert search.replace_keys(path, table, {}).training.noise == {}


def test_a_trial_whose_network_diverges_has_an_infinite_error(search, made_up_dataset):
    changes = {"network.hidden": [4, 4, 4], "training.epochs": 2, "training.batch": 32, "training.learning_rate": 1e9}
    path = places.CONFIGS / "training" / "plain.toml"
    settings = search.SearchConfig(path, trials=1, seed=1, fold_seed=0, folds=3, folds_run=1, space={})
    assert search.error_of(search.replace_keys(path, tables.read(path), changes), made_up_dataset, settings) == np.inf


@pytest.mark.slow
def test_another_robot_is_trained_on_its_own_joints_and_links(tmp_path):
    """iRonCub-Mk3 has links that iRonCub-Mk1 lacks, and ankles that move one of them."""
    robot = places.find("robot", "ironcub_mk3")
    links, rng = tuple(load_robot(robot).aero_links.names), np.random.default_rng(2)
    joints = ("torso_pitch", "l_hip_pitch", "r_hip_pitch", "l_ankle_pitch", "r_ankle_pitch")
    pitch, yaw = rng.uniform(0.0, 180.0, 8), rng.uniform(-180.0, 180.0, 8)
    postures = {f"posture{index}": angles for index, angles in enumerate(rng.uniform(-20.0, 20.0, (3, len(joints))))}
    areas = rng.normal(scale=0.01, size=(24, len(links), 3))
    made = cfd_table.made_up_dataset(postures, pitch, yaw, areas, joints=joints, links=links)
    save(made, tmp_path / "mk3.nc")
    changes = {
        "robot": f'"{robot}"',
        "network.hidden": "[4]",
        "training.epochs": "2",
        "training.batch": "16",
        "validation.folds": "3",
        "validation.folds_run": "1",
        "validation.random_seeds": "[]",
    }
    options = [word for key, value in changes.items() for word in ("--set", f"{key}={value}")]
    assert (
        main(["train", "plain", "--dataset", str(tmp_path / "mk3.nc"), "--out", str(tmp_path / "out"), *options]) == 0
    )
    with xr.open_dataset(tmp_path / "out" / "run.nc", engine="h5netcdf") as run:
        assert (tuple(run["link"].values), tuple(run["joint"].values)) == (links, joints)
        assert np.isfinite(run["area_grouped"].values[:, 0, 0]).sum() == 16
    with pytest.raises(ValueError, match=r"links of .*mk3.nc are .*; expected "):
        load(tmp_path / "mk3.nc", load_robot(places.ROBOT))
