"""The browser that tests look at pages with."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

CHROMIUM = next((path for name in ("chromium", "chromium-browser") if (path := shutil.which(name))), None)
SWITCHES = (
    "--no-sandbox",
    "--use-angle=swiftshader",  # WebGL in software
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
SLOWEST = 180_000  # ms, on a busy machine without a graphics processor


@contextmanager
def open_chromium() -> Iterator[Any]:
    """Playwright's browser, without a window. Contexts and pages need `SLOWEST` as their default timeout."""
    from playwright import sync_api

    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(SWITCHES), timeout=SLOWEST)
        yield browser
        browser.close()


class Page:
    """A page in a tab, and what the tab had to complain about or asked for."""

    def __init__(self, tab: Any, url: str, ready: str) -> None:
        self.tab = tab
        self.complaints: list[str] = []
        self.requests: list[str] = []
        tab.on("console", lambda message: self.complaints.append(message.text) if message.type == "error" else None)
        tab.on("pageerror", lambda error: self.complaints.append(str(error)))
        tab.on("request", lambda request: self.requests.append(request.url))
        tab.goto(url)
        self.wait(ready)

    def wait(self, condition: str) -> None:
        self.tab.wait_for_function(condition)
