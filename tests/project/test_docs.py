"""README and documentation: the site builds without a warning, and what pages show, runs.

A comment `<!-- test: KIND -->` before a code block states how it is tried.
"""

import ast
import functools
import importlib.util
import itertools
import os
import pkgutil
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from contextlib import suppress
from pathlib import Path

import nbformat
import pytest
from mkdocs.config import load_config
from mkdocs.structure.files import Files
from nbclient import NotebookClient
from traitlets.config import Config

import jax_aero
from docs import hooks, ties
from experiments import overrides, studies
from experiments.report.page import table, to_html
from experiments.robot import waypoints
from experiments.sweep import spec
from experiments.sweep.design import Design
from jax_aero import air, cli, env, env_gym, rust, sim
from jax_aero.base import places, tables
from paper_figs.figures import FIGURES
from tests.browser import CHROMIUM, SLOWEST, open_chromium

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
README = ROOT / "README.md"
PAGES = [README, *sorted(DOCS.rglob("*.md")), *sorted(studies.FOLDER.glob("*/README.md"))]
FENCE = re.compile(r"(?:<!-- test: (?P<kind>[\w-]+) -->\n)?^```(?P<language>\w+)\n(?P<code>.*?)^```$", re.M | re.S)
KINDS = {
    ("run", "python"),
    ("parse", "python"),  # takes minutes, or is part of a program; its names are checked
    ("run", "sh"),
    ("show", "sh"),  # as commands within sentences: what they name is checked
    ("experiment", "toml"),
    ("robot", "toml"),
    ("sweep", "toml"),
    ("waypoints", "toml"),
    ("show", "toml"),  # part of a file
    ("crate", "toml"),
    (None, "c"),
    (None, "cmake"),
    (None, "cpp"),
    (None, "rust"),
    (None, "math"),
    (None, "text"),
}


WRITTEN = [page for page in PAGES if page.parent != DOCS / "results"]
"""Pages that are written by hand; those of kept results follow from their figures."""
OTHERS = [
    *(ROOT / f"{title}.md" for title in ("CHANGELOG", "CONTRIBUTING", "SECURITY")),
    *sorted(path for folder in ("configs", "tests") for path in (ROOT / folder).rglob("README.md")),
]
MOST_WORDS, OF_A_PAGE, OF_THE_MODEL = 48_500, 2500, 4000


def name(path: Path) -> str:
    return str(path.relative_to(ROOT))


def blocks(page: Path, kind: str, language: str) -> list[str]:
    found = FENCE.finditer(page.read_text(encoding="utf-8"))
    return [block["code"] for block in found if (block["kind"], block["language"]) == (kind, language)]


def pages_with(kind: str, language: str) -> list[Path]:
    pages = [page for page in PAGES if blocks(page, kind, language)]
    assert pages, (kind, language)
    return pages


def run(command: list[str], environment: dict[str, str] | None = None, folder: Path = ROOT) -> None:
    answer = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=600
    )
    assert answer.returncode == 0, answer.stdout + answer.stderr


def test_the_architecture_page_names_every_module_of_the_core_crate():
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    named = set(re.findall(r"^\| `(\w+)` \|", page, re.M))
    assert named == {path.stem for path in (ROOT / "rust/core/src").glob("*.rs")} - {"lib"}


def test_pages_stay_short():
    """Figures belong to kept results: a page says what they mean, and links them. Its ties to them are not read."""
    words = {page: len(ties.TIE.sub("", page.read_text(encoding="utf-8")).split()) for page in WRITTEN}
    long = {
        name(page): count
        for page, count in words.items()
        if count > (OF_THE_MODEL if page.parent == DOCS / "model" else OF_A_PAGE)
    }
    assert long == {}
    assert sum(words.values()) <= MOST_WORDS


