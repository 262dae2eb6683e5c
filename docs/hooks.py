"""What the site does beyond Markdown: pages made from the code, equations, notebooks, wide tables."""

from __future__ import annotations

import json
import posixpath
import re
from itertools import cycle, pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from latex2mathml.converter import convert
from mkdocs.structure.files import File
from mkdocs.utils import get_relative_url

from experiments.report import command, stored
from experiments.tools import schema
from jax_aero import rust
from jax_aero.commands import study as studies
from jax_aero.figures import drawings
from jax_aero.stored import kept
from jax_aero.sweep import columns

EQUATION = re.compile(r"^```math\n(?P<latex>.*?)^```$", re.MULTILINE | re.DOTALL)
INLINE = re.compile(
    r"""^```.*?^```$ | `[^`\n]+`            # code, in which a dollar is one
    | \$(?P<latex>(?:[^$\n]|\n(?!\s*\n))+)\$  # within a paragraph""",
    re.MULTILINE | re.DOTALL | re.VERBOSE,
)
NUMBER = re.compile(r"\\tag\{(?P<number>M\d+)\}")
CODE = re.compile(r"^Code: (?P<places>.*)$", re.MULTILINE)
MODEL = "model"
"""Folder of the pages that hold the equations."""
WIDE = {"deviations.md", "paper.md"}
README = Path(__file__).resolve().parents[1] / "README.md"
LAB = Path(__file__).resolve().parents[1] / "target/lab"
"""The flight lab, if `make lab` has built it."""
LAB_PAGE = "look/fly/index.html"
TABLE = re.compile("<table>.*?</table>", re.DOTALL)
HEADING = re.compile("<th[^>]*>(.*?)</th>", re.DOTALL)
WIDE_TABLE = 4
"""Least number of columns of a table that a telephone shows as cards."""
PICTURE = re.compile(r"(?P<shown>!\[[^\]]*\])\((?P<path>\w+\.png)\)")
ALONE = re.compile(r'<p>(<img alt="([^"]+)"[^>]*>)</p>')
SECTION = re.compile(r'^--8<-- "README\.md:(?P<name>\w+)"$', re.MULTILINE)
LINK = re.compile(r"\[(?P<text>[^\]]+)\]\((?P<path>[^):#\s]+)(?P<part>#[^)]*)?\)")
NOTEBOOKS = sorted(Path(__file__).parent.glob("notebooks/*.ipynb"))
SITE = {
    "experiments/studies": "studies/index.md",
    "experiments/report/paper.py": "paper.md",
    "configs/schema": schema.PAGE,
    "jax_aero/sweep/columns.py": columns.PAGE,
    "docs/results": "results/index.md",
} | {f"docs/notebooks/{path.name}": f"notebooks/{path.stem}.md" for path in NOTEBOOKS}
SITE |= {f"docs/results/{name}.json": f"results/{name}.md" for name in kept.names()}
SITE |= {f"rust/{crate}/src/lib.rs": f"rust/flight_{crate}/index.html" for crate in ("core", "io", "sim")}
"""Pages of the site, by the file or folder of a clone that they are made from, which pages link."""
INDEX = (
    "Questions beyond single flights, each in a folder of its own in `experiments/studies`, which can be deleted or "
    "[copied](../experiments.md#a-study). `jax-aero study NAME` answers one, `jax-aero study NAME --help` says "
    "how; results go to `results/NAME/`."
)

TIGHT = {"|", "\u2016", "/"}
"""Operators without space around them."""


def on_config(config: Any) -> Any:
    """Add the pages of every study and of every kept result to the navigation."""
    results = next(section["Results"] for section in config["nav"] if "Results" in section)
    listed = {title: pages for entry in results for title, pages in entry.items()}
    listed["Studies"].extend(f"studies/{name}.md" for name in studies.names())
    listed["Stored results"].extend({name.replace("_", " "): f"results/{name}.md"} for name in kept.names())
    return config


