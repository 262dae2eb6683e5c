"""Tables of pages say what their sources hold; a wrong name, unit or table is refused with its line."""

from pathlib import Path

import pytest

from experiments.report import blocks
from jax_aero.base.terminal import Refused
from jax_aero.stored import keep, kept
from tests.units.test_kept import made_up


@pytest.fixture
def page(monkeypatch, tmp_path):
    """What a block makes of these lines, beside a kept sweep and a kept study."""
    monkeypatch.setattr(kept, "FOLDER", tmp_path)
    study = {
        "coarse: drag [m2]": 0.24013,
        "coarse: error": 0.31,
        "fine: drag [m2]": 0.2,
        "fine: error": 0.1,
        "cases": 2,
    }
    for document in (made_up(), made_up(name="study", rows=[], axes=[], columns=[], summary=study)):
        (tmp_path / f"{document.name}.json").write_text(keep.to_json(document), encoding="utf-8")
    kept.read.cache_clear()
    yield lambda *lines: blocks.written("\n".join(["# A", "<!-- table", *lines, "-->", "<!-- end -->"]), Path("a.md"))
    kept.read.cache_clear()


SWEEP, STUDY = 'kept = "made_up"\n', 'kept = "study"\n'
TABLES = [
    (
        SWEEP + 'rows = { speed = "10 m/s" }\ncolumns = ["completed + landed", "rotation_error_deg_worst_of_all"]',
        [
            "| controller | completed + landed | rotation error, greatest of all [°] |",
            "| a | 2 of 2 | 4.0 |",
            "| b | 0 of 2 | lost |",
        ],
    ),
    (
        SWEEP + 'rows = { controller = { ours = "b", theirs = "a" } }\nacross = "speed"\ncolumns = ["lost"]',
        ["| controller | 0 m/s | 10 m/s |", "| ours | 0 of 2 | 2 of 2 |", "| theirs | 0 of 2 | 0 of 2 |"],
    ),
    (
        SWEEP + 'rows = { controller = "all" }\ncolumns = { "off [mm]" = "com_error_median_of_all" }',
        ["| wind speed | off [mm] |", "| 0 m/s | ? |", "| 10 m/s | ? |"],
    ),
    (
        STUDY + 'columns = { drag = "drag [m2]", "error [%]" = "error" }',
        ["| | drag [m²] | error [%] |", "| coarse | 0.24 | 31 |", "| fine | 0.20 | 10 |"],
    ),
    (
        'kept = { one = "study", other = "study" }\nrows = ["fine"]\ncolumns = { "error [%]" = "error" }',
        ["| | error [%] |", "| one | 10 |", "| other | 10 |"],
    ),
    (STUDY + 'rows = ["cases"]', ["| figure | value |", "| cases | 2 |"]),
    (
        'flights = ["test2"]\ncolumns = { "leans [°]" = "max_rotation_error" }',
        ["| flight | leans [°] |", "| `test2` | 3.1 |"],
    ),
]


@pytest.mark.parametrize(("asks", "rows"), TABLES)
def test_a_table_has_what_its_source_holds(page, asks, rows):
    text = page(asks)
    written = text.partition("-->\n")[2].splitlines()
    assert [written[0], *written[2:-1]] == rows
    stale = text.replace("\n| ", "\n| another ")
    assert stale != text == blocks.written(stale, Path("a.md"))


@pytest.mark.parametrize(
    ("asks", "reason"),
    [
        ('kept = "made_down"', "there is no kept result `made_down`; did you mean made_up"),
        ('kept = "made_up"\nrows = { wind = "a" }', "there is no axis `wind`; there are speed, controller"),
        ('kept = "made_up"\nrows = { speed = "11 m/s" }', "there is no level of speed `11 m/s`; did you mean 10 m/s"),
        ('kept = "made_up"\ncolumns = ["complete"]', "there is no column `complete`; did you mean completed"),
        ('kept = "made_up"\ncolumns = { "off [s]" = "com_error_worst_of_upright" }', "cm is no s"),
        ('kept = "made_up"\nflights = ["test2"]', "a table shows kept and flights; expected one of"),
        ('kept = "study"\nrow = 3', "unknown field `row`"),
        ('flights = ["test22"]', "there is no experiment `test22`; did you mean"),
        ("kept = 3", "Expected `str"),
    ],
)
def test_what_is_not_there_is_refused_with_its_line(page, asks, reason):
    with pytest.raises(Refused, match=r"a\.md:2: ") as refusal:
        page(asks)
    assert reason in str(refusal.value)


def test_a_block_without_an_end_is_refused():
    with pytest.raises(Refused, match=r"a\.md: a table is not between"):
        blocks.written("<!-- table\n-->\n| a |\n", Path("a.md"))


@pytest.mark.parametrize(("figure", "unit"), [("lean [degree]", "°"), ("lean [deg]", "°"), ("speed [deg/s]", "°/s")])
def test_degrees_have_one_sign_however_a_figure_spells_them(figure, unit):
    assert kept._unit(figure) == unit