LONGEST_SENTENCE = 29
NOT_PROSE = re.compile(r"^```.*?^```|<!--.*?-->|^ *\|.*?$|(?<=\])\([^)]*\)", re.M | re.S)
AS_A_WORD = re.compile(r"`[^`]*`|\$[^$]*\$")
ENDS = re.compile(r"\n\s*\n|\n\s*(?=[*+-] |\d+\. |#)|(?<=[.?!])[\"*`)]*\s+(?=[A-Z`*\[(])")


def long_sentences(text: str) -> list[str]:
    """Sentences of a page, captions included, of too many words; code and a formula within a sentence count as one."""
    sentences = ENDS.split(AS_A_WORD.sub("X", NOT_PROSE.sub("", text)))
    return [sentence for sentence in sentences if len(sentence.split()) > LONGEST_SENTENCE]


@pytest.mark.parametrize("page", [*WRITTEN, *OTHERS], ids=name)
def test_sentences_stay_short(page):
    assert long_sentences(page.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    "form", ["{}.", "# A title\n* {}\n* next", "![{}](a.png)", "An `a b` {}. Next", "**Bold.** {}"]
)
def test_a_long_sentence_is_refused(form):
    assert long_sentences(form.format(" ".join(["word"] * 27))) == []
    assert len(long_sentences(form.format(" ".join(["word"] * 30)))) == 1


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_every_block_says_how_it_is_tried(page):
    text = page.read_text(encoding="utf-8")
    found = list(FENCE.finditer(text))
    assert 2 * len(found) == len(re.findall("^```", text, re.M))
    for block in found:
        assert (block["kind"], block["language"]) in KINDS, block[0]
        if block["language"] in {"rust", "c", "cpp", "cmake"}:  # taken from a program that the crates' tests run
            program = r"rust/(sim/examples/tutorial\.rs|capi/examples/((loop|realtime)\.c|hover\.cpp|CMakeLists\.txt))"
            assert re.fullmatch(rf'--8<-- "{program}(:\w+)?"\n', block["code"])


@pytest.mark.parametrize("page", pages_with("run", "python"), ids=name)
def test_the_python_of_a_page_is_one_program_that_runs_in_any_folder(page, tmp_path):
    program = "\n".join(blocks(page, "run", "python"))
    folder = ROOT if '"docs/' in program else tmp_path  # but where a file of the page is read
    run([sys.executable, "-W", "error", "-c", program], {**os.environ, "PYTHONPATH": str(ROOT)}, folder)


@pytest.mark.parametrize("page", pages_with("parse", "python"), ids=name)
def test_the_names_that_a_page_imports_exist(page):
    for code in blocks(page, "parse", "python"):
        for node in ast.walk(ast.parse(code)):
            if isinstance(node, ast.ImportFrom):
                exec(compile(ast.Module([node], []), page.name, "exec"), {})


@pytest.mark.parametrize("page", pages_with("run", "sh"), ids=name)
def test_commands_run(page, tmp_path):
    shown = "\n".join(blocks(page, "run", "sh"))
    program = re.sub(r"^jax-aero fly \w.*$", r'\g<0> --out "$OUT"', shown, flags=re.M)  # not to the reader's results
    environment = {"PATH": f"{Path(sys.executable).parent}:/usr/bin:/bin", "OUT": str(tmp_path), "HOME": str(tmp_path)}
    run(["bash", "-euo", "pipefail", "-c", program], environment)
    assert list(tmp_path.glob("*/manifest.json"))


def shown_commands(text: str) -> list[list[str]]:
    """Words of the commands in shell blocks and within sentences."""
    spans = re.findall(r"`((?:jax-aero|make|python) [^`]+)`", FENCE.sub("", text))
    lines = [command for span in spans for command in span.split("; ")]
    for block in FENCE.finditer(text):
        if block["language"] == "sh":
            lines += block["code"].replace("\\\n", "").splitlines()
    return [words for line in lines if (words := shlex.split(line, comments=True))]


