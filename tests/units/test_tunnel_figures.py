"""What the typed tables say about the paper's claims."""

import numpy as np
import pytest

from experiments.report import paper
from experiments.report.measures import files
from jax_aero.data import tables as tunnel


@pytest.fixture(scope="module")
def tables():
    return tunnel.read(tunnel.TUNNEL)


@pytest.fixture(scope="module")
def runs():
    return tunnel.read(tunnel.CFD)["run"]


def decide(key):
    measured, verdict = paper.all_claims()[key].decide(None)
    return measured, str(verdict)


def test_speeds_differ_by_less_than_the_paper_says():
    assert decide("speeds") == ("2.7 %", "agrees")
    assert decide("slow_speed") == ("3.8 % from 10° to 60°", "agrees")


def test_k_omega_is_closer_to_the_tunnel(monkeypatch):
    models = (tunnel.OMEGA, tunnel.EPSILON)
    assert [decide(f"drag {model}") for model in models] == [("2.4 %", "agrees"), ("8.8 %", "agrees")]
    assert [decide(f"magnitude {model}")[1] for model in models] == ["agrees", "agrees"]
    monkeypatch.setattr(tunnel, "drag_error", lambda _, run: 0.05 if run["turbulence"] == tunnel.OMEGA else 0.03)
    assert [decide(f"drag {model}")[1] for model in models] == ["differs: +2.0 %", "differs: -2.0 %"]


def test_the_size_of_a_force_is_compared_with_the_tunnel(monkeypatch):
    record = {"posture": "flight30", "alpha_deg": [30, 60], "cda": [0.3, 0.1], "cla": [0.0, 0.2], "csa": [0.4, 0.2]}
    run = {key: [1.1 * area for area in record[key]] for key in ("cda", "cla", "csa")}
    run |= {"posture": "flight30", "mesh": tunnel.FINEST, "alpha_deg": [30, 60]}
    runs = [run | {"turbulence": model} for model in (tunnel.OMEGA, tunnel.EPSILON)]
    monkeypatch.setattr(tunnel, "read", lambda _: {"flight": [record], "run": runs})
    assert files.cfd().cases[""]["size"] == pytest.approx(10.0)


def test_the_magnitude_is_as_near_as_the_paper_says_and_the_lift_alone_is_not(runs):
    names = tunnel.meshes(runs)
    assert names == ["011C", "024C", "050C", "202C", "953C"]
    measured, verdict = decide("meshes")
    assert measured.endswith("953C: 4.6 %, 11.1 %, 5 %, 45 %")
    assert verdict.startswith("agrees; the vector differs by 15.1 % on 202C; the lift alone")


def test_the_effect_of_the_reynolds_number_is_at_high_sideslip():
    assert decide("reynolds_local")[1] == "agrees"


def test_tables_are_whole_and_angles_rise(tables, runs):
    for table in [*tables["hovering"], *tables["flight"], *runs]:
        lengths = {len(values) for values in table.values() if isinstance(values, list)}
        assert len(lengths) == 1, table
        free = "beta_deg" if "alpha_deg" not in table or len(set(table["alpha_deg"])) == 1 else "alpha_deg"
        assert np.all(np.diff(table[free]) > 0)
        assert np.all(np.array(table["cda"]) > 0.1)
