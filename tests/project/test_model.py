"""Equations of docs/model: numbers are unique, places exist, and what is cited is there."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "docs/model").glob("*.md"))
MODEL = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
EQUATION = re.compile(r"^```math\n(?P<latex>.*?)^```\nCode: (?P<places>[^\n]*)$", re.M | re.S)
TAG = re.compile(r"\\tag\{M(\d+)\}")
CITATION = re.compile(r"\bM(\d+)\b(?: to M(\d+)\b)?")
SOURCES = [
    path
    for folder in ("rust", "jax_aero")
    for path in sorted((ROOT / folder).rglob("*"))
    if path.suffix in (".rs", ".py")
]


def equations() -> dict[int, str]:
    """The places that compute each equation, by its number."""
    return {
        int(number): match["places"] for match in EQUATION.finditer(MODEL) for number in TAG.findall(match["latex"])
    }


def places(text: str) -> list[tuple[Path, list[str]]]:
    """Files in the order of a line of places, each with the names that stand behind it."""
    found: list[tuple[Path, list[str]]] = []
    for word in re.findall(r"`([^`]+)`", text):
        if "/" in word:
            found.append((ROOT / word, []))
        else:
            found[-1][1].append(word)
    return found


def find_cited(text: str) -> set[int]:
    """Numbers that a text cites, ranges included."""
    return {number for first, last in CITATION.findall(text) for number in range(int(first), int(last or first) + 1)}


def test_every_equation_has_one_number_and_a_place():
    tags = [int(tag) for tag in TAG.findall(MODEL)]
    assert len(tags) == len(set(tags)) == MODEL.count("```math\n")
    assert set(tags) == set(equations())


def test_the_files_and_names_of_every_equation_exist():
    for number, text in equations().items():
        for path, names in places(text):
            assert path.is_file(), f"M{number}: {path}"
            code = path.read_text(encoding="utf-8")
            missing = [name for name in names if not re.search(rf"\b{re.escape(name)}\b", code)]
            assert not missing, f"M{number}: {path.name} has no {missing}"


def test_the_architecture_page_cites_the_equations_of_every_module_of_the_core_crate():
    core = ROOT / "rust/core/src"
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").replace("[", "").replace("]", "")
    rows = dict(re.findall(r"^\| `(\w+)` \|.*\| ([^|]*) \|$", page, re.M))
    for number, text in equations().items():
        for path, _ in places(text):
            if path.is_relative_to(core):
                module = Path(path.relative_to(core).parts[0]).stem
                assert number in find_cited(rows[module]), f"{module}: M{number}"


def test_the_index_names_the_equations_of_each_page():
    page = (ROOT / "docs/model/index.md").read_text(encoding="utf-8").replace("[", "").replace("]", "")
    named = dict(re.findall(r"^\| (?:\w[\w ]*\((\w+\.md)\)|this one).*\| ([^|]*) \|$", page, re.M))
    assert {path: find_cited(text) for path, text in named.items()} == {
        "" if path.stem == "index" else path.name: {int(tag) for tag in TAG.findall(path.read_text(encoding="utf-8"))}
        for path in PAGES
    }


def test_every_number_that_is_cited_exists():
    known = set(equations())
    pages = sorted((ROOT / "docs").rglob("*.md"))
    for path in [*SOURCES, *pages]:
        unknown = find_cited(path.read_text(encoding="utf-8")) - known
        assert not unknown, f"{path.relative_to(ROOT)} cites {sorted(unknown)}"