def check_flights(names: list[str], options: list[str], text: str) -> None:
    """Experiments exist, or the page makes them, and `--set` names keys and values that they can have."""
    changes = overrides.parse([value for option, value in itertools.pairwise(options) if option == "--set"])
    for flown in names:
        if flown in places.names("experiments"):
            rust.load_config(flown, changes)
        else:
            assert flown.endswith(".toml") or f"`configs/experiments/{flown}.toml`" in text


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_shown_commands_name_what_exists(page):
    text = page.read_text(encoding="utf-8")
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    sweeps = {*places.names("sweeps"), *re.findall(r"configs/sweeps/(\w+)\.toml", text)}
    for program, first, *words in (words for words in shown_commands(text) if len(words) > 1):
        names = list(itertools.takewhile(lambda word: word.islower() and not word.startswith("-"), words))
        options = words[len(names) :]
        if program == "make":
            assert f"\n{first}:" in makefile, words
        elif program == "python":
            assert importlib.util.find_spec(words[0]) if first == "-m" else (ROOT / first).is_file(), words
        elif program == "jax-aero":
            assert first in {*cli.COMMANDS, "--help"}, first
            if first == "fly" and options[:2] != ["NAME", "--set"]:
                check_flights(names, options, text)
            elif first == "figures":
                assert {*names} <= {*FIGURES, *sweeps, "all"}, names
            elif first == "sweep":
                assert {*names} <= sweeps, names
            elif first == "study" and page in WRITTEN and words and words[0].islower():
                assert words[0] in studies.names(), words
        else:
            for_arm = {"aarch64-linux-gnu-gcc", "qemu-aarch64", "rustup"}
            examples = {f"target/{path.stem}" for path in (ROOT / "rust/capi/examples").glob("*.c")}
            assert program in {"cargo", "cc", "export", "source"} | examples | for_arm, program
            assert all((ROOT / word).exists() for word in words if word.startswith(("rust/", "configs/"))), words


@pytest.mark.parametrize("page", WRITTEN, ids=name)
def test_a_page_shows_no_command_of_another_study(page):
    """A study can be deleted with its folder: pages link its page, and the link goes with it.

    A kept result says what made it, also once its study is gone.
    """
    others = {name for name in studies.names() if studies.FOLDER / name != page.parent}
    figures = {figure for figure, entry in FIGURES.items() if entry.kind in others}
    text = page.read_text(encoding="utf-8")
    for words in shown_commands(text):
        if words[:2] in (["jax-aero", "study"], ["jax-aero", "figures"]):
            assert {*words[2:]}.isdisjoint(others | figures), words


def test_links_to_studies_vanish_with_them(monkeypatch):
    text = "[one](../../experiments/studies/tune/README.md#what) of [all](../../experiments/studies)"
    assert hooks.link_site(text, "howto/robot.md") == "[one](../studies/tune.md#what) of [all](../studies/index.md)"
    crate = "[it](../../rust/core/src/lib.rs) in [a folder](../../rust/core)"
    assert (
        hooks.link_site(crate, "api/rust.md")
        == "[it](../../rust/flight_core/index.html) in [a folder](../../rust/core)"
    )
    monkeypatch.setattr(studies, "names", list)
    assert hooks.link_site(text, "howto/robot.md") == "one of [all](../studies/index.md)"


LINK = re.compile(r"\]\((?!https?:)([^)#\s]+)(?:#[^)]*)?\)")


generated = functools.cache(hooks.generated)


@pytest.mark.parametrize("page", [*PAGES, *OTHERS], ids=name)
def test_links_of_a_page_lead_to_files_in_a_clone_and_to_pages_of_the_site(page):
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    assert [link for link in LINK.findall(text) if not (page.parent / link).exists()] == []
    if DOCS in page.parents:
        made = {DOCS / path for path in generated()} | {DOCS / path for path in hooks.SITE.values() if "rust/" in path}
        for link in LINK.findall(hooks.link_site(text, page.relative_to(DOCS).as_posix())):
            # Of an address that is no page's, the page is a folder.
            target = ((page.with_suffix("") if link.endswith(".html") else page.parent) / link).resolve()
            assert target in made or (target.is_file() and DOCS in target.parents), link


