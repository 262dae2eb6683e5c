"""The benchmark of training: its steps are our loop's, and a network that has become slower is named."""

import pytest

from experiments.tools import bench_train as bench
from jax_aero.base import places
from jax_aero.stored import kept


def test_a_step_of_the_loop_has_six_operations_per_weight_and_row(monkeypatch):
    monkeypatch.setattr(bench, "PRODUCT", 4)
    monkeypatch.setattr(bench, "NETWORKS", {"2 × 3": (3, 3)})
    cases = bench.networks()
    assert cases["NumPy"][0] == 2 * 4**3
    assert cases["2 × 3"][0] == 6 * 4 * (22 * 3 + 3 * 3 + 3 * 39)
    state, loss = cases["2 × 3"][1]()
    assert (state.layers[1].weight.shape, int(state.adam.count)) == ((1, 3, 3), 1)
    assert float(loss) > 0.0


def test_rates_are_those_of_the_fastest_run(monkeypatch):
    """The first run of each does not count; a network takes twice the time that NumPy takes for as much."""
    clock, cases = [0.0], {}

    def case(work, *seconds):
        times = iter(seconds)
        return work, lambda: clock.__setitem__(0, clock[0] + next(times))

    monkeypatch.setattr(bench.time, "process_time", lambda: clock[0])
    cases = {"NumPy": case(2e9, 0.1, 2.0, 1.0)} | {name: case(1e9, 0.1, 1.0, 1.5) for name in bench.NETWORKS}
    peer = {"PyTorch, 4 × 128": case(1e9, 0.1, 4.0, 2.0)}
    found = bench.measure(cases | peer, 2)
    assert found["4 × 128"] == pytest.approx(
        {"GFLOP/s": 1.0, "share of NumPy's": 0.5, "PyTorch's share of NumPy's": 0.25}
    )
    assert found["4 × 256"] == pytest.approx({"GFLOP/s": 1.0, "share of NumPy's": 0.5})
    paper = found["the paper's network, all epochs"]
    assert paper["on one core here [h]"] == pytest.approx(paper["operations"] / 1e9 / 3600.0)


def test_the_paper_s_error_is_reached_in_the_first_epoch_below_it(monkeypatch):
    """By the mean over the 39 components of a row; epochs take a second."""
    clock = [0.0]
    monkeypatch.setattr(bench.time, "process_time", lambda: clock[0])
    errors = [39 * 5e-6, 39 * 2.9e-6, 39 * 3.5e-6, 39 * 2e-6]

    def fit(network, seen, unseen, settings, seed, on_epoch):
        assert settings.validate_every == 1
        assert len(seen.y) > len(unseen.y) > 0
        for epoch, error in enumerate(errors, 1):
            clock[0] += 1.0
            on_epoch(epoch, 0.0, error)

    monkeypatch.setattr(bench.loop, "fit", fit)
    found = bench.time_to_error(places.CONFIGS / "aero/datasets/open.nc")
    expected = {"least error [m4]": 2e-6, "all epochs [s]": 4.0, "epochs": 2, "to the paper's error [s]": 2.0}
    assert found == pytest.approx(expected)
    errors[:] = [39 * 5e-6]
    assert set(bench.time_to_error(places.CONFIGS / "aero/datasets/open.nc")) == {"least error [m4]", "all epochs [s]"}


def test_a_network_below_its_stored_share_is_named(monkeypatch, tmp_path, capsys):
    shares = {name: {"share of NumPy's": share} for name, share in zip(bench.NETWORKS, (1.2, 1.0, 0.8), strict=True)}
    slower = shares | {"4 × 256": {"share of NumPy's": 0.89}}
    monkeypatch.setattr(kept, "FOLDER", tmp_path)
    monkeypatch.setattr(bench, "networks", dict)
    monkeypatch.setattr(bench, "peers", dict)
    kept.read.cache_clear()
    for found, words, status in ((shares, ["--store"], 0), (shares, [], 0), (slower, [], 1)):
        monkeypatch.setattr(bench, "measure", lambda *_, found=found: found)
        assert bench.main(words) == status
        assert ("4 × 256: more than a tenth below" in capsys.readouterr().out) == bool(status)
    kept.read.cache_clear()
