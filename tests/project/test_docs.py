"""README and documentation: the site builds without a warning, and links lead to what is there."""

import functools
import os
import pkgutil
import re
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import nbformat
import pytest
from mkdocs.config import load_config
from mkdocs.structure.files import Files
from nbclient import NotebookClient
from traitlets.config import Config

import jax_aero
from docs import hooks
from experiments.report.page import table, to_html
from jax_aero import air, env, env_gym, rust, sim
from jax_aero.commands import study as studies
from jax_aero.stored import kept
from tests.browser import CHROMIUM, SLOWEST, open_chromium

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
README = ROOT / "README.md"
PAGES = [README, *sorted(DOCS.rglob("*.md")), *sorted(studies.FOLDER.glob("*/README.md"))]
FENCE = re.compile(r"(?:<!-- test: (?P<how>[^>]+?) -->\n)?^```(?P<language>\w+)\n(?P<code>.*?)^```$", re.M | re.S)
OTHERS = [
    *(ROOT / f"{title}.md" for title in ("CHANGELOG", "CONTRIBUTING", "SECURITY")),
    *sorted(path for folder in ("configs", "tests") for path in (ROOT / folder).rglob("README.md")),
]


def name(path: Path) -> str:
    return str(path.relative_to(ROOT))


def run(command: list[str], environment: dict[str, str] | None = None, folder: Path = ROOT) -> None:
    answer = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=600
    )
    assert answer.returncode == 0, answer.stdout + answer.stderr


def test_the_architecture_page_names_every_module_of_the_core_crate():
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    named = set(re.findall(r"^\| `(\w+)` \|", page, re.M))
    assert named == {path.stem for path in (ROOT / "rust/core/src").glob("*.rs")} - {"lib"}


def test_links_to_studies_vanish_with_them(monkeypatch):
    text = "[one](../../experiments/studies/design/README.md#what) of [all](../../experiments/studies)"
    assert hooks.link_site(text, "howto/robot.md") == "[one](../studies/design.md#what) of [all](../studies/index.md)"
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
    pictures |= {f"results/{name}.webp" for name in kept.names() if kept.read(name).is_drawn}
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


@pytest.mark.slow
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


def test_a_picture_has_its_text_below():
    image = '<img alt="A fall" class="render" src="fall.png" />'
    assert hooks.on_page_content(f"<p>{image}</p>") == f"<figure>{image}<figcaption>A fall</figcaption></figure>"


@pytest.mark.slow
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


@pytest.mark.slow
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


# Parts that show less than they hold: tables and code. Equations, drawings and what programs print may scroll.
CUT = """() => [...(document.querySelector("article") ?? document.body).querySelectorAll("*")].filter(e =>
    e.clientWidth > 0 && e.scrollWidth > e.clientWidth + 1 && getComputedStyle(e).overflowX != "visible"
    && !e.closest(".formula, .language-text, :has(> img)")
).map(e => `${e.scrollWidth} of ${e.clientWidth} px: ${e.outerHTML.slice(0, 80)}`)"""


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed: apt-get install chromium")
def test_pages_fit_the_screen(site):
    """Of a desk, of a tablet and of a telephone, in light and in the dark."""
    pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: make setup")
    found = []
    with open_chromium() as browser:
        tab = browser.new_page()
        tab.set_default_timeout(SLOWEST)
        for page in sorted(site.rglob("index.html")):
            tab.goto(page.as_uri())
            for scheme, of_theme in {"light": "default", "dark": "slate"}.items():
                tab.emulate_media(color_scheme=scheme)
                tab.evaluate("scheme => { document.body.dataset.mdColorScheme = scheme }", of_theme)
                for width in (1280, 800, 390):
                    tab.set_viewport_size({"width": width, "height": 50})  # what is not in sight is not painted
                    parts = [*tab.evaluate(OUT_OF_SIGHT), *tab.evaluate(CUT)]
                    found += [f"{page.relative_to(site)}, {scheme}, at {width} px: {part}" for part in parts]
    assert found == []


@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed: apt-get install chromium")
def test_a_table_that_is_cut_is_found(tmp_path):
    """The measures refuse wrong pages: with a table in a box that scrolls, and with one beyond the screen."""
    pytest.importorskip("playwright.sync_api", reason="Playwright is not installed: make setup")
    wide = '<table><tr><td><div style="width: 900px">wide</div></td></tr></table>'
    with open_chromium() as browser:
        tab = browser.new_page(viewport={"width": 800, "height": 900})
        for text, cut, beyond in (
            (f'<div style="overflow-x: auto">{wide}</div>', True, False),
            (wide, False, True),
            (f'<div class="formula" style="overflow-x: auto">{wide}</div>', False, False),
            ("<table><tr><td>narrow</td></tr></table>", False, False),
        ):
            (tmp_path / "page.html").write_text(f"<body><article>{text}</article></body>", encoding="utf-8")
            tab.goto((tmp_path / "page.html").as_uri())
            assert bool(tab.evaluate(CUT)) is cut, text
            assert bool(tab.evaluate(OUT_OF_SIGHT)) is beyond, text


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
