"""Figures of sweeps, from made-up cells: every drawing, and a word about every one that is missing."""

import itertools
import json
from typing import get_args

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from jax_aero.base.documents import Drawing
from jax_aero.commands.figures import main
from jax_aero.figures import ablation, front, maps, pairs
from jax_aero.figures.ablation import _is_geometric
from jax_aero.figures.catalogue import SWEEPS
from jax_aero.figures.drawings import DRAWINGS
from jax_aero.figures.scatter import correlations
from jax_aero.figures.sweeps import axis_label, load
from jax_aero.results.identity import Identity
from jax_aero.sweep.result import SweepResult

AXES = {
    "world": {"name": "world", "label": "world", "unit": "", "levels": ["side", "ahead"]},
    "scale": {"name": "scale", "label": "factor", "unit": "", "levels": [0.0, 1.0, 2.0]},
    "speed": {"name": "speed", "label": "wind speed", "unit": "m/s", "levels": [5.0, 10.0]},
    "fault": {"name": "fault", "label": "fault", "unit": "", "levels": ["none", "wind", "joints"]},
    "fault_2": {"name": "fault_2", "label": "fault", "unit": "", "levels": ["none", "wind", "joints"]},
    "mission": {"name": "mission", "label": "mission", "unit": "", "levels": ["upright, 14 s", "upright, 11 s"]},
    "terms": {"name": "terms", "label": "feedback", "unit": "", "levels": ["everything", "nothing"]},
}


def write(folder, name, drawing, axes, panels="world"):
    """A finished sweep with these axes."""
    cells = []
    for index, labels in enumerate(itertools.product(*(AXES[axis]["levels"] for axis in axes))):
        record = {"cell": index, **dict(zip(axes, labels, strict=True)), "flights": 8, "errors": 0}
        for share in ("completed", "upright"):
            record |= {share: index % 9, f"{share}_low": 0.1, f"{share}_high": 0.9}
        record |= {"landed": index % 4, "off_course": index % 2, "fell": index % 3, "lost": index % 3}
        record |= dict.fromkeys(("landing", "crashed", "diverged", "unwarned"), 0)
        for quantity in ("rotation_error_deg", "com_error"):
            record |= {
                f"{quantity}_{end}_of_upright": float(index + step) for step, end in enumerate(("p10", "median", "p90"))
            }
            record[f"{quantity}_worst_of_upright"] = None if index == 1 else 3.0 * index
        cells.append(record)
    rng = np.random.default_rng(1)
    flights = {axis: rng.uniform(0, 1, 40) for axis in axes}
    flights |= {"outcome": ["completed", "fell"] * 20, "max_rotation_error_deg": rng.uniform(0, 90, 40)}
    flights["max_com_error"] = 0.02 * flights["max_rotation_error_deg"]
    document = {
        "title": f"{name}?",
        "drawing": drawing,
        "panels": panels,
        "axes": [AXES[axis] for axis in axes],
        "repeats": 8,
        "perturbation": {"joint_position": 0.1},
        **Identity("ab" * 32).facts,
    }
    path = folder / name
    path.mkdir(parents=True)
    pd.DataFrame(cells).to_parquet(path / "cells.parquet")
    pd.DataFrame(flights).to_parquet(path / "table.parquet")
    (path / "sweep.json").write_text(json.dumps(document))


def draw(folder, *words, name="made_up"):
    """The exit status of drawing a sweep of `folder/sweeps` into the folder."""
    return main([name, "--results", str(folder), "--out", str(folder), *words])


def test_a_sweep_of_other_numerics_is_refused_or_drawn_and_marked(tmp_path, capsys):
    write(tmp_path / "sweeps", "made_up", "levels", ["terms"], "")
    path = tmp_path / "sweeps" / "made_up" / "sweep.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"numerics": {"crate": 0}}))
    assert draw(tmp_path) == 1
    assert "made of another configuration or numerics than today's: made_up (other numerics" in capsys.readouterr().err
    assert draw(tmp_path, "--stale") == 0
    marked = (tmp_path / "made_up.png").read_bytes()
    write(tmp_path / "today" / "sweeps", "made_up", "levels", ["terms"], "")
    assert draw(tmp_path / "today") == 0
    assert (tmp_path / "today" / "made_up.png").read_bytes() != marked


