"""What the project is made of: hashes of the pinned packages, licences, bill of materials, known vulnerabilities.

`python -m experiments.tools.supply_chain lock`   requirements.lock with hashes into requirements.hashed (needs uv)
`python -m experiments.tools.supply_chain third-party`   licences of the crates that a wheel holds into THIRD_PARTY.md
`python -m experiments.tools.supply_chain audit`   of `make audit`: licences, vulnerabilities; dist/sbom.json
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import json
import re
import shutil
import subprocess
import sys
import tomllib
from collections import defaultdict
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
LOCK, HASHED, THIRD_PARTY, SBOM = (
    ROOT / name for name in ("requirements.lock", "requirements.hashed", "THIRD_PARTY.md", "dist/sbom.json")
)
TARGET = "x86_64-unknown-linux-gnu"
"""Platform whose crates are listed."""

PARTS = {"# --- make test also needs": "commands", "# --- make test-all also needs": "test"}
"""Lines of requirements.hashed, and the extra of the packages before them: those of `make demo` and of `make test`."""

PERMITTED = {
    "Apache": r"Apache([ -]Software)?([ -]License)?([ -]2\.0)?",
    "BSD": r"(0|[23]-Clause )?BSD( License)?(-[23]-Clause)?",
    "ISC": r"ISC( License \(ISCL\))?",
    "MIT": r"MIT( License|-0|-CMU)?",
    "MPL": r"(Mozilla Public License 2\.0 \()?MPL[- ]2\.0\)?",
    "LGPL": r"GNU Lesser General Public License v3 or later \(LGPLv3\+\)",
    "Python": r"PSF-2\.0|Python Software Foundation License",
    "others": r"Zlib|BSL-1\.0|CC0-1\.0",
}
"""Licences of Python packages, none of which is in a wheel of ours."""

COPYRIGHT_OF_RECORDS = "Copyright (c) 2024, Artificial and Mechanical Intelligence"
"""Of the standing robot's records, whose licence is ours, BSD-3-Clause."""

UNSTATED = {"cmeel-qhull": "Qhull", "jax-aero": "BSD-3-Clause"}
"""Licences of packages whose metadata do not name them, from their projects' own pages."""


# --- Python packages ----------------------------------------------------------------------------------------------


def write_lock() -> None:
    """Write requirements.hashed: the packages of `make demo` first, then those of `make test`, then all others."""
    waiting = _stanzas(_compile_requirements(str(LOCK), "--no-deps"))
    parts = ""
    for line, extra in PARTS.items():
        needed = _stanzas(_compile_requirements("pyproject.toml", "-", "--extra", extra, given="maturin\n"))
        parts += "".join(waiting.pop(name) for name in sorted(waiting.keys() & needed.keys())) + f"{line}\n"
    head = (
        "# Made of requirements.lock by `python -m experiments.tools.supply_chain lock`: its versions, with hashes.\n"
    )
    HASHED.write_text(f"{head}{parts}{''.join(waiting.values())}", encoding="utf-8")


def _compile_requirements(*arguments: str, given: str = "") -> str:
    uv = shutil.which("uv") or sys.exit("uv is missing: pip install uv")
    options = ["--quiet", "--constraint", str(LOCK), "--generate-hashes", "--no-annotate", "--no-header"]
    command = [uv, "pip", "compile", *options, *arguments]
    return subprocess.run(command, cwd=ROOT, input=given, capture_output=True, text=True, check=True).stdout


def _stanzas(text: str) -> dict[str, str]:
    """Return the entries of a file of requirements by `name==version`, with their hashes."""
    stanzas = re.findall(r"^([\w.-]+==\S+)( \\\n(?:    --hash=sha256:[0-9a-f]{64}(?: \\)?\n)+)", text, re.MULTILINE)
    return {normalise(name): name + hashes for name, hashes in stanzas}


def normalise(requirement: str) -> str:
    """Return `name==version` as every index spells the name."""
    name, _, version = requirement.partition("==")
    return f"{re.sub(r'[-_.]+', '-', name).lower()}=={version}"


