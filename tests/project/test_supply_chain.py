"""What is written of licences and hashes is that of the pinned packages and crates."""

import re
from pathlib import Path

from experiments.tools import supply_chain

ROOT = Path(__file__).resolve().parents[2]


def test_every_pinned_package_has_hashes():
    """Of the same version, and what `make demo` needs stands first."""
    text = supply_chain.HASHED.read_text(encoding="utf-8")
    stanzas = supply_chain._stanzas(text)
    assert {*stanzas} == {
        supply_chain.normalise(line) for line in supply_chain.LOCK.read_text(encoding="utf-8").split()
    }
    assert "".join(stanzas.values()) == re.sub(r"^#.*\n", "", text, flags=re.MULTILINE)
    demo, test, others = re.split("|".join(supply_chain.PARTS), text)
    assert "\nmaturin==" in demo
    assert "\njax==" in demo
    assert "\nclarabel==" in test
    assert "\nray==" in others


def test_the_licences_of_what_a_wheel_holds_are_those_of_its_crates():
    """`python -m experiments.tools.supply_chain third-party` writes them; `license-files` puts them into the wheel."""
    assert supply_chain.THIRD_PARTY.read_text(encoding="utf-8") == supply_chain.third_party()
    assert "THIRD_PARTY.md" in (ROOT / "pyproject.toml").read_text(encoding="utf-8")


def test_every_installed_package_has_a_licence_that_is_permitted():
    assert supply_chain.unusual_licences() == {}


def test_the_bill_of_materials_names_every_crate_and_package_once():
    """The fields that CycloneDX 1.5 requires, and purl and hash of each component."""
    bill = supply_chain.sbom()
    assert {"bomFormat": "CycloneDX", "specVersion": "1.5", "version": 1}.items() <= bill.items()
    components = bill["components"]
    references = [component["bom-ref"] for component in components]
    assert len(set(references)) == len(references)
    for component in components:
        assert component["type"] == "library"
        assert re.fullmatch(r"pkg:(cargo|pypi)/[\w.-]+@[\w.+!-]+", component["purl"])
        if component["purl"].startswith("pkg:cargo"):
            assert re.fullmatch("[0-9a-f]{64}", component["hashes"][0]["content"])
    named = {(component["name"], component["version"]) for component in components}
    assert {(crate["name"], crate["version"]) for crate in supply_chain.crates()} <= named
    assert len(components) > 200