@pytest.mark.parametrize(
    ("drawing", "axes", "panels"),
    [
        ("levels", ["world", "terms"], "world"),
        ("levels", ["terms"], ""),
        ("curve", ["world", "scale"], "world"),
        ("curve", ["world", "terms", "scale"], "world"),
        ("map", ["world", "scale", "speed"], "world"),
        ("map", ["scale", "speed"], ""),
        ("scatter", ["scale", "speed"], ""),
        ("pairs", ["fault", "fault_2", "world"], "world"),
        ("pairs", ["fault", "fault_2"], ""),
        ("front", ["mission", "world", "speed"], "world"),
    ],
)
def test_every_drawing_gives_pdf_and_png_with_the_hash_of_its_sweep(drawing, axes, panels, tmp_path):
    write(tmp_path / "sweeps", "made_up", drawing, axes, panels)
    assert draw(tmp_path) == 0
    assert (tmp_path / "made_up.pdf").read_bytes().startswith(b"%PDF")
    with Image.open(tmp_path / "made_up.png") as picture:
        assert picture.width > 1000
        assert picture.info["Description"] == f"sweep made_up config {'ab' * 32}"


@pytest.mark.parametrize(
    ("drawing", "axes", "panels", "expected"),
    [
        ("map", ["world", "scale"], "", "expected two axes of numbers beside the panels"),
        ("map", ["world", "terms", "scale", "speed"], "world", "expected two axes of numbers"),
        ("scatter", ["world", "scale"], "", "expected axes of numbers"),
        ("scatter", ["world"], "world", "expected axes of numbers"),
        ("matrix", ["world", "scale"], "", "expected axes `arms`, of two levels, `model` and `world`"),
        ("pairs", ["world", "terms"], "", "expected the axes of pairs beside at most two panels"),
        ("pairs", ["fault", "fault_2", "scale"], "scale", "expected the axes of pairs beside at most two panels"),
        ("front", ["terms", "world"], "world", "expected missions such as `upright, 14 s`, and panels"),
        ("curve", ["world"], "world", "expected an axis beside the panels"),
        ("curve", ["mission", "world", "terms", "speed", "scale"], "", "expected at most 13 combinations"),
    ],
)
def test_a_drawing_that_does_not_suit_the_axes_is_one_line(drawing, axes, panels, expected, tmp_path, capsys):
    write(tmp_path / "sweeps", "made_up", drawing, axes, panels)
    assert draw(tmp_path) == 1
    assert f'error: made_up: `drawing` is "{drawing}" of the axes {", ".join(axes)}' in (
        said := capsys.readouterr().err
    )
    assert expected in said


def test_paired_differences_are_drawn_for_an_axis_of_levels(tmp_path, capsys):
    write(tmp_path / "sweeps", "made_up", "levels", ["world"], "")
    path = tmp_path / "sweeps/made_up/table.parquet"
    flights = pd.read_parquet(path)
    flights.assign(world=np.tile(["side", "ahead"], 20), repeat=np.repeat(np.arange(20), 2)).to_parquet(path)
    assert draw(tmp_path, "--paired", "world") == 0
    assert (tmp_path / "made_up--paired_world.png").is_file()
    assert draw(tmp_path, "--paired", "wind") == 1
    assert "--paired is wind; expected an axis with two levels or more, of world" in capsys.readouterr().err


def test_a_damaged_sweep_is_one_line(tmp_path, capsys):
    write(tmp_path / "sweeps", "made_up", "curve", ["scale"], "")
    path = tmp_path / "sweeps" / "made_up" / "cells.parquet"
    path.write_bytes(path.read_bytes()[:-9])
    assert draw(tmp_path) == 1
    assert "cells.parquet is damaged (" in capsys.readouterr().err


@pytest.mark.parametrize(("drawing", "panels"), [("levels", "price"), ("map", "price")])
def test_a_dollar_in_a_sweeps_texts_is_one(drawing, panels, tmp_path, monkeypatch):
    price = {"name": "price", "label": r"5 $\x$ or more", "unit": "$", "levels": [r"5 $\x$", "from $6_ to $7^"]}
    monkeypatch.setitem(AXES, "price", price)
    axes = ["price", "scale", "speed"] if drawing == "map" else ["terms", "price"]
    write(tmp_path / "sweeps", r"$\x$", drawing, axes, panels)
    assert draw(tmp_path, name=r"$\x$") == 0


def test_a_sweep_that_a_figure_hides_is_named(tmp_path, capsys):
    write(tmp_path / "sweeps", "fig3", "levels", ["terms"], "")
    assert draw(tmp_path, name="fig3") == 1
    said = capsys.readouterr()
    assert "fig3.png" in said.out
    assert said.err == "error: the sweep fig3 is not drawn, since a figure has its name; give it another\n"


