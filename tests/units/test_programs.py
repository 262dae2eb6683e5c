"""Compiled programs are kept where the user says, or else in the user's cache folder."""

import jax
import pytest

from jax_aero.sim.programs import keep_programs


@pytest.fixture
def setting():
    names = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    before = [getattr(jax.config, name) for name in names]
    jax.config.update(names[1], 1.0)
    yield lambda folder: jax.config.update(names[0], folder)
    for setting in zip(names, before, strict=True):
        jax.config.update(*setting)


def test_programs_are_kept_in_the_users_cache_folder(setting, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    setting(None)
    keep_programs()
    assert jax.config.jax_compilation_cache_dir.startswith(str(tmp_path / "jax-aero"))
    assert jax.config.jax_persistent_cache_min_compile_time_secs == 0.0


def test_the_folder_that_is_given_stays(setting, tmp_path):
    setting(str(tmp_path / "mine"))
    keep_programs()
    assert jax.config.jax_compilation_cache_dir == str(tmp_path / "mine")
    assert jax.config.jax_persistent_cache_min_compile_time_secs == 1.0


def test_a_folder_that_cannot_be_made_is_not_used(setting, monkeypatch, tmp_path):
    """JAX would warn of every program."""
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    setting(None)
    keep_programs()
    assert jax.config.jax_compilation_cache_dir is None
