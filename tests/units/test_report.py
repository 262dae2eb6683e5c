"""The report: measures of made-up flights, verdicts from made-up counts, and pages that say the same twice."""

import base64
import io
import json
import re
import shutil
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import xarray as xr
from matplotlib import image
from PIL import Image

from experiments.report import judge, paper
from experiments.report.command import pictures, report
from experiments.report.judge import AGREES, NOT_FLOWN, OUTDATED, Finding, Kind, Verdict
from experiments.report.measures import files
from experiments.report.measures import results as measures
from experiments.report.page import inline, literal, table, to_html
from experiments.report.results import ANOTHER, Flight, Results
from jax_aero import rust
from jax_aero.base import places, plain_values, tables
from jax_aero.base.places import ROBOT
from jax_aero.base.references import file_hash
from jax_aero.cfd.settings import FlowConfig
from jax_aero.cli import main
from jax_aero.data import battery
from jax_aero.results import manifest, record
from jax_aero.results.flight import identity_of
from jax_aero.results.identity import Identity
from jax_aero.stored import outdated
from jax_aero.sweep import run, spec
from jax_aero.sweep.design import Design
from jax_aero.sweep.intervals import wilson
from jax_aero.sweep.result import SweepResult


def cell(index, flights, completed, on_course, rotation=5.0, **labels):
    low, high = wilson(completed, flights)
    return {
        "cell": index,
        **labels,
        "flights": flights,
        "errors": 0,
        "completed": completed,
        "completed_low": low,
        "completed_high": high,
        "on_course": on_course,
        "on_course_low": wilson(on_course, flights)[0],
        "on_course_high": wilson(on_course, flights)[1],
        "rotation_error_deg_median_of_all": rotation,
        "com_error_median_of_all": 0.1,
    }


CODE = Identity("0").facts


def write_sweep(results, name, cells, axes, **document):
    folder = results / "sweeps" / name
    folder.mkdir(parents=True)
    pq.write_table(pa.Table.from_pylist(cells), folder / "cells.parquet")
    base = {
        "name": name,
        "title": f"{name}: made up",
        "description": "Made up.",
        "drawing": "levels",
        "panels": "",
        "axes": [{"name": axis, "label": axis, "unit": "", "levels": []} for axis in axes],
        "git": None,
        "rows": 10,
        "backend": "rust",
        "device": {"cores": 2},
        "finished": {
            "created": "",
            "flights": 10,
            "seconds": 2.0,
            "flights_per_minute": 300.0,
            "outcomes": {"completed": 9, "fell": 0, "off_course": 1, "diverged": 0, "error": 0},
        },
    }
    shipped = spec.load(name)
    facts = run.identity_of(Design(shipped)).facts
    (folder / "sweep.json").write_text(json.dumps(run.describe(shipped) | base | facts | document))


