"""Files spoilt at random are read as numbers, or refused with a message: nothing else is raised.

`make fuzz` tries other examples for an hour; the crate's own readers: `rust/sim/tests/fuzz.rs`.
"""

import os
import re

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from experiments import record
from jax_aero import rust
from jax_aero.base.places import HOME
from jax_aero.view import Refused, recording
from tests.conftest import ROBOT, made_up_flight

CONFIGS = HOME / "configs"

# The same examples in every run, unless `PROPTEST_CASES` asks for more; then `--hypothesis-seed` says which.
spoiling = settings(
    max_examples=int(os.environ.get("PROPTEST_CASES", "60")),
    derandomize="PROPTEST_CASES" not in os.environ,
    database=None,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)

NUMBERS = ["0", "-1", "1", "0.5", "1e-320", "-1e300", "1e308", "1e999", "nan", "-inf", "9" * 400, "", "[]", '"a"']
PLACE = st.integers(0, 10**6)
EDITS = st.lists(
    st.tuples(st.sampled_from(["number", "number", "word", "delete", "repeat", "letter", "end"]), PLACE, PLACE),
    min_size=1,
    max_size=3,
)


def spoil_text(text, edits):
    """Replace numbers, words or letters, delete or repeat lines, or end early."""
    for kind, at, of in edits:
        pattern = {"number": r"[-+.\deE]*\d[-+.\deE]*", "word": r"\w+", "letter": r"(?s)."}.get(kind, r".+")
        if not (found := list(re.finditer(pattern, text))):
            return text
        place, other = found[at % len(found)], found[of % len(found)].group()
        here = place.group()
        new = {
            "number": NUMBERS[of % len(NUMBERS)],
            "word": other,
            "delete": "",
            "repeat": f"{here}\n{other}",
            "letter": chr(of % 300),
            "end": "",
        }[kind]
        text = text[: place.start()] + new + ("" if kind == "end" else text[place.end() :])
    return text


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("spoilt")


@spoiling
@given(name=st.sampled_from(["aero_aware", "observer", "estimator", "balancing"]), edits=EDITS)
def test_a_configuration(folder, name, edits):
    text = (CONFIGS / f"control/{name}.toml").read_text()
    text = (
        spoil_text(text, edits)
        .replace('"../', f'"{CONFIGS}/')
        .replace('"observer.toml"', f'"{CONFIGS}/control/observer.toml"')
    )
    (folder / "control.toml").write_text(text)
    flight = (CONFIGS / "experiments/test2.toml").read_text().replace('"../', f'"{CONFIGS}/')
    (folder / "flight.toml").write_text(flight.replace(f"{CONFIGS}/control/aero_aware.toml", "control.toml"))
    try:
        rust.load_config(folder / "flight.toml")
    except ValueError:
        return


@pytest.fixture(scope="module")
def result(folder):
    run = folder / "run"
    flight = record.to_dataset(made_up_flight(1.0), ROBOT, title="made up", config_digest="")
    manifest = {"title": "made up", "config": {"robot": str(CONFIGS / "robot/ironcub_mk1.toml")}}
    record.write_run(run, flight, manifest)
    return run


@spoiling
@given(of_manifest=st.booleans(), edits=EDITS, bits=st.lists(st.tuples(PLACE, st.integers(1, 255)), max_size=3))
def test_a_result(folder, result, of_manifest, edits, bits):
    copy = folder / "copy"
    copy.mkdir(exist_ok=True)
    manifest, run = (result / "manifest.json").read_text(), bytearray((result / "run.nc").read_bytes())
    for at, change in bits:
        run[at % len(run)] ^= change
    (copy / "manifest.json").write_text(spoil_text(manifest, edits) if of_manifest else manifest)
    (copy / "run.nc").write_bytes((result / "run.nc").read_bytes() if of_manifest else run)
    try:
        flight = recording.read(copy)
    except Refused:
        return
    assert flight.duration >= 0.0