def on_files(files: Any, *, config: Any) -> Any:
    """Add the pages that follow from code, records and notebooks, which are not stored, and pictures."""
    for path, text in generated().items():
        files.append(File.generated(config, path, content=text))
    for name in filter(lambda name: kept.read(name).is_drawn, kept.names()):
        drawn = drawings.draw_small(kept.read(name).sweep)
        files.append(File.generated(config, f"results/{name}.webp", content=drawn))
    for picture in pictures():
        path = f"studies/{picture.parent.name}/{picture.name}"
        files.append(File.generated(config, path, abs_src_path=str(picture)))
    for part in lab_files():
        place = Path(LAB_PAGE).parent / part.relative_to(LAB)
        files.append(File.generated(config, place.as_posix(), abs_src_path=str(part)))
    return files


def lab_files() -> list[Path]:
    """Return the files of the flight lab, none if it is not built."""
    return sorted(path for path in LAB.rglob("*") if path.is_file())


def embedded_lab(page: str) -> str:
    """Return what shows the flight lab in the page with this address, loaded when it is opened."""
    if not lab_files():
        return ""
    address = get_relative_url(LAB_PAGE, page)
    return (
        f'<details class="lab"><summary>Fly here</summary><iframe src="{address}" title="Flight lab" loading="lazy">'
        f'</iframe></details>\n\n<a href="{address}">Open the flight lab</a>: the same simulator in a page of its own.'
    )


def pictures() -> list[Path]:
    """Return the pictures of all studies."""
    return sorted(studies.FOLDER.glob("*/*.png"))


def generated() -> dict[str, str]:
    """Return the pages that are not stored, by path."""
    pages = {"paper.md": command.index(), schema.PAGE: schema.reference(rust.schemas()), columns.PAGE: columns.page()}
    rows = [f"| [{name}]({name}.md) | {studies.about(name)} |" for name in studies.names()]
    pages["studies/index.md"] = "\n".join(
        ["# Studies", "", INDEX, "", "| `jax-aero study` | answers |", "|---|---|", *rows, ""]
    )
    pages |= {f"results/{name}": text for name, text in stored.pages().items()}
    pages |= {f"notebooks/{path.stem}.md": notebook(path) for path in NOTEBOOKS}
    return pages | {f"studies/{name}.md": study_page(name) for name in studies.names()}


def study_page(name: str) -> str:
    """Return the page of a study: its README, with links and pictures as they lie in the site."""
    text = (studies.FOLDER / name / "README.md").read_text(encoding="utf-8")
    return PICTURE.sub(rf"\g<shown>({name}/\g<path>)", text.replace("](../../../docs/", "](../"))


def section_of_readme(include: re.Match[str]) -> str:
    """Return a section of the README, whose links start at the root of a clone."""
    marker = "<!-- --8<-- [{}:{}] -->\n"
    text = README.read_text(encoding="utf-8")
    _, text = text.split(marker.format("start", include["name"]))
    text, _ = text.split(marker.format("end", include["name"]))
    return text.replace("](docs/", "](")


def link_site(markdown: str, page: str) -> str:
    """Return a page, whose links lead to files of a clone, with those of the site; `page` is its path in `docs/`.

    Of links to a study that is not there the text stays.
    """

    def moved(link: re.Match[str]) -> str:
        place = posixpath.normpath(posixpath.join("docs", posixpath.dirname(page), link["path"]))
        study = re.fullmatch(r"experiments/studies/(\w+)/README\.md", place)
        if study and study[1] not in studies.names():
            return link["text"]
        target = f"studies/{study[1]}.md" if study else SITE.get(place)
        if target is None:
            return link[0]
        # Addresses that are no page's are relative to the folder that a page becomes.
        folder = posixpath.dirname(page) if target.endswith(".md") else page.removesuffix(".md")
        return f"[{link['text']}]({posixpath.relpath(target, folder or '.')}{link['part'] or ''})"

    return LINK.sub(moved, markdown)


def on_page_markdown(markdown: str, *, page: Any, config: Any, **_: Any) -> str:
    """Typeset equations, put the lab in place of its comment, link `[M12]` to its equation."""
    docs = Path(config["docs_dir"])
    markdown = SECTION.sub(section_of_readme, markdown)
    if page.file.src_path in WIDE:
        page.meta["hide"] = ["navigation", "toc"]
    elif page.file.src_path.startswith("results/"):
        page.meta["hide"] = ["toc"]
    markdown = EQUATION.sub(lambda match: numbered_equation(match["latex"]), markdown)
    markdown = INLINE.sub(inline_formula, markdown)
    markdown = CODE.sub(r'<div class="places" markdown>\g<places></div>', markdown)
    markdown = markdown.replace("<!-- lab -->", embedded_lab(page.url))
    links = [
        f"[{number}]: /{MODEL}/{path.name}#{number.lower()}"
        for path in sorted((docs / MODEL).glob("*.md"))
        for number in NUMBER.findall(path.read_text(encoding="utf-8"))
    ]
    markdown = link_site(markdown, page.file.src_uri)
    return "\n".join([markdown, "", *links])