def licence_of(package: importlib.metadata.Distribution) -> str:
    """Return the licence that an installed package states."""
    about = package.metadata
    classified = [
        entry.split(" :: ")[-1] for entry in about.get_all("Classifier") or [] if entry.startswith("License ::")
    ]
    texts = (about["License-Expression"], " AND ".join(classified), (about["License"] or "").partition("\n")[0])
    stated = next((text for text in texts if text and text != "OSI Approved"), "")
    return stated or UNSTATED.get(about["Name"].lower(), "")


def unusual_licences() -> dict[str, str]:
    """Return the installed packages whose licence is none of `PERMITTED` or `UNSTATED`, by name."""
    permitted = re.compile("|".join(PERMITTED.values()))
    unusual = {}
    for package in importlib.metadata.distributions():
        stated = licence_of(package)
        parts = re.split(r" (?:AND|OR) ", stated)
        if stated not in UNSTATED.values() and not all(permitted.fullmatch(part) for part in parts):
            unusual[package.metadata["Name"]] = stated
    return unusual


# --- crates -------------------------------------------------------------------------------------------------------


def crates() -> list[dict[str, Any]]:
    """Return the crates that are compiled into `jax_aero._core`, as `cargo metadata` describes them."""
    # Macros run in the compiler, build scripts before it: nothing of them is in the module.
    tree = _cargo(
        "tree", "--package", "flight-py", "--edges", "normal,no-proc-macro", "--prefix", "none", "--format", "{p}"
    )
    built_in = {tuple(line.split()[:2]) for line in tree.splitlines() if line}
    packages = json.loads(_cargo("metadata", "--format-version", "1"))["packages"]
    built = [each for each in packages if each["source"] and (each["name"], f"v{each['version']}") in built_in]
    return sorted(built, key=lambda each: (each["name"], each["version"]))


def _cargo(command: str, *arguments: str) -> str:
    platform = ("--target", TARGET) if command == "tree" else ("--filter-platform", TARGET)
    words = ["cargo", command, "--locked", "--offline", *platform, *arguments]
    return subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True).stdout


def third_party() -> str:
    """Return the licences of all crates that a wheel holds, as THIRD_PARTY.md has them."""
    listed = crates()
    rows = [f"| {each['name']} | {each['version']} | {expression(each)} |" for each in listed]
    texts: dict[str, list[str]] = defaultdict(list)
    for each in listed:
        for text in _licence_texts(Path(each["manifest_path"]).parent):
            texts[text].append(f"{each['name']} {each['version']}")
    blocks = [f"## {', '.join(names)}\n\n```text\n{text}\n```\n" for text, names in texts.items()]
    ours = (ROOT / "LICENSE").read_text(encoding="utf-8").strip()
    of_data = re.sub(r"^Copyright .*$", COPYRIGHT_OF_RECORDS, ours, count=1, flags=re.MULTILINE)
    return f"""# Crates in a wheel, and their licences

Written by `python -m experiments.tools.supply_chain third-party` from `Cargo.lock`; part of every wheel.
Of crates that offer several licences, that of MIT is taken. A wheel holds no Python package but this one.

| crate | version | licence |
|---|---|---|
{chr(10).join(rows)}

{chr(10).join(blocks)}
# Records

`configs/records/standing_*.parquet`: digitised from plots of
github.com/ami-iit/paper_paolino_2024_nature_learning-aerodynamics-control, commit de879f5.

```text
{of_data}
```
"""


def expression(crate: dict[str, Any]) -> str:
    """Return the licence of a crate as an SPDX expression; old ones have a slash for "or"."""
    return re.sub(r" */ *", " OR ", crate["license"])


def _licence_texts(folder: Path) -> list[str]:
    named = re.compile(r"(licen[cs]e|copying|copyright|notice)", re.IGNORECASE)
    paths = sorted(path for path in folder.iterdir() if path.is_file() and named.match(path.name))
    of_mit = [path for path in paths if "MIT" in path.name.upper()]
    texts = [path.read_text(encoding="utf-8").strip() for path in of_mit or paths]
    return ["\n".join(line.rstrip() for line in text.splitlines()) for text in texts]


