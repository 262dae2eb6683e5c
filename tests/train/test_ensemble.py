"""The ensemble of networks: what its intervals are made of, and a run whose networks are not trained."""

import json

import numpy as np
import pytest
import xarray as xr

from jax_aero.aero.dataset import save
from jax_aero.aero.network_card import load_network
from jax_aero.base import places
from jax_aero.cli import main
from jax_aero.train import ensemble

BASE = places.CONFIGS / "training" / "compact.toml"


def test_intervals_are_conformal_across_families(agree):
    """Errors e of two networks e ± s/√2 along x, whose spread is s; quantiles are linear between ranks."""
    error, spread = np.array([1.0, 2.0, 3.0, 10.0]), np.array([1.0, 1.0, 1.0, 5.0])
    predicted = np.zeros((2, 4, 3))
    predicted[:, :, 0] = error + np.array([[1.0], [-1.0]]) * spread / np.sqrt(2.0)
    found = ensemble.intervals(predicted, np.zeros((4, 3)), np.array([5, 5, 5, 8]))
    # The mean of s² is 7: scores are errors over √8, √8, √8 and √32.
    factor = 4.4 / np.sqrt(8.0)  # between 3 and 5, at 2.7 of 3 steps
    expected = {
        "factor": factor,
        "spread_rms": np.sqrt(7.0),
        "rms": np.sqrt(114.0 / 4.0),
        # The three rows of one family are covered by the score of the other, and not the other way round.
        "coverage": 0.75,
        "coverage_min": 0.0,
        "coverage_max": 1.0,
        "half_width": 5.5,
        "correlation": np.corrcoef(error, spread)[0, 1],
    }
    assert found.keys() == expected.keys()
    agree("intervals", list(found.values()), list(expected.values()), 1e-12)


def test_intervals_cover_what_they_say_where_the_error_follows_the_spread():
    rng = np.random.default_rng(3)
    family = np.repeat(np.arange(10), 400)
    size = rng.uniform(0.5, 2.0, size=(4000, 1))
    truth = np.zeros((4000, 3))
    predicted = size * rng.normal(size=(8, 4000, 3))
    found = ensemble.intervals(predicted, truth, family)
    # 4000 draws: a standard deviation of 0.5 per cent about 90.
    assert 0.88 < found["coverage"] < 0.92
    assert found["coverage_min"] < found["coverage"] < found["coverage_max"]


def test_factors_on_links_add_what_the_spread_of_the_networks_lacks(measured):
    rng = np.random.default_rng(4)
    of_links = rng.normal(size=(50, 13, 3))
    half = ensemble.link_half_width({"rms": 1.3, "spread_rms": 0.5}, of_links)
    factors = rng.uniform(-half, half, size=(4000, 1, 13, 1))
    added = np.mean(np.sum(np.sum(factors * of_links, axis=2) ** 2, axis=-1))
    assert ensemble.link_half_width({"rms": 0.5, "spread_rms": 1.3}, of_links) == 0.0
    # A mean over 4000 draws of a sum of squares whose standard deviation is at most √2 of its mean; four of them.
    measured("variance that is added", abs(added / (1.3**2 - 0.5**2) - 1.0), 4 * np.sqrt(2.0 / 4000))


def test_members_of_an_ensemble_differ_and_miss_one_posture(made_up_dataset):
    trainings = [ensemble.member_training(BASE, changes, 3) for changes in ensemble.MEMBERS]
    assert len({repr(one.network) for one in trainings}) == len(trainings) == 8
    family = made_up_dataset.family
    kept = ensemble.leave_one_out(made_up_dataset, np.arange(len(family)), 0)
    assert len(set(family[kept])) == len(set(family)) - 1
    assert len(kept) == np.sum(np.isin(family, family[kept]))


def test_the_shipped_ensemble_has_the_listed_networks(ironcub):
    folder = places.CONFIGS / "aero" / "networks" / "ensemble"
    for number, changes in enumerate(ensemble.MEMBERS):
        shipped = load_network(folder / f"member_{number}.json", ironcub)
        listed = ensemble.member_training(BASE, changes, 1).network
        assert shipped.blocks == tuple(listed.features)
        assert shipped.hidden == tuple(listed.hidden)
        assert shipped.activation == listed.activation


@pytest.mark.slow
def test_networks_predict_postures_that_they_have_not_seen(
    made_up_dataset, ironcub, tmp_path, monkeypatch, capsys, agree
):
    """The second call goes on with what the first has computed, and writes networks that lack one posture each."""
    path, seen = tmp_path / "made_up.nc", []
    save(made_up_dataset, path)

    def skip_training(number, training, rows):
        seen.append(set(rows.postures))
        return training.start(ensemble.SEED + number)

    monkeypatch.setattr(ensemble, "train_member", skip_training)
    monkeypatch.setattr(ensemble, "MEMBERS", ({"hidden": [4]}, {"hidden": [5], "baseline": "none"}))
    monkeypatch.setattr(ensemble, "FOLDS", 2)
    words = ["train", "ensemble", "--dataset", str(path), "--epochs", "3", "--out", str(tmp_path / "out")]
    assert main(words) == 0
    # Of two folds one is the other's rest, of three postures; each network of a fold lacks another one of them.
    everything = set(made_up_dataset.postures)
    assert [len(rows) for rows in seen] == [2] * 4
    assert not (seen[0] | seen[1]) & (seen[2] | seen[3])
    assert everything == set().union(*seen)

    assert main([*words, "--write", str(tmp_path / "written")]) == 0
    assert [len(rows) for rows in seen[4:]] == [5, 5]
    with xr.open_dataset(tmp_path / "out" / "run.nc", engine="h5netcdf") as run:
        assert run["predicted_force_area"].shape == (2, 288, 3)
        assert set(run["posture"].values) == everything
        truth = made_up_dataset.add_mirror_images().force_area_b.sum(axis=1)
        agree("force areas", run["force_area"].values, truth, 1e-9)
    document = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert document["dataset"] == made_up_dataset.add_mirror_images().sha256
    summary = document["summary"]
    best, worst = (summary[f"links, {which} single network [m4]"] for which in ("best", "worst"))
    assert 0.0 < best < worst
    card = json.loads((tmp_path / "written" / "ensemble.json").read_text())
    assert card["unseen_postures"]["links, best single network [m4]"] == best
    for member, rows in zip(card["members"], seen[4:], strict=True):
        (left_out,) = everything - rows
        assert f"not shown {left_out}" in (tmp_path / "written" / member).read_text()
        load_network(tmp_path / "written" / member, ironcub)

    (kept,) = tmp_path.glob(".out.work/*/fold-0-member-1.part")
    kept.write_bytes(kept.read_bytes()[:-9] + bytes(9))
    assert main(words) == 0
    assert len(seen) == 7, "what is damaged is trained again"
