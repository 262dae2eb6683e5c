"""Old names in files of users are refused by their new ones."""

import pytest

from jax_aero import rust
from jax_aero.base import renamed
from jax_aero.cli import main


@pytest.mark.parametrize("new", renamed.KEYS.values())
def test_new_keys_are_keys(new):
    tables = rust.load_config("test2_observer")
    for part in new.split("."):
        assert part in tables
        tables = tables[part]


@pytest.mark.parametrize("old", renamed.KEYS)
def test_old_keys_are_refused_by_their_new_names(old, capsys):
    assert main(["fly", "test2_observer", "--set", f"{old}.x=1" if "." in old else f"{old}=1"]) == 2
    assert f"renamed to `{'.'.join(renamed.new_key(tuple(old.split('.'))))}" in capsys.readouterr().err
