"""What the typed tables say about the paper's claims."""

import numpy as np
import pytest

from experiments.report.findings import AGREES, differs
from experiments.report.judges import tunnel as claims
from paper_figs import tunnel


@pytest.fixture(scope="module")
def tables():
    return tunnel.read(tunnel.TUNNEL)


@pytest.fixture(scope="module")
def runs():
    return tunnel.read(tunnel.CFD)["run"]


def test_speeds_differ_by_less_than_the_paper_says_only_without_the_slow_one():
    assert claims.speeds(slow=False) == ("3.1 %", AGREES)
    assert claims.speeds(slow=True) == ("8.7 %", differs("+3.7 %"))


def test_postures_differ_by_almost_twenty_per_cent_at_small_angles_only():
    assert claims.postures(25) == ("18.1 %", AGREES)
    assert claims.postures(60) == ("8.6 %", differs("-6.4 %"))


def test_k_omega_is_closer_to_the_tunnel(monkeypatch):
    assert [claims.drag_errors(model) for model in claims.MODELS] == [("2.4 %", AGREES), ("8.8 %", AGREES)]
    assert [claims.size_errors(model)[1] for model in claims.MODELS] == [AGREES, AGREES]
    monkeypatch.setattr(tunnel, "drag_error", lambda _, run: 0.05 if run["turbulence"] == tunnel.OMEGA else 0.03)
    assert [claims.drag_errors(model)[1] for model in claims.MODELS] == [differs("+2.0 %"), differs("-2.0 %")]


def test_no_mesh_is_further_off_than_the_paper_says(runs):
    names = tunnel.meshes(runs)
    assert names == ["011C", "024C", "050C", "202C", "953C"]
    assert {claims.mesh_errors(name)[1] for name in names} == {AGREES}
    assert max(claims.mesh_errors(name)[0] for name in names) == "6.4 %"


def test_tables_are_whole_and_angles_rise(tables, runs):
    for table in [*tables["hovering"], *tables["flight"], *runs]:
        lengths = {len(values) for values in table.values() if isinstance(values, list)}
        assert len(lengths) == 1, table
        free = "beta_deg" if "alpha_deg" not in table or len(set(table["alpha_deg"])) == 1 else "alpha_deg"
        assert np.all(np.diff(table[free]) > 0)
        assert np.all(np.array(table["cda"]) > 0.1)