@pytest.fixture(scope="module")
def whole(tmp_path_factory, made_up_results):
    """Made-up flights whose manifests say what today's configurations are, and two sweeps."""
    folder = tmp_path_factory.mktemp("whole")
    for path in shutil.copytree(made_up_results / "flight", folder / "flight").glob("*/manifest.json"):
        document = json.loads(path.read_text())
        with xr.open_dataset(path.with_name("run.nc"), engine="h5netcdf") as run:
            document |= {key: run.attrs[key] for key in ("outcome", "lost_reason", "title")}
            thrust, distance = run["thrust"], np.linalg.norm(run["com_position"] - run["com_setpoint"], axis=1)
            document["summary"] = {
                "max_rotation_error": float(run["rotation_error"].max()),
                "max_com_error": float(distance[run["time"] >= 3.0].max()),
                "thrust_min": float(thrust.min()),
                "thrust_max": float(thrust.max()),
            }
            document["lost_time"] = float(run.attrs["lost_time"]) if document["outcome"] == "fell" else None
        config = rust.load_config(path.parent.name)
        path.write_text(json.dumps(document | {"config": manifest.make_portable(config)}))
    tests = [("TEST1, corrected arms", 250), ("TEST2, corrected arms", 250), ("TEST1, published arms", 0)]
    tests += [("TEST2, published arms", 249), ("TEST3, corrected arms", 250), ("TEST3, published arms", 3)]
    tests += [("TEST4, corrected arms", 250), ("TEST4, published arms", 248), ("robustness, corrected arms", 250)]
    tests += [("robustness, published arms", 120)]
    cells = [cell(i, 250, n, n // 2, test=label) for i, (label, n) in enumerate(tests)]
    write_sweep(folder, "paper_tests", cells, ["test"])
    names = [label.removesuffix(", corrected arms") for label, _ in tests]
    finer = [{"flight": name, "substeps": 1.0, "flights": 40, "completed": 38, "lost": 2} for name in names]
    write_sweep(folder, "convergence", finer, ["flight", "substeps"], panels="substeps")
    terms = []
    for world in (measures.RIGHT, measures.HEAD, measures.PUBLISHED):
        for feedback, completes, stays in (
            ("everything", 24, 24),
            ("total wrench only", 24, 24),
            ("total moment only", 24 if world == measures.RIGHT else 2, 0),
            ("total force only", 2, 0),
            ("without Λ_a", 24, 24),
        ):
            terms.append(cell(len(terms), 24, completes, stays, world=world, feedback=feedback))
    write_sweep(folder, "ablation_terms", terms, ["world", "feedback"], panels="world")
    return folder


@pytest.fixture
def results(tmp_path, whole) -> Results:
    return Results(shutil.copytree(whole, tmp_path, dirs_exist_ok=True))


@pytest.mark.slow
def test_a_claim_has_the_commit_of_the_last_result_that_it_was_measured_on(results, tmp_path):
    for name, day, commit in (("test2", 1, "a" * 40), ("test4", 2, "b" * 40), ("test1", 3, "c" * 40)):
        made = {"created": f"2026-01-0{day}T00:00:00+00:00", "git": {"commit": commit, "dirty": False}}
        change_manifest(tmp_path / "flight" / name / "manifest.json", **made)
    found = find(Results(tmp_path))
    assert [found[key].commit for key in ("aligned", "thrusts_alike", "mass")] == ["a" * 40, "b" * 40, None]
    kept = json.loads(judge.to_json(found, tmp_path / "none.json"))["claims"]
    assert kept["thrusts_alike"]["commit"] == "b" * 40
    assert kept["mass"]["commit"] not in ("a" * 40, "b" * 40, "c" * 40)


def change_manifest(path, **entries):
    """Change entries of a JSON document."""
    path.write_text(json.dumps(json.loads(path.read_text()) | entries))


def find(results):
    return {key: claim.find(results) for key, claim in paper.all_claims().items()}


@pytest.mark.slow
def test_a_flight_of_another_configuration_is_named_in_its_row_and_in_the_claims_that_rest_on_it(results):
    config = rust.load_config("test2", {"wind.velocity": [0.0, 5.0, 0.0], "simulator.duration": 9.0})
    entries = {"config_digest": rust.config_digest(config), "config": manifest.make_portable(config)}
    change_manifest(results.folder / "flight" / "test2" / "manifest.json", **entries)
    said = f"{ANOTHER}: test2 (`simulator.duration`, `wind.velocity`)"
    assert find(results)["aligned"] == Finding(said, OUTDATED)
    results = Results(results.folder, stale=True)
    found = find(results)
    assert found["aligned"].verdict == Verdict(Kind.OUTDATED, "outdated: differs: it does not hold")
    assert found["aligned"].measured.endswith(f"; {said}")
    assert found["test2"].verdict == Verdict(Kind.OUTDATED, "outdated: agrees")
    assert found["test1"].verdict.kind is Kind.IN_PART
    text = report(results, found)
    assert f"test2: made up **M{ANOTHER[1:]}: `simulator.duration`, `wind.velocity`.** |" in text
    assert "test1: made up |" in text
    assert "** outdated" in text


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["flight/test2/manifest.json", "sweeps/paper_tests/sweep.json"])
def test_a_result_of_other_numerics_is_refused(results, kind, tmp_path, capsys):
    """The judge of the judges: nothing that it says counts, and the page and the exit status say so."""
    change_manifest(results.folder / kind, numerics={"crate": 0}, git={"commit": "a" * 40})
    name = "sweep paper_tests" if kind.startswith("sweeps") else "test2"
    differs = f"other numerics (crate 0 instead of {rust.NUMERICS}, commit aaaaaaaaaa)"
    assert find(results)["test2"] == Finding(f"{ANOTHER}: {name} ({differs})", OUTDATED)
    words = ["report", "--results", str(results.folder), "--claims", str(tmp_path / "claims.json")]
    assert main(words) == 1
    assert f"refused: {name} is {ANOTHER} (other numerics" in capsys.readouterr().err
    text = (results.folder / "report.md").read_text()
    assert f"| {name} | {differs} |" in text
    assert main([*words, "--stale"]) == 0
    assert f"**M{ANOTHER[1:]}: {differs}.**" in (results.folder / "report.md").read_text()


def test_a_flight_of_another_file_that_it_names_is_outdated(results):
    change_manifest(results.folder / "flight" / "test4" / "manifest.json", config_digest="0" * 64)
    assert results.differences["test4"] == "a file that it names"
    assert outdated.flight("no_shipped_name", identity_of(rust.load_config("test1")).facts) == ""


@pytest.mark.slow
def test_a_sweep_of_another_configuration_is_named_in_its_claims(results):
    assert ANOTHER[1:] not in report(results, {})
    for name in ("paper_tests", "ablation_terms"):
        change_manifest(results.folder / "sweeps" / name / "sweep.json", config_digest="0" * 64)
    found = Results(results.folder, stale=True)
    claim = find(found)["test2"]
    assert claim.verdict == Verdict(Kind.OUTDATED, "outdated: agrees")
    assert f"{ANOTHER}: sweep paper_tests (`axes`, " in claim.measured
    assert report(found, {}).count(ANOTHER[1:]) == 2, "with each sweep"


def test_what_differs_of_a_sweep_is_named():
    shipped = spec.load("paper_tests")
    document = run.describe(shipped) | {"config_digest": "0" * 64}
    folder = places.RESULTS / "sweeps" / "paper_tests"
    assert outdated.sweep(folder, document) == "the flights of its cells, or a file that they name"
    assert outdated.sweep(folder, document | {"repeats": 7, "seed": 9}) == "`repeats`, `seed`"
    assert outdated.sweep(folder, run.identity_of(Design(shipped)).facts) == ""


def test_a_study_of_another_flight_or_file_is_outdated():
    flight = manifest.make_portable(rust.load_config("test2"))
    file = "configs/perturbation/flight.toml"
    sources = {
        "flights": {"test2": rust.config_digest(rust.load_config("test2"))},
        "configurations": {"test2": flight},
        "files": {file: file_hash(places.HOME / file)},
    }
    document = {"config": {}, "sources": sources, **CODE}
    assert outdated.study("made_up", "own", document) == ""
    sources |= {"flights": {"test2": "0"}, "files": {file: "0"}}
    flight["simulator"]["duration"] = 1.0
    assert outdated.study("made_up", "own", document) == f"test2: `simulator.duration`; {file}"
    assert outdated.study("training", "compact", {"numerics": {"gone": 1}}) == "other numerics (gone 1 instead of None)"


def test_a_study_of_another_file_of_its_name_is_outdated():
    config = manifest.make_portable(
        plain_values.to_builtins(tables.load(places.find("cfd_flow", "flight30"), FlowConfig))
    )
    document = {"config": config, "sources": {"flights": {}, "files": {}}, **CODE}
    assert outdated.study("cfd_flow", "flight30", document) == ""
    config["settings"]["air"]["speed"] = 10.0
    assert outdated.study("cfd_flow", "flight30", document) == "`settings.air.speed`"


def test_a_sweep_under_way_is_not_there_yet(tmp_path):
    folder = tmp_path / "sweeps" / "made"
    folder.mkdir(parents=True)
    pq.write_table(pa.table({"cell": [0]}), folder / "cells.parquet")
    (folder / "sweep.json").write_text(json.dumps({"config_digest": "0"}))
    assert Results(tmp_path).sweeps == {}


def test_a_sweep_with_flights_that_could_not_be_flown_decides_no_claim(results):
    """Their cell would say that all flights of it complete: none of none."""
    path = results.folder / "sweeps" / "paper_tests" / "sweep.json"
    document = json.loads(path.read_text())
    document["finished"]["outcomes"]["error"] = 2
    path.write_text(json.dumps(document))
    stated = [claim for claim in find(Results(results.folder)).values() if "sweep paper_tests" in claim.measured]
    assert stated
    for claim in stated:
        assert claim.verdict == NOT_FLOWN
        assert claim.measured == "2 flights of `jax-aero sweep paper_tests` could not be flown"


@pytest.mark.slow
def test_a_judge_that_fails_is_an_error_and_keeps_no_older_verdict(results, tmp_path, capsys):
    """As on a sweep that was flown before a level was renamed."""
    for name in ("paper_tests", "ablation_terms"):
        path = results.folder / "sweeps" / name / "cells.parquet"
        pq.write_table(pq.read_table(path).slice(0, 1), path)
    found = Results(results.folder)
    claim = find(found)["test2"]
    assert claim.verdict == Verdict(Kind.ERROR, "error: KeyError: 'test = TEST2, corrected arms'")
    kept = tmp_path / "claims.json"
    kept.write_text(judge.to_json({"test2": Finding("all of it", AGREES)}, kept))
    assert main(["report", "--results", str(results.folder), "--claims", str(kept)]) == 1
    assert "test2: error: KeyError" in capsys.readouterr().err
    assert judge.read(kept)["test2"].verdict == claim.verdict


def test_a_cell_is_the_only_one_with_its_levels():
    sweep = SweepResult(
        "s", {}, pd.DataFrame([cell(i, 8, 8, 8, world="ahead", scale=scale) for i, scale in enumerate((1.0, 2.0))])
    )
    assert sweep.cell(scale=2.0) == sweep.rows[1]
    with pytest.raises(KeyError, match=r"world = side, scale = 1\.0"):
        sweep.cell(world="side", scale=1.0)
    with pytest.raises(ValueError, match="too many values"):
        sweep.cell(world="ahead")


def test_measures_of_a_flight_are_those_of_its_log(results, make_flight, agree):
    found, log = results.flights["test2"], make_flight().log
    settled = log["time"] >= 3.0
    assert found.ending == "completed"
    groups, is_late = found.run["joint_group"].values, log["time"] >= log["time"][-1] - 3.0
    assert {*found.joint_errors} == {str(group).replace("_", " ") for group in groups}
    for part, most_and_end in found.joint_errors.items():
        own = groups == part.replace(" ", "_")
        errors = np.degrees(np.abs(log["joint_position"] - 0.2)[:, own].sum(axis=1))
        agree("joint error", most_and_end, (errors.max(), errors[is_late].mean()), 1e-12)
    agree("thrust asymmetry", found.asymmetry[0], np.abs(log["thrust"][settled] @ [1, -1, 0, 0]).max(), 1e-12)
    early, apart = found.is_windy & (log["time"] < 35.0), found.forces_apart
    simulated = np.linalg.norm(log["aero_force_sim"].sum(axis=1), axis=1)
    agree("force difference", apart["early"], 0.2 * simulated[early].mean(), 1e-12)
    assert apart["signs"] == 100.0
    assert results.flights["test1_published"].ending == "fell at 21.5 s (rotation error above 90 deg)"


def test_a_force_along_the_wind_has_no_angle(make_flight, robot, tmp_path, measured):
    flight = make_flight()
    for wind, force in ((1.0, 1.0), (0.0, 1.0)):
        flight.log["aero_force_sim"][:] = force * flight.log["wind"][:, None, :]
        flight.log["wind"][:] *= wind
        found = Flight(tmp_path, {})
        found.__dict__["run"] = record.to_dataset(flight, robot, title="t", config_digest="0")
        if wind:
            measured("angle of the force", np.abs(found.force_angle).max(), 1e-5)
        else:
            assert np.isnan(found.force_angle).all()


def test_verdicts_follow_from_counts(results):
    found = find(results)
    kinds = {key: found[key].verdict.kind for key in ("test1", "test2", "test3", "test4", "robustness", "lambda")}
    in_part = dict.fromkeys(("test1", "test3", "robustness"), Kind.IN_PART)
    assert kinds == dict.fromkeys(kinds, Kind.AGREES) | in_part
    assert found["test1"].verdict.text.startswith("agrees with published lever arms")
    assert found["test3"].verdict.text.startswith("agrees with published lever arms")
    assert found["robustness"].verdict.text.startswith("agrees with corrected lever arms")


def test_what_has_not_been_flown_names_its_command(tmp_path):
    for claim in find(Results(tmp_path)).values():
        if claim.verdict == NOT_FLOWN:
            assert "`jax-aero " in claim.measured


def test_the_minimum_is_what_stays_on_course_everywhere(results):
    answer = find(results)["minimum"].measured
    assert "in every world: **total wrench only**" in answer
    assert "As good in completing: everything, total wrench only, without Λ_a." in answer


def test_a_figure_of_other_runs_is_shown_with_their_name(tmp_path):
    (tmp_path / "figures").mkdir()
    for name in ("fig4_fit--open", "fig5", "fig5--half_test2", "fig5a"):
        (tmp_path / "figures" / f"{name}.png").touch()
    shown = pictures(Results(tmp_path), [("fig4_fit", "The fit"), ("fig5", "One mission"), ("fig6", "None")])
    assert shown == [
        ("figures/fig4_fit--open.png", "The fit (`open`)"),
        ("figures/fig5.png", "One mission"),
        ("figures/fig5--half_test2.png", "One mission (`half_test2`)"),
    ]


# --- pages


@pytest.fixture
def picture(tmp_path):
    (tmp_path / "figures").mkdir()
    image.imsave(tmp_path / "figures/a.png", np.eye(4))
    return "![what it shows](figures/a.png)"


def test_html_shows_what_markdown_says(picture, tmp_path):
    rows = [("1", "x|y"), ("`a<b`", "**differs: 3**"), ("", "**agrees, but**"), ("", "**agrees**")]
    text = "[shown](figures/a.png), [elsewhere](figures/b.png)"
    page = f"# Title & more\n\n## Part one\n\n{text}\n\n{table(rows, 'a', 'b')}"
    html = to_html(f"{page}\n\n{picture}\n", tmp_path)
    assert "| 1 | x\\|y |\n| `a<b` | **differs: 3** |" in page
    assert '<td data-of="b">x|y</td>' in html
    assert "<code>a&lt;b</code>" in html
    assert [f'<strong class="{tone}">' in html for tone in ("bad", "open", "good")] == [True] * 3
    assert "<title>Title &amp;amp; more</title>" not in html
    assert '<a href="#part-one">Part one</a>' in html
    assert '<h2 id="part-one">' in html
    assert '<p><a href="#figures-a-png">shown</a>, elsewhere</p>' in html
    embedded = re.search(r'<img src="data:image/webp;base64,(\S+)" alt="what it shows" id="figures-a-png"', html)
    with Image.open(io.BytesIO(base64.b64decode(embedded[1]))) as kept, Image.open(tmp_path / "figures/a.png") as drawn:
        assert np.array_equal(np.array(kept.convert("RGB")), np.array(drawn.convert("RGB")))


@pytest.mark.parametrize(
    "text",
    [
        "<img src=x onerror=run()>",
        "a `<b>` <img src=x onerror=run()>",
        "``<img src=x onerror=run()>`",
        "\\`<img src=x onerror=run()>`",
        "`a\n\n<img src=x onerror=run()>`",
        "[a](javascript:run())",
        "[a]( javascript:run())",
        "![a](//elsewhere/x) [b](\\\\elsewhere/x) [c](https://elsewhere)",
    ],
)
def test_a_text_of_a_file_is_a_text(text, tmp_path):
    page = f"# {inline(text)}\n\n## {inline(text)}\n\n{inline(text)}\n\n{table([[text]], text)}"
    html = to_html(page, tmp_path)
    assert "<img" not in re.sub(r"(?<![`\\])`[^`\n]+`(?!`)", "", page) + html
    assert not re.search(r"\]\(\s*(javascript|https|/|\\)", page)
    assert not re.search(r'(href|src)="?\s*(javascript|https|/|\\)', html)


def test_a_title_of_a_stranger_is_shown_as_it_stands(tmp_path):
    title = "![a](b.png) [c](d.md) **e** `f` <img> | \\ ~~g~~ &lt;\n# h"
    page = f"# t\n\nsee {inline(literal(title))}\n\n{table([[literal(title)]], 'of')}"
    assert not re.search(r"[`*\[\]<>~\\]|^# h", page.replace("|---|", ""), re.M)
    shown = ElementTree.fromstring(re.search("<p>.*</p>", to_html(page, tmp_path))[0])
    assert "".join(shown.itertext()) == f"see {' '.join(title.split())}"


def test_the_report_is_written_from_what_there_is(results, capsys):
    assert main(["report", "--results", str(results.folder)]) == 0
    text = (results.folder / "report.md").read_text()
    tables = [line for line in text.splitlines() if line.startswith("|---|")]
    assert (results.folder / "report.html").read_text().count("<table>") == len(tables) == 5
    for word in (
        "## Claims",
        "## The paper's runs",
        "## Runs of our own",
        "### ablation_terms: made up",
        "10 flights: 9 completed, 0 fell, 1 off course.",
        "TEST3",
        "26.31",
    ):
        assert word in text
    assert str(results.folder) not in text
    assert report(Results(results.folder / "nowhere"), {}).startswith("# What flies, and why")


# --- facts from committed files


@pytest.mark.parametrize("place", ["flight/test1/run.nc", "sweeps/paper_tests/cells.parquet"])
def test_a_damaged_result_is_named(results, place, capsys):
    path = results.folder / place
    is_sweep = path.suffix == ".parquet"
    described = path.with_name("sweep.json" if is_sweep else "manifest.json")
    document = json.loads(described.read_text())
    (document["finished"] if is_sweep else document)["files"] = {path.name: "the checksum of another"}
    described.write_text(json.dumps(document))
    assert main(["report", "--results", str(results.folder)]) == 2
    assert f"error: {path} is not what was written there; --overwrite flies it again" in capsys.readouterr().err


def test_a_folder_without_results_is_not_made(tmp_path, capsys):
    assert main(["report", "--results", str(tmp_path / "typo")]) == 2
    assert f"error: `{tmp_path / 'typo'}` is no folder" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_file_of_something_else_is_not_replaced_by_claims(tmp_path, capsys):
    (tmp_path / "claims.json").write_text('{"mine": 1}')
    assert main(["report", "--results", str(tmp_path)]) == 2
    assert f"error: {tmp_path / 'claims.json'} is damaged: " in capsys.readouterr().err
    assert (tmp_path / "claims.json").read_text() == '{"mine": 1}'


def test_what_an_ended_process_left_is_no_flight(results):
    (results.folder / "flight" / "test1").rename(results.folder / "flight" / ".test1.draft")
    assert not any(name.startswith(".") for name in results.flights)


def test_what_is_not_flown_here_or_outdated_stays_as_it_was_kept(tmp_path):
    kept = tmp_path / "claims.json"
    kept.write_text(judge.to_json({"k": Finding("12 m", AGREES, "first")}, kept))
    absent = Finding("has not been run", NOT_FLOWN)

    def stored(finding, path=kept):
        path.write_text(judge.to_json({"k": finding}, kept))
        return judge.read(path)["k"]

    first = stored(absent)
    assert first == Finding("12 m", AGREES, "first")
    assert stored(Finding("13 m", Verdict(Kind.OUTDATED, "outdated: agrees"), "second")) == first
    assert stored(Finding("12 m", AGREES, "second")) == first
    assert stored(Finding("13 m", AGREES, "second")) == Finding("13 m", AGREES, "second")
    assert (
        json.loads(judge.to_json({"k": absent}, tmp_path / "none"))["claims"]["k"]["verdict"]["text"]
        == "not flown here"
    )


def test_the_index_needs_a_checkout(monkeypatch, capsys):
    monkeypatch.setattr(places, "IS_CHECKOUT", False)
    assert main(["report", "--index"]) == 2
    assert capsys.readouterr().err.startswith("error: this needs a checkout of the repository, ")


def test_an_engine_rests_where_its_thrust_does_not_accelerate(measured):
    engine = files.robot()["engines"]["P220"]
    thrust, v = files.steady_thrust(engine, 70.0), 70.0 * (1.0 + engine["b_uu"] * 70.0)
    drift = engine["k_t"] * thrust + engine["k_tt"] * thrust**2 + engine["c"]
    pull = (engine["b_u"] + engine["b_t"] * thrust) * v
    # Terms of some 3e2 N/s² cancel: a few last bits of them.
    measured("acceleration", abs(drift + pull), 1e-11)
    assert np.isnan(files.steady_thrust(engine | {"c": -1e6}, 70.0))


def test_the_silhouette_is_at_least_that_of_one_attitude():
    links = files.robot()["aero_links"]
    across = sum(link["diameter"] * link["length"] for link in links if not link.get("is_sphere"))
    assert across < files.silhouette() < 1.3 * across


def test_the_arm_jet_sits_beside_its_elbow(agree):
    """By the fixed joint of the URDF: where the jet sits on the body of the elbow, and its z axis."""
    origin = next(
        joint.find("origin")
        for joint in ElementTree.parse(ROBOT.with_suffix(".urdf")).iter("joint")
        if joint.find("child").get("link") == "l_arm_jet_turbine"
    )
    place, (roll, pitch, yaw) = (np.array(origin.get(key).split(), dtype=float) for key in ("xyz", "rpy"))
    (cr, cp, cy), (sr, sp, sy) = np.cos([roll, pitch, yaw]), np.sin([roll, pitch, yaw])
    axis = np.array([cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr])
    agree("offset", files.forearm_offset(), np.linalg.norm(np.cross(place, axis)), 1e-9)


# --- battery against fuel


@pytest.mark.close_to_tolerance("the expected figure is typed to the digits that the tolerance allows")
def test_the_papers_fuel_and_battery_come_out(measured):
    choice = battery.Choice()
    assert round(choice.fuel(), 2) == battery.PAPER_FUEL
    measured("battery", abs(choice.battery(1.0) - battery.PAPER_BATTERY), 0.01)
    assert round(choice.battery(), 2) == 20.97


def test_a_battery_hovers_itself_as_well(agree):
    choice = battery.Choice()
    mass = choice.battery()
    energy = 1e3 * choice.fan_power / choice.fan_thrust * (choice.robot_mass + mass) * choice.minutes / 60.0
    agree("energy", energy, mass * choice.specific_energy, 1e-12)
    # A mass for 14 minutes and a half would weigh as much as it can lift, alone.
    assert battery.Choice(minutes=14.6).battery() == float("inf")


def test_fuel_is_burnt_by_what_is_left_of_it(agree):
    choice = battery.Choice()
    mass, steps = choice.robot_mass + choice.fuel(), 100_000
    rate = choice.jet_consumption * choice.fuel_density / choice.jet_thrust
    for _ in range(steps):
        mass -= rate * mass * choice.minutes / steps
    agree("mass", mass, choice.robot_mass, 1e-5)