def test_pages_that_any_file_names_are_in_a_clone():
    command = ["git", "grep", "--only-matching", "-IhE", r"\bdocs/[a-z0-9_/]+\.(md|ipynb)\b"]
    named = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    assert "docs/failures.md" in named
    assert [path for path in set(named) if not (ROOT / path).is_file()] == []


def test_links_of_generated_pages_lead_to_pages_and_pictures():
    pages = generated()
    stored = {str(path.relative_to(DOCS)) for path in DOCS.rglob("*") if path.is_file()}
    pictures = {f"studies/{path.parent.name}/{path.name}" for path in hooks.pictures()}
    for page, text in pages.items():
        for link in LINK.findall(FENCE.sub("", text)):
            assert os.path.normpath(Path(page).parent / link) in {*pages, *stored, *pictures}, f"{page}: {link}"


def test_pictures_and_folders_of_the_readme_exist():
    text = README.read_text(encoding="utf-8")
    linked = re.findall(r'\bsrc(?:set)?="([^"]+)"', text)
    table = re.findall(r"^\| (`[^|]+`) \|", text.split("## What lies where")[1], re.M)
    folders = [folder for row in table for folder in re.findall(r"`([^`]+)`", row)]
    assert folders
    for path in [*linked, *folders]:
        assert any(ROOT.glob(path)), path


@pytest.mark.parametrize("page", pages_with("show", "toml"), ids=name)
def test_shown_parts_of_files_are_toml(page):
    for code in blocks(page, "show", "toml"):
        tomllib.loads(code)


def test_the_shown_robot_has_keys_that_exist():
    sparrow = tomllib.loads((ROOT / "configs/robot/sparrow.toml").read_text(encoding="utf-8"))
    joint_keys = {"name", "limits_deg", "limits", "torque_max", "torque_rate_max", "velocity_max_deg", "velocity_max"}
    for page in pages_with("robot", "toml"):
        for code in blocks(page, "robot", "toml"):
            table = tomllib.loads(code)
            assert table.keys() <= sparrow.keys()
            joints = [joint for group in table["joint_groups"] for joint in group["joints"]]
            assert all(joint.keys() <= joint_keys for joint in joints)


@pytest.mark.parametrize("page", pages_with("crate", "toml"), ids=name)
def test_a_shown_crate_finds_its_dependencies_and_their_features(page, tmp_path):
    for number, code in enumerate(blocks(page, "crate", "toml")):
        folder = tmp_path / str(number)
        (folder / "src").mkdir(parents=True)
        (folder / "src/main.rs").write_text("fn main() {}\n")
        (folder / "Cargo.toml").write_text(code.replace("../jax-aero", str(ROOT)), encoding="utf-8")
        shutil.copy(ROOT / "Cargo.lock", folder)
        run(["cargo", "metadata", "--offline", "--format-version=1", f"--manifest-path={folder / 'Cargo.toml'}"])


@pytest.mark.parametrize("page", pages_with("experiment", "toml"), ids=name)
def test_shown_experiments_can_fly(page, tmp_path):
    configs = shutil.copytree(ROOT / "configs", tmp_path / "configs")
    for number, code in enumerate(blocks(page, "experiment", "toml")):
        file = configs / "experiments" / f"shown_{number}.toml"
        file.write_text(code, encoding="utf-8")
        rust.load_config(file)


