"""What the site does beyond Markdown: it shows a notebook, and gives pages with wide tables the whole width."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

NOTEBOOK = re.compile(r"<!-- notebook: (?P<path>\S+) -->")


WIDE = {"equations.md", "deviations.md"}


def on_page_markdown(markdown: str, *, page: Any, config: Any, **_: Any) -> str:
    """Replace a line `<!-- notebook: PATH -->` by the cells and outputs of that notebook."""
    if page.file.src_path in WIDE:
        page.meta["hide"] = ["navigation", "toc"]
    return NOTEBOOK.sub(lambda found: render(Path(config["docs_dir"]) / found["path"]), markdown)


def render(path: Path) -> str:
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
