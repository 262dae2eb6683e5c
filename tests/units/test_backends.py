"""Two engines behind one interface."""

import sys

import pytest

from jax_aero import backends, rust
from jax_aero.base.terminal import Refused


def test_an_unknown_engine_is_refused():
    with pytest.raises(Refused, match="backend = 'matlab'; expected one of rust, jax"):
        backends.backend("matlab")


def test_the_jax_engine_plugs_in_with_two_functions(monkeypatch, make_flight):
    asked = []

    class Module:
        @staticmethod
        def fly(config, progress=None):
            return Module.fly_batch([config], progress)[0]

        @staticmethod
        def fly_batch(configs, progress=None):  # noqa: ARG004 - the engine's signature
            if any(config["title"] == "refused" for config in configs):
                raise ValueError("no such jet")
            asked.append(configs)
            return [make_flight(step=0.5) for _ in configs]

    monkeypatch.setitem(sys.modules, "jax_aero.sim", Module)
    jax = backends.backend("jax")
    flights = jax.fly_batch([{"backend": "jax", "title": "a"}, {"title": "b"}])
    assert [flight.outcome for flight in flights] == ["completed", "completed"]
    assert asked == [[{"backend": "jax", "title": "a"}, {"title": "b"}]]
    refused, flown = jax.fly_batch([{"title": "refused"}, {"title": "b"}])
    assert refused == backends.Failure("no such jet")
    assert flown.outcome == "completed"


def test_a_configuration_may_name_its_engine():
    config = rust.load_config("test1", {"backend": "jax"})
    assert backends.backend_of(config) == "jax"
    plain = rust.load_config("test1")
    assert backends.backend_of(plain) == "rust"
    with pytest.raises(ValueError, match="matlab"):
        rust.load_config("test1", {"backend": "matlab"})