@pytest.mark.parametrize("page", pages_with("sweep", "toml"), ids=name)
def test_shown_sweeps_can_be_planned(page, tmp_path):
    configs = shutil.copytree(ROOT / "configs", tmp_path / "configs")
    for code in blocks(page, "sweep", "toml"):
        file = configs / "sweeps" / "shown.toml"
        file.write_text(code, encoding="utf-8")
        design = Design(spec.load(str(file)))
        design.check()
        assert design.n_rows > 0


@pytest.mark.parametrize("page", pages_with("waypoints", "toml"), ids=name)
def test_shown_waypoints_become_a_flight(page, tmp_path):
    configs = shutil.copytree(ROOT / "configs", tmp_path / "configs")
    for code in blocks(page, "waypoints", "toml"):
        file = configs / "waypoints" / "shown.toml"
        file.write_text(code, encoding="utf-8")
        _, flight = waypoints.write(file, tables.load(file, waypoints.Waypoints), tmp_path / "shown")
        assert rust.load_config(flight)["title"] == tomllib.loads(code)["title"]


@pytest.mark.parametrize("path", sorted(DOCS.glob("notebooks/*.ipynb")), ids=name)
def test_a_notebook_runs(path, tmp_path, monkeypatch):
    monkeypatch.setenv("PIP_NO_INDEX", "1")  # what a notebook installs is there

    def outputs() -> list[nbformat.NotebookNode]:
        return [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]

    def read_printed() -> str:  # without what libraries log
        return "".join(output["text"] for output in outputs() if output.get("name") == "stdout")

    notebook = nbformat.read(path, as_version=4)
    assert any("image/png" in output.get("data", {}) for output in outputs())
    stored = read_printed()
    # Files in place of TCP ports, which are chosen before they are bound: another process may take one.
    config = Config(KernelManager={"transport": "ipc", "ip": str(tmp_path / "kernel")})
    resources = {"metadata": {"path": str(path.parent)}}
    NotebookClient(notebook, timeout=600, resources=resources, config=config).execute()
    if path.stem == "first_flight":  # of the crate alone, which computes the same bits everywhere
        assert read_printed() == stored


def test_formulas_are_typeset_wherever_they_stand():
    def typeset(markdown):
        return hooks.INLINE.sub(hooks.inline_formula, markdown)

    text = "a `$HOME` of\n```sh\necho $A $B\n```\n"
    assert typeset(text) == text
    assert typeset("$3 and\n\n$4") == "$3 and\n\n$4"
    for formula in ("$x + 1$", "$(x +\n1)$"):
        assert re.fullmatch(r"at <span><math.*</math></span>, say", typeset(f"at {formula}, say"), re.DOTALL)
    for page in PAGES:
        left = hooks.INLINE.sub("", hooks.EQUATION.sub("", page.read_text(encoding="utf-8")))
        assert "$" not in left, f"{page.name}: a formula is not closed within its paragraph"


def test_every_cell_of_a_wide_table_names_its_column():
    head, row = "".join(f"<th>{name}</th>" for name in 'ab"c'), "<td>1</td><td></td><td>3</td><td>4</td>"
    html = hooks.on_page_content(f"<p><table><tr>{head}</tr><tr>{row}</tr></table>")
    assert re.findall('<td data-of="(.*?)">(.*?)</td>', html) == [("a", "1"), ("b", ""), ("&quot;", "3"), ("c", "4")]
    narrow = f"<table><tr>{head[:-10]}</tr><tr><td>1</td></tr></table>"
    assert hooks.on_page_content(narrow) == narrow