def on_page_content(html: str, **_: Any) -> str:
    """Name the column in every cell of a wide table, a card on a narrow screen; put its text under a picture, too."""
    html = ALONE.sub(r"<figure>\1<figcaption>\2</figcaption></figure>", html)
    return TABLE.sub(lambda table: cards(table[0]), html)


def cards(table: str) -> str:
    """Return a table of more columns than fit a telephone with the heading of each cell."""
    headings = [re.sub("<[^>]+>", "", heading).replace('"', "&quot;") for heading in HEADING.findall(table)]
    if len(headings) < WIDE_TABLE:
        return table
    names = cycle(headings)
    return re.sub("<td", lambda _: f'<td data-of="{next(names)}"', table.replace("<table>", "<table data-wide>"))


def inline_formula(found: re.Match[str]) -> str:
    """Return a formula in a line as HTML, and code as it is."""
    return found[0] if found["latex"] is None else f"<span>{mathml(found['latex'], 'inline')}</span>"


def numbered_equation(latex: str) -> str:
    """Return a displayed equation as HTML, its number at the right if it has one."""
    found = NUMBER.search(latex)
    formula = f'<div class="formula">{mathml(NUMBER.sub("", latex), "block")}</div>'
    if found is None:
        return f'<div class="equation">{formula}</div>\n'
    number = found["number"]
    anchor = number.lower()
    return f'<div class="equation" id="{anchor}">{formula}<a class="number" href="#{anchor}">({number})</a></div>\n'


def mathml(latex: str, display: str) -> str:
    """Return LaTeX as MathML, which browsers typeset themselves: the page loads nothing from other hosts."""
    # The converter supports `aligned` under another name.
    root = ElementTree.fromstring(convert(latex.replace("{aligned}", "{split}"), display=display))
    for element in root.iter():
        element.tag = element.tag.partition("}")[2]
    for element in root.iter():
        text = element.text or ""
        if element.tag == "mover":
            element.set("accent", "true")  # nothing but accents stands above a letter here
        elif element.tag == "mo" and text in TIGHT:
            element.set("lspace", "0")
            element.set("rspace", "0")
        elif element.tag == "mo" and len(text) > 1 and text.isalpha():
            element.tag = "mi"  # a function's name, not an operator with space on both sides
    for element in list(root.iter()):
        space_functions(element)
    return ElementTree.tostring(root, encoding="unicode").replace("*", "&#42;")  # a star is emphasis in Markdown


def space_functions(row: ElementTree.Element) -> None:
    """Put a thin space between the name of a function and a neighbour that is not an operator."""
    if row.tag not in ("mrow", "mtd", "math"):
        return
    for position, (left, right) in reversed(list(enumerate(pairwise(row), start=1))):
        near_function = is_function(left) or is_function(right)
        if near_function and left.tag not in ("mo", "mspace") and right.tag not in ("mo", "mspace"):
            row.insert(position, ElementTree.Element("mspace", width="0.17em"))


def is_function(element: ElementTree.Element) -> bool:
    """Whether this is the name of a function, perhaps with an exponent."""
    name = element[0] if element.tag in ("msup", "msub") else element
    return name.tag == "mi" and len(name.text or "") > 1


def notebook(path: Path) -> str:
    """Return a notebook as Markdown, pictures included."""
    parts = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        text = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(text)
            continue
        parts.append(f"```python\n{text}\n```")
        parts += [shown for output in cell["outputs"] if (shown := show(output))]
    return "\n\n".join(parts)


def show(output: dict[str, Any]) -> str:
    """Return one output of a cell as Markdown: a picture if there is one, else its text."""
    data = output.get("data", {})
    if "image/png" in data:
        return f'<img alt="Figure of this cell" src="data:image/png;base64,{"".join(data["image/png"]).strip()}">'
    text = "".join(data.get("text/plain", output.get("text", ""))).rstrip()
    return f"```text\n{text}\n```" if text else ""