# --- both ---------------------------------------------------------------------------------------------------------


def sbom() -> dict[str, Any]:
    """Return the bill of materials (CycloneDX 1.5): crates that are compiled in, and the pinned Python packages."""
    locked = tomllib.loads((ROOT / "Cargo.lock").read_text(encoding="utf-8"))["package"]
    checksums = {(each["name"], each["version"]): each.get("checksum") for each in locked}
    version = tomllib.loads((ROOT / "Cargo.toml").read_text(encoding="utf-8"))["workspace"]["package"]["version"]
    components = [
        {
            "type": "library",
            "bom-ref": f"pkg:cargo/{each['name']}@{each['version']}",
            "name": each["name"],
            "version": each["version"],
            "purl": f"pkg:cargo/{each['name']}@{each['version']}",
            "scope": "required",
            "hashes": [{"alg": "SHA-256", "content": checksums[each["name"], each["version"]]}],
            "licenses": [{"expression": expression(each)}],
        }
        for each in crates()
    ]
    for requirement in map(normalise, LOCK.read_text(encoding="utf-8").split()):
        name, _, pinned = requirement.partition("==")
        purl = f"pkg:pypi/{name}@{pinned}"
        components.append(
            {"type": "library", "bom-ref": purl, "name": name, "version": pinned, "purl": purl, "scope": "optional"}
        )
    subject = {"type": "library", "bom-ref": f"jax-aero@{version}", "name": "jax-aero", "version": version}
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": {"component": subject | {"licenses": [{"license": {"id": "BSD-3-Clause"}}]}},
        "components": components,
    }


def audit() -> int:
    """Check everything that can be checked here; say what cannot."""
    failed = [f"{name}: licence {stated!r} is not permitted yet" for name, stated in unusual_licences().items()]
    SBOM.parent.mkdir(exist_ok=True)
    SBOM.write_text(json.dumps(sbom(), indent=1) + "\n", encoding="utf-8")
    print(f"{SBOM.relative_to(ROOT)}: bill of materials")
    if shutil.which("cargo-deny") is None:
        print("not checked: crates (cargo install --locked cargo-deny)")
    else:
        checks = ["licenses", "bans", "sources"]
        if _runs("cargo", "deny", "fetch", "db"):
            checks.append("advisories")
        else:
            print("not checked: vulnerabilities of crates (the database of advisories cannot be reached)")
        if not _runs("cargo", "deny", "--locked", "check", *checks, quiet=False):
            failed.append(f"cargo deny check {' '.join(checks)}")
    if importlib.util.find_spec("pip_audit") is None:
        print("not checked: vulnerabilities of Python packages (pip install pip-audit)")
    else:
        command = [sys.executable, "-m", "pip_audit", "--requirement", str(LOCK), "--no-deps", "--disable-pip"]
        answer = subprocess.run([*command, "--format", "json"], capture_output=True, text=True, check=False)
        packages = json.loads(answer.stdout)["dependencies"] if answer.stdout else []
        if not any("vulns" in each for each in packages):
            print("not checked: vulnerabilities of Python packages (the service of advisories cannot be reached)")
        failed += [
            f"{each['name']} {each['version']}: {bad['id']}" for each in packages for bad in each.get("vulns", [])
        ]
    print("\n".join(failed) or "no objection")
    return 1 if failed else 0


def _runs(*command: str, quiet: bool = True) -> bool:
    sink = subprocess.DEVNULL if quiet else None
    return subprocess.run(command, cwd=ROOT, stdout=sink, stderr=sink, check=False).returncode == 0


def main() -> int:
    """Run the command that is given."""
    match sys.argv[1:]:
        case ["lock"]:
            write_lock()
        case ["third-party"]:
            THIRD_PARTY.write_text(third_party(), encoding="utf-8")
        case ["audit"]:
            return audit()
        case _:
            print(__doc__)
            return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
