"""Pages in a browser, without a network: what the tests of pages share.

CHROMIUM is the browser (by default Debian's). What is missing is an error, never a skipped test.
"""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Page, Route, sync_playwright

ARGUMENTS = [
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]


@dataclass
class Opened:
    """The page in the browser, and what it should not have done."""

    page: Page
    complaints: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)


def required(name: str) -> Path:
    """The path that a variable of the environment names."""
    value = os.environ.get(name)
    if not value:
        pytest.fail(f"set {name}", pytrace=False)
    path = Path(value)
    if not path.exists():
        pytest.fail(f"{name}: {path} does not exist", pytrace=False)
    return path.resolve()


@contextmanager
def chromium() -> Iterator[Browser]:
    os.environ.setdefault("CHROMIUM", "/usr/bin/chromium")
    executable = required("CHROMIUM")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=ARGUMENTS)
        yield browser
        browser.close()


def visit(
    browser: Browser,
    url: str,
    width: int,
    scheme: str,
    is_allowed: Callable[[str], bool],
    is_complaint: Callable[[ConsoleMessage], bool],
) -> Opened:
    """Opens a page; requests of addresses that are not allowed fail, and are kept with what it complains of."""
    context = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme)
    opened = Opened(context.new_page())

    def only_allowed(route: Route) -> None:
        if is_allowed(route.request.url):
            route.continue_()
        else:
            opened.requests.append(route.request.url)
            route.abort()

    def listen(message: ConsoleMessage) -> None:
        if is_complaint(message):
            opened.complaints.append(message.text)

    context.route("**/*", only_allowed)
    opened.page.on("console", listen)
    opened.page.on("pageerror", lambda error: opened.complaints.append(str(error)))
    opened.page.goto(url)
    return opened


def close(opened: Opened) -> None:
    """The page must have stayed quiet and off the network."""
    opened.page.context.close()
    assert opened.complaints == []
    assert opened.requests == []