def test_a_map_keeps_the_row_of_a_level_without_any_number(tmp_path):
    write(tmp_path, "made_up", "map", ["world", "scale", "speed"])
    cells = pd.read_parquet(tmp_path / "made_up/cells.parquet")
    cells.loc[(cells["world"] == "ahead") & (cells["scale"] == 0.0), "com_error_worst_of_upright"] = (
        np.nan
    )  # lost at once
    cells.to_parquet(tmp_path / "made_up/cells.parquet")
    figure = maps.draw(load(tmp_path, "made_up"))
    panels = [axes for axes in figure.axes if axes.get_images()]
    assert len(panels) == 6
    assert [axes.get_images()[0].get_array().shape for axes in panels] == 6 * [(3, 2)]
    labels = [[label.get_text() for label in axes.get_yticklabels()] for axes in panels]
    assert labels == 3 * [["0", "1", "2"], []]  # the left panel of each pair says it for both


def test_a_pair_is_as_bad_as_its_worst_flight():
    """None, landed, lost with a warning, lost without one; what was not flown has no number."""
    levels = ["a", "b", "c", "d"]
    ends = {
        ("a", "b"): {}, ("a", "c"): {"lost": 1}, ("a", "d"): {"landed": 2, "lost": 1},
        ("b", "c"): {"landed": 3}, ("b", "d"): {"lost": 2, "unwarned": 1}, ("c", "d"): {},
    }  # fmt: skip
    none = dict.fromkeys(pairs.COUNTS, 0)
    cells = [{"x": x, "x_2": y} | none | end for (x, y), end in ends.items()]
    found = pairs.worst(pd.DataFrame(cells), "x", levels)
    expected = np.full((4, 4), np.nan)
    expected[0, 1:], expected[1, 2:], expected[2, 3] = (0, 2, 2), (1, 3), 0
    np.testing.assert_array_equal(found, expected)


def test_the_same_results_give_the_same_bytes(tmp_path):
    write(tmp_path / "sweeps", "made_up", "curve", ["world", "scale"])
    pictures = []
    for _ in range(2):
        assert draw(tmp_path) == 0
        pictures.append([(tmp_path / f"made_up.{kind}").read_bytes() for kind in ("pdf", "png")])
    assert pictures[0] == pictures[1]


@pytest.mark.slow
def test_all_draws_what_there_is_and_counts_what_is_missing(tmp_path, capsys):
    write(tmp_path / "sweeps", SWEEPS[0], "levels", ["world", "terms"])
    assert draw(tmp_path, "--stale", name="all") == 0
    said = capsys.readouterr()
    assert f"{SWEEPS[0]}.png" in said.out
    assert "error:" not in said.err
    assert "figures were not drawn" in said.err


def test_every_drawing_of_a_file_is_known():
    assert DRAWINGS.keys() == {*get_args(Drawing)}


@pytest.mark.parametrize(
    ("values", "geometric"),
    [
        ([0, 1, 2, 4, 8, 16], True),
        ([0.0, 0.2, 0.4, 2.0 * 0.3], False),
        (np.linspace(0, 2, 11), False),
        ([-10, 0, 1], False),
    ],
)
def test_an_axis_is_stretched_only_where_its_values_are(values, geometric):
    assert _is_geometric(pd.Series(values, dtype=float)) is geometric


def test_a_legend_names_the_axes_of_its_levels(tmp_path):
    write(tmp_path, "s", "curve", ("world", "speed", "scale"))
    (legend,) = ablation.draw(load(tmp_path, "s")).legends
    shown = [text.get_text() for text in legend.get_texts()]
    assert shown == [f"world: {side}, wind speed: {speed} m/s" for side in ("side", "ahead") for speed in (5, 10)]


def test_a_unit_stands_in_brackets():
    assert axis_label(AXES["speed"]) == "wind speed [m/s]"
    assert axis_label(AXES["scale"]) == "factor"


def test_an_input_counts_by_its_distance_from_the_middle(tmp_path, agree):
    offset = np.linspace(-1.0, 1.0, 21)
    flights = pd.DataFrame({"speed": np.arange(21.0), "bias": offset, "error": np.abs(offset)})
    sweep = SweepResult("s", {"axes": [{"name": "speed"}, {"name": "bias"}], "panels": ""}, flights)
    found = correlations(sweep, flights, flights["error"])
    agree("bias", found["bias"], 1.0, 1e-12)
    assert abs(found["speed"]) < 0.2
    # A flight that was lost before the error counts has none, wherever it stands among the inputs.
    flights.loc[[3, 20], "error"] = np.nan
    agree("bias of the others", correlations(sweep, flights, flights["error"])["bias"], 1.0, 1e-12)


def test_a_front_pools_all_axes_but_missions_and_panels(tmp_path):
    write(tmp_path, "made_up", "front", ["mission", "world", "speed"], "world")
    side, _ = front.draw(load(tmp_path, "made_up")).axes
    # Cell i has i of 8 flights upright; the side has cells 0 and 1 of the first mission, 4 and 5 of the second.
    (line,) = side.get_lines()
    assert dict(zip(line.get_xdata(), line.get_ydata(), strict=True)) == {14.0: 100 / 16, 11.0: 900 / 16}