def test_the_flight_lab_is_in_the_site_where_it_is_built(tmp_path, monkeypatch):
    monkeypatch.setattr(hooks, "LAB", tmp_path)
    assert "iframe" not in hooks.embedded_lab("look/")
    (tmp_path / "index.html").write_text("the lab")
    config = load_config(str(ROOT / "mkdocs.yml"))
    monkeypatch.setattr(config.plugins, "_current_plugin", None, raising=False)  # set while a site is built
    held = {file.src_uri: file for file in hooks.on_files(Files([]), config=config)}
    assert held["look/fly/index.html"].content_string == "the lab"
    for page, address in (("", "look/fly/index.html"), ("look/", "fly/index.html")):
        assert hooks.embedded_lab(page).count(f'="{address}"') == 2


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Every page, built without a warning."""
    folder = tmp_path_factory.mktemp("site")
    run([sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)])
    return folder


def test_the_page_of_the_python_api_has_every_public_name(site):
    page = (site / "api/python/index.html").read_text(encoding="utf-8")
    shown = []
    for name in set(re.findall(r'id="(jax_aero[^"]*)"', page)):
        with suppress(AttributeError):  # of a field
            shown.append(pkgutil.resolve_name(name))
    for module in (jax_aero, air, env, env_gym, rust, sim):
        for name in module.__all__:
            found = getattr(module, name)
            assert name == "__version__" or any(found is one for one in shown), f"{module.__name__}.{name}"


def test_pages_load_nothing_from_elsewhere(site):
    fetched = re.compile(r"""<(?:script|link|img)[^>]+(?:src|href)=["']?(?:https?:)?//""")
    for page in site.rglob("*.html"):
        assert not fetched.search(page.read_text(encoding="utf-8")), f"{page.name} loads something from elsewhere"


# Parts of a page that reach beyond its right side and cannot be scrolled into sight, and pictures that are not there.
OUT_OF_SIGHT = """() => {
    const width = document.documentElement.clientWidth
    const scrolls = e => e && e != document.body &&
        (["auto", "scroll", "hidden"].includes(getComputedStyle(e).overflowX) || scrolls(e.parentElement))
    const text = document.querySelector("article") ?? document.body
    const beyond = [...text.querySelectorAll("*")].filter(e => {
        const box = e.getBoundingClientRect()
        return box.width > 0 && box.right > width + 1 && !scrolls(e)
    })
    const missing = [...document.images].filter(image => image.complete && image.naturalWidth == 0)
    return [...beyond, ...missing].map(e => e.outerHTML.slice(0, 80))
}"""


@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed: apt-get install chromium")
def test_pages_fit_the_screen(site):
    """Of a desk and of a telephone."""
    pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: make setup")
    with open_chromium() as browser:
        tab = browser.new_page()
        tab.set_default_timeout(SLOWEST)
        for page in sorted(site.rglob("index.html")):
            tab.goto(page.as_uri())
            for width in (1440, 390):
                tab.set_viewport_size({"width": width, "height": 900})
                assert tab.evaluate(OUT_OF_SIGHT) == [], f"{page.relative_to(site)} at {width} px"


@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed: apt-get install chromium")
def test_a_report_fits_a_telephone_in_light_and_in_the_dark(tmp_path):
    pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: make setup")
    rows = table([["`jax-aero fly test2`", *["0.001"] * 11]], *(f"heading {n}" for n in range(12)))
    page = f"# Report\n\n{'text ' * 30}\n\n{rows}\n"
    (tmp_path / "report.html").write_text(to_html(page, tmp_path), encoding="utf-8")
    brightness = (
        """of => getComputedStyle(document.body)[of].match(/\\d+/g).slice(0, 3).map(Number).reduce((a, b) => a + b)"""
    )
    with open_chromium() as browser:
        for scheme, lighter, darker in (("light", "backgroundColor", "color"), ("dark", "color", "backgroundColor")):
            telephone = {"viewport": {"width": 390, "height": 844}, "is_mobile": True, "color_scheme": scheme}
            tab = browser.new_page(**telephone)
            tab.set_default_timeout(SLOWEST)
            tab.goto((tmp_path / "report.html").as_uri())
            assert tab.evaluate("innerWidth") == 390
            assert tab.evaluate(OUT_OF_SIGHT) == []
            assert tab.evaluate(brightness, lighter) > 500 > 250 > tab.evaluate(brightness, darker)
