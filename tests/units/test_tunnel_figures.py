"""What the typed tables say about the paper's claims, and the figures drawn from them alone."""

import numpy as np
import pytest

from paper_figs import tunnel
from paper_figs.command import main


@pytest.fixture(scope="module")
def tables():
    return tunnel.read(tunnel.TUNNEL)


@pytest.fixture(scope="module")
def runs():
    return tunnel.read(tunnel.CFD)["run"]


def values(claims):
    return [round(100.0 * claim.value, 1) for claim in claims]


def test_speeds_differ_by_less_than_the_paper_says_only_without_the_slow_one(tables):
    assert values(tunnel.speed_claims(tables)) == [3.1, 8.7]


def test_postures_differ_by_almost_twenty_per_cent_at_small_angles_only(tables):
    assert values(tunnel.posture_claims(tables))[:2] == [18.1, 8.6]


def test_k_omega_is_closer_to_the_tunnel(tables, runs):
    omega, omega_size, epsilon, epsilon_size = values(tunnel.turbulence_claims(tables, runs))
    assert (omega, epsilon) == (2.4, 8.8)
    assert omega_size < epsilon_size < 10.0


def test_no_mesh_is_further_off_than_the_paper_says(tables, runs):
    claims = tunnel.mesh_claims(tables, runs)
    assert tunnel.meshes(runs) == ["011C", "024C", "050C", "202C", "953C"]
    assert max(values(claims)) == 6.4


def test_tables_are_whole_and_angles_rise(tables, runs):
    for table in [*tables["hovering"], *tables["flight"], *runs]:
        lengths = {len(values) for values in table.values() if isinstance(values, list)}
        assert len(lengths) == 1, table
        free = "beta_deg" if "alpha_deg" not in table or len(set(table["alpha_deg"])) == 1 else "alpha_deg"
        assert np.all(np.diff(table[free]) > 0)
        assert np.all(np.array(table["cda"]) > 0.1)


def test_figures_print_what_they_show_beside_the_paper(tmp_path, capsys):
    assert main(["fig2", "fig3", "supp_mesh", "--results", str(tmp_path), "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "3.1 %   paper: below 5 %" in printed
    assert "8.8 %   paper: k-ω better" in printed
    assert {path.name for path in tmp_path.iterdir()} == {
        f"{name}.{kind}" for name in ("fig2", "fig3", "supp_mesh") for kind in ("pdf", "png")
    }
