"""Pages: a template makes Markdown, and HTML is the same text with its pictures, by a library of CommonMark.

Texts come from files too, so they are never HTML, and their links lead to files beside the page alone, or within it.
"""

from __future__ import annotations

import base64
import html
import io
import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import jinja2
from markdown_it import MarkdownIt
from markdown_it.token import Token

from jax_aero.results.table import markdown_table

ELSEWHERE = r"\s*(?:[^/)]*:|[/\\])"
"""Beginning of a link that is no relative path."""

TONES = {"agrees": "good", "differs": "bad", "error": "bad", "out": "open", "outdated": "open"}
"""Colours of verdicts, by their first words; what agrees in part is neither good nor bad."""


class Block(str):
    """Markdown of several lines, made here."""


def literal(text: str) -> str:
    """Return a text of a file as one that is shown as it stands, whatever its characters mean in Markdown.

    >>> literal("[a](b) `c` & **d**")
    '&#91;a&#93;(b) &#96;c&#96; &#38; &#42;&#42;d&#42;&#42;'
    """
    return re.sub(r"[\\`*\[\]<>|&~!]|\b_|_\b", lambda match: f"&#{ord(match[0])};", " ".join(text.split()))


def inline(text: object) -> str:
    """Return a text as a line of Markdown without HTML, whose links lead nowhere else."""
    if isinstance(text, Block):
        return text
    line = re.sub(rf"\]\((?={ELSEWHERE})", "] (", " ".join(str(text).split()))
    # Within code, `<` is a letter. Other backticks than pairs of single ones may mean something else to a reader.
    parts = [line] if "``" in line or "\\`" in line or line.count("`") % 2 else line.split("`")
    return "`".join(part if index % 2 else part.replace("<", "&lt;") for index, part in enumerate(parts))


def table(rows: Iterable[Sequence[str]], *headings: str) -> Block:
    """Return a table below its headings."""
    return Block(markdown_table([[inline(cell) for cell in row] for row in (headings, *rows)]))


TEMPLATES = jinja2.Environment(
    loader=jinja2.FileSystemLoader(Path(__file__).with_name("templates")),
    finalize=inline,
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)
TEMPLATES.filters |= {"table": table, "literal": literal}


def markdown(template: str, **values: object) -> str:
    """Return a page of Markdown, whose parts are a blank line apart."""
    return re.sub(r"\n{3,}", "\n\n", TEMPLATES.get_template(template).render(values))


def to_html(page: str, folder: Path) -> str:
    """Return a page of Markdown as one HTML file that holds its pictures, which lie in `folder`."""
    reader = MarkdownIt("commonmark", {"html": False}).enable("table")
    reader.add_render_rule("table_open", lambda *_: '<div class="table"><table>\n')
    reader.add_render_rule("table_close", lambda *_: "</table></div>\n")
    tokens = reader.parse(page)
    images = [str(one.attrs["src"]) for token in tokens for one in token.children or () if one.type == "image"]
    pictures = {path for path in images if (folder / path).is_file() and not re.match(ELSEWHERE, path)}
    titles: list[str] = []
    cells, parts = 0, []
    for before, token in pairwise(tokens):
        if before.type == "heading_open":
            before.attrSet("id", _anchor(token.content))
            parts += [(_anchor(token.content), token.content)] if before.tag == "h2" else []
        elif before.type == "thead_open":
            titles = []
        elif before.type == "tr_open":
            cells = 0
        elif before.type == "th_open":
            titles.append(token.content)
        elif before.type == "td_open":
            before.attrSet("data-of", titles[cells])
            cells += 1
        if token.children is not None:
            token.children = list(_within(token.children, folder, pictures))
    body = Block(reader.renderer.render(tokens, reader.options, {}))
    return TEMPLATES.get_template("page.html").render(title=tokens[1].content, parts=parts, body=body)


def _within(children: Sequence[Token], folder: Path, pictures: set[str]) -> Iterator[Token]:
    """Yield the parts of a text: a link leads to a picture of the page, since nothing else is sent with it."""
    leads = False
    for place, token in enumerate(children):
        if token.type == "link_open":
            leads = (path := str(token.attrs["href"])) in pictures
            token.attrSet("href", f"#{_anchor(path)}")
        elif token.type == "image":
            if (path := str(token.attrs["src"])) not in pictures:
                continue
            token.attrSet("id", _anchor(path))
            token.attrSet("src", _embed(folder / path))
        elif token.type == "strong_open":
            verdict = children[place + 1].content
            word = re.split(r"\W", verdict, maxsplit=1)[0]
            token.attrSet("class", "open" if word == "agrees" != verdict else TONES.get(word, ""))
        if leads or token.type not in ("link_open", "link_close"):
            yield token


def _anchor(text: str) -> str:
    return re.sub(r"\W+", "-", html.unescape(text)).strip("-").lower()


def _embed(path: Path) -> str:
    """Return a picture as the address of its own data: WebP without loss, a third of the size of PNG."""
    from PIL import Image

    data = io.BytesIO()
    with Image.open(path) as picture:
        picture.save(data, "WEBP", lossless=True, method=1)
    return f"data:image/webp;base64,{base64.b64encode(data.getvalue()).decode()}"
