"""The kept results of the open CFD are those of the designs as they are."""

from experiments import manifest
from experiments.cfd.design import Design
from experiments.report import kept
from jax_aero.base import plain


def test_the_results_are_of_the_designs_as_they_are():
    settings = {"settings.mesh.base": 0.68, "settings.solver.iterations": 120, "settings.solver.window": 40}
    for name, changes in (("cfd_anchors", {}), ("cfd_fine", settings)):
        design, result = Design.read("anchors", changes), kept.read(name)
        today = manifest.make_portable(plain.to_builtins(design.spec))
        younger = {key: today[key] for key in set(today) - set(result.config)}
        assert result.config | {"title": today["title"]} | younger == today
        assert not any(younger.values())
        assert result.summary["accepted"] == len(list(design))
