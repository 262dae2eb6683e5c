import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from jax_aero.base import places, tables
from jax_aero.base.keys import parse_assignments
from jax_aero.base.terminal import Refused
from jax_aero.results.changes import folder_suffix, options_of


def test_values_are_written_as_in_toml():
    given_on_command_line = [
        "wind.velocity=[0, -12, 0]",
        "simulator.duration = 2.5",
        "a.b=true",
        'a.c="x y"',
        "a.d={e=1}",
        "a.e=[1,\n2] # a list",
    ]
    assert parse_assignments(given_on_command_line) == {
        "wind.velocity": [0, -12, 0],
        "simulator.duration": 2.5,
        "a.b": True,
        "a.c": "x y",
        "a.d": {"e": 1},
        "a.e": [1, 2],
    }


def test_a_bare_word_is_a_text_because_shells_strip_quotes():
    assert parse_assignments(["simulator.lever_arm=unrotated", "robot=configs/robot/sparrow.toml"]) == {
        "simulator.lever_arm": "unrotated",
        "robot": "configs/robot/sparrow.toml",
    }


@pytest.mark.parametrize("value", ["{e = 1, f = {'a b' = 'x'}}", "[{jet = 'l', at = 1.5}, {}]", "true", "[]"])
def test_the_words_of_a_command_are_read_as_what_they_were_made_of(value):
    changes = parse_assignments([f"a.b={value}"])
    assert parse_assignments(options_of(changes)[1::2]) == changes


def test_a_key_is_given_once():
    with pytest.raises(Refused, match=r"--set a\.b = 2: `a\.b` is 1 already; expected each key once"):
        parse_assignments(["a.b=1", "c=1", "a.b = 2"])


@pytest.mark.parametrize(
    "assignment", ["wind.velocity", "=3", "a..b=3", "a.=3", "a=[1,", "a=1 2", "a=", "a=1\nb=2", "a=1\n[b]"]
)
def test_what_cannot_be_read_is_refused_and_quoted(assignment):
    with pytest.raises(Refused) as refusal:
        parse_assignments([assignment])
    assert assignment in str(refusal.value)


@pytest.mark.parametrize("value", ["2020-01-01", "2020-01-01T10:00:00Z", "10:00:00"])
def test_no_key_is_a_date(value, tmp_path):
    with pytest.raises(Refused, match=r"--set a\.b=.*: `a\.b\.c\.1` is .*, as no key is a date"):
        parse_assignments([f"a.b={{ c = [1, {value}] }}"])
    file = tmp_path / "own.toml"
    file.write_text(f"title = {value}")
    with pytest.raises(Refused, match=r"own\.toml: `title` is .*, as no key is a date"):
        tables.read(file)


class Named(tables.Table, frozen=True):
    entries: dict[str, dict[str, float]]
    label: str | float = ""


def test_tables_keep_the_order_of_their_file(tmp_path):
    """Designs of random points count postures, and searches draw from ranges, in the order of a file."""
    file = tmp_path / "own.toml"
    file.write_text("label = 8\n[entries.z]\nb = 1\na = 2\n[entries.y]\n")
    changed = tables.load(file, Named, {"entries.y.d": 3.0, "entries.x": {}})
    for entries in (
        tables.read(file)["entries"],
        changed.entries,
        tables.convert(tables.read(file), Named, "").entries,
    ):
        assert list(entries)[:2] == ["z", "y"]
        assert list(entries["z"]) == ["b", "a"]
    assert changed.entries["y"] == {"d": 3.0}
    assert isinstance(changed.label, float)  # as the other labels of an axis with fractions


def test_the_suffix_names_what_was_set():
    assert folder_suffix({"wind.velocity": [0, -12, 0]}) == "--wind.velocity=0_-12_0"
    assert folder_suffix({"b": True, "a": "x-y-z"}) == "--a=x-y-z--b=true"
    assert folder_suffix({"a": "x/y z"}) == "--a=x-y-z~96ec5b3f"
    assert folder_suffix({"a": "x-y/z"}) != folder_suffix({"a": "x/y z"})
    assert folder_suffix({}) == ""


KEYS = st.text("ab_.", min_size=1, max_size=50)
NUMBERS = st.booleans() | st.integers() | st.floats()
VALUES = NUMBERS | st.text() | st.lists(NUMBERS | st.text(), max_size=4)


# How long examples take to draw says how busy the machine is, nothing of the code.
@settings(suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(st.dictionaries(KEYS, VALUES, max_size=4))
def test_any_suffix_is_one_short_folder_name(changes):
    suffix = folder_suffix(changes)
    assert len(suffix) <= places.LONGEST
    assert "/" not in suffix
    assert suffix.isprintable()


def test_long_suffixes_stay_distinct():
    first, second = ({f"key_{i}": i for i in range(40)} | {"last": end} for end in (1, 2))
    assert folder_suffix(first) != folder_suffix(second)
