"""Checks the report page of `holescout evaluate` in a browser, without a network.

HOLESCOUT names the binary, HOLESCOUT_DATASET a dataset, CHROMIUM the browser (by default Debian's).
What is missing is an error, never a skipped test.
"""

import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Locator, Page

sys.path.insert(0, str(Path(__file__).parents[1]))
import repeated_dataset  # noqa: E402
from browser import Opened, chromium, close, required, visit  # noqa: E402

STARTS = 20
# What ends nearer to a start than this may lie below its disc.
START_CELLS = 3
WIDTHS = {"desktop": 1280, "phone": 400}


@dataclass(frozen=True)
class Output:
    """What the command wrote."""

    page: Path
    report: dict[str, Any]


@pytest.fixture(scope="session")
def output(tmp_path_factory: pytest.TempPathFactory) -> Output:
    return evaluated(required("HOLESCOUT_DATASET"), tmp_path_factory.mktemp("report") / "eval")


@pytest.fixture(scope="session")
def output_of_repeats(tmp_path_factory: pytest.TempPathFactory) -> Output:
    """A report of maps that tell errors, and of some that do not."""
    root = tmp_path_factory.mktemp("repeated")
    return evaluated(repeated_dataset.build(required("HOLESCOUT"), root), root / "eval")


def evaluated(dataset: Path, out: Path) -> Output:
    binary = required("HOLESCOUT")
    arguments = ["--dataset", dataset, "--out", out, "--split", "all", "--starts", str(STARTS)]
    run = subprocess.run([binary, "evaluate", *arguments], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    return Output(out / "report.html", json.loads((out / "report.json").read_text()))


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    with chromium() as browser:
        yield browser


def open_page(browser: Browser, output: Output, width: int, scheme: str = "light") -> Opened:
    return visit(
        browser,
        output.page.as_uri(),
        width,
        scheme,
        is_allowed=lambda url: url.startswith(("file:", "data:")),
        is_complaint=lambda message: message.type in {"error", "warning"},
    )


@pytest.fixture
def opened(browser: Browser, output: Output) -> Iterator[Opened]:
    """The page on a wide screen; whatever the test does, it must stay quiet and off the network."""
    opened = open_page(browser, output, WIDTHS["desktop"])
    yield opened
    close(opened)


@pytest.fixture
def page(opened: Opened) -> Page:
    return opened.page


def embedded(page: Page) -> dict[str, Any]:
    return json.loads(page.locator("#data").text_content() or "")


def gallery(page: Page) -> list[dict[str, Any]]:
    maps = embedded(page)["gallery"]
    assert maps, "nothing in the gallery"
    return maps


def flights_of(a_map: dict[str, Any], start: int = 0) -> list[dict[str, Any]]:
    return a_map["starts"][start]["flights"]


def pictures(page: Page) -> list[str]:
    return [page.locator(f"#{name}").evaluate("canvas => canvas.toDataURL()") for name in ("heights", "rsrp")]


def set_step(page: Page, step: int) -> None:
    page.locator("#step").evaluate(
        "(slider, step) => { slider.value = step; slider.dispatchEvent(new Event('input')); }", step
    )


def assert_close(shown: str, expected: float | None) -> None:
    """The number that a cell begins with is the expected one, up to its last decimal."""
    first = shown.split()[0] if shown.split() else ""
    if expected is None:
        assert first == "\N{EN DASH}"
    else:
        assert float(first.replace("\N{MINUS SIGN}", "-")) == pytest.approx(expected, abs=6e-4)


def column(page: Page, table: str, key: str) -> list[str]:
    """The texts of a column, in the order shown."""
    heads = page.locator(f"#{table} thead th")
    keys = [heads.nth(index).get_attribute("data-key") for index in range(heads.count())]
    rows = page.locator(f"#{table} tbody tr")
    texts: list[list[str]] = rows.evaluate_all("rows => rows.map(row => [...row.cells].map(cell => cell.textContent))")
    return [row[keys.index(key)] for row in texts]


def full(report: dict[str, Any]) -> list[dict[str, Any]]:
    """The scores over all starts."""
    most = max(score["starts"] for score in report["scores"])
    return [score for score in report["scores"] if score["starts"] == most]


def box(element: Locator) -> dict[str, float]:
    element.scroll_into_view_if_needed()
    bounds = element.bounding_box()
    assert bounds is not None
    return dict(bounds)


# ---------------------------------------------------------------- what is on the page


def test_the_page_carries_the_report(page: Page, output: Output) -> None:
    assert embedded(page)["report"] == output.report
    assert page.title().strip()
    assert "{{" not in page.locator("body").inner_text()
    assert page.locator("#dataset-sha256").inner_text() == output.report["dataset"]["sha256"]
    for text in output.report["dataset"]["attribution"]:
        assert text in page.locator("#attribution").inner_text()


def test_both_charts_show_every_method_and_k(page: Page, output: Output) -> None:
    charts = page.locator("#charts svg.chart")
    assert charts.count() == 2
    # Methods that move have no line for k = 0: it is that of their starts.
    moving = {method["name"] for method in output.report["methods"] if method["multi_step"]}
    pairs = {(score["method"], score["k"]) for score in output.report["scores"]}
    expected = len({(method, k) for method, k in pairs if k > 0 or method not in moving})
    for index in range(2):
        series, entries = charts.nth(index).locator(".series"), charts.nth(index).locator(".legend-entry")
        assert series.count() == entries.count() == expected
        labels = series.evaluate_all("all => all.map(one => one.dataset.label)")
        assert len(set(labels)) == expected


def test_scores_equal_the_report(page: Page, output: Output) -> None:
    scores = full(output.report)
    rows = page.locator("#scores-table tbody tr")
    assert rows.count() == len(scores)
    for score in scores:
        row = page.locator(f'#scores-table tr[data-method="{score["method"]}"][data-k="{score["k"]}"]')
        assert row.count() == 1
        assert row.locator("td").nth(1).inner_text() == str(score["k"])
    for metric in ("precision", "recall"):
        for shown, score in zip(column(page, "scores-table", metric), scores, strict=True):
            assert_close(shown, score[metric] and score[metric]["mean"])
    shares = {(share["method"], share["k"]): share["precision"]["mean"] for share in output.report["oracle_share"]}
    for shown, score in zip(column(page, "scores-table", "share"), scores, strict=True):
        assert_close(shown, shares.get((score["method"], score["k"])))


def test_flights_equal_the_report(page: Page, output: Output) -> None:
    flights = output.report["flights"]
    assert page.locator("#flights-table tbody tr").count() == len(flights)
    for index, flight in enumerate(flights):
        total = sum(flight["found_after"]) + flight["not_found"]
        for hop in range(len(flight["found_after"])):
            shown = column(page, "flights-table", f"after-{hop}")[index]
            assert_close(shown, sum(flight["found_after"][: hop + 1]) / max(1, total))


@pytest.mark.parametrize("metric", ["precision", "recall"])
def test_differences_are_shown_both_ways(page: Page, output: Output, metric: str) -> None:
    page.locator("#difference-metric").select_option(metric)
    for k in sorted({each["k"] for each in output.report["differences"]}):
        page.locator("#difference-k").select_option(str(k))
        cells = page.locator("#differences-table td[data-a]").evaluate_all(
            "cells => cells.map(cell => [cell.dataset.a, cell.dataset.b, cell.textContent, cell.dataset.sure ?? null])"
        )
        shown = {(a, b): (text, sure) for a, b, text, sure in cells}
        here = [each for each in output.report["differences"] if each["k"] == k and each[metric]]
        assert len(shown) == 2 * len(here)
        for each in here:
            a, b, value = each["a"], each["b"], each[metric]
            for pair, sign in (((a, b), 1), ((b, a), -1)):
                text, sure = shown[pair]
                assert_close(text, sign * value["mean"])
                ends = sorted((sign * value["low"], sign * value["high"]))
                assert sure == ("better" if ends[0] > 0 else "worse" if ends[1] < 0 else None)


def test_groups_and_difficulty_equal_the_report(page: Page, output: Output) -> None:
    groups = output.report["groups"]
    for kind in {group["kind"] for group in groups}:
        page.locator("#group-kind").select_option(kind)
        expected = [group["name"] for group in groups if group["kind"] == kind]
        assert column(page, "groups-table", "name") == expected
    cells = page.locator("#difficulty .bar").evaluate_all("bars => bars.map(bar => Number(bar.dataset.cells))")
    difficulty = output.report["difficulty"]
    assert cells == [*difficulty["cells_by_hops"], difficulty["unreachable"]]


def test_holes_by_distance_equal_the_report(page: Page, output: Output) -> None:
    bins = output.report["distances"]
    assert page.locator("#distance-chart svg.chart .series").count() == 1
    for shown, each in zip(column(page, "distance-table", "hole_share"), bins, strict=True):
        assert_close(shown, each["hole_share"] and each["hole_share"]["mean"])
    # The toggles of methods leave the chart alone.
    page.locator("#chart-methods button[data-all=off]").click()
    assert page.locator("#distance-chart .series.hidden").count() == 0


def test_that_nothing_is_known_of_labels_is_told(page: Page) -> None:
    assert page.locator("#labels-unknown").is_visible()
    assert not page.locator("#scores-errors").is_visible()
    assert page.locator('#scores-table th[data-key="expected_precision"]').count() == 0


def test_labels_equal_the_report(browser: Browser, output_of_repeats: Output) -> None:
    opened = open_page(browser, output_of_repeats, WIDTHS["desktop"])
    page, report = opened.page, output_of_repeats.report
    scores, ceiling = full(report), report["labels"]["ceiling"]
    assert len(ceiling) == len(report["evaluate"]["steps"])
    for metric in ("precision", "expected_precision"):
        for shown, score in zip(column(page, "scores-table", metric), [*scores, *ceiling], strict=True):
            assert_close(shown, score[metric] and score[metric]["mean"])
    for metric in ("sure_holes", "sure"):
        shown = column(page, "scores-table", metric)
        assert_close(shown[0], scores[0][metric]["mean"])
        assert shown[-1] == "\N{EN DASH}", "the ceiling has none"
    assert page.locator('#scores-table tr[data-method="Label ceiling"]').count() == len(ceiling)
    assert "8 repeats" in page.locator("#labels-facts").inner_text()
    assert not page.locator("#labels-unknown").is_visible()
    assert page.locator("#distance-chart svg.chart .series").count() == 2
    page.locator("#difference-metric").select_option("expected_precision")
    assert page.locator("#differences-table td[data-a]").count() > 0
    page.context.close()
    assert opened.complaints == [] and opened.requests == []


# ---------------------------------------------------------------- what can be done with it


def test_sorting_works_both_ways(page: Page, output: Output) -> None:
    scores = full(output.report)
    head = page.locator('#scores-table th[data-key="precision"]')
    for order, reverse in (("descending", True), ("ascending", False)):
        head.locator("button").click()
        assert head.get_attribute("aria-sort") == order
        expected = sorted((score["precision"]["mean"] for score in scores), reverse=reverse)
        for shown, mean in zip(column(page, "scores-table", "precision"), expected, strict=True):
            assert_close(shown, mean)
    page.locator('#scores-table th[data-key="k"] button').press("Enter")
    assert head.get_attribute("aria-sort") is None
    shown_k = [int(text) for text in column(page, "scores-table", "k")]
    assert shown_k == sorted((score["k"] for score in scores), reverse=True)


def test_charts_can_be_filtered_and_highlighted(page: Page, output: Output) -> None:
    chart = page.locator("#charts svg.chart").first
    method = output.report["methods"][0]["name"]
    visible = chart.locator(".series:visible").count()
    page.locator(f'#chart-methods input[data-value="{method}"]').uncheck()
    hidden = len({score["k"] for score in output.report["scores"] if score["method"] == method})
    assert chart.locator(".series:visible").count() == visible - hidden
    page.locator(f'#chart-methods input[data-value="{method}"]').check()
    entry = chart.locator(".legend-entry").nth(1)
    entry.press("Enter")
    assert entry.get_attribute("aria-pressed") == "true"
    assert chart.locator(".series.faded").count() == visible - 1
    entry.press("Enter")
    page.mouse.move(0, 0)
    assert chart.locator(".series.faded").count() == 0


def test_another_map_and_start_are_another_picture(page: Page) -> None:
    maps = gallery(page)
    assert page.locator("#maps button").count() == len(maps)
    first = pictures(page)
    starts = page.locator("#starts button")
    assert starts.count() == len(maps[0]["starts"])
    if starts.count() > 1:
        starts.nth(1).click()
        assert starts.nth(1).get_attribute("aria-pressed") == "true"
        assert all(before != after for before, after in zip(first, pictures(page), strict=True))
    if len(maps) > 1:
        page.locator("#maps button").nth(1).click()
        assert all(before != after for before, after in zip(first, pictures(page), strict=True))
        page.locator("#maps button").first.click()
        assert pictures(page) == first


def test_a_click_chooses_the_nearest_start(page: Page) -> None:
    a_map = gallery(page)[0]
    canvas = page.locator("#rsrp")
    for index in reversed(range(len(a_map["starts"]))):
        row, col = flights_of(a_map, index)[0]["path"][0]
        bounds = box(canvas)
        cell = bounds["width"] / a_map["cells"]
        canvas.click(position={"x": (col + 0.5) * cell, "y": (row + 0.5) * cell})
        assert page.locator(f'#starts button[data-start="{index}"]').get_attribute("aria-pressed") == "true"


def test_the_slider_draws_the_flights(page: Page) -> None:
    flights = flights_of(gallery(page)[0])
    last = max(len(flight["path"]) - 1 for flight in flights)
    assert last > 0, "no method moves"
    assert page.locator("#step").get_attribute("max") == str(last)
    rows = page.locator("#step-table tbody tr")
    seen = []
    for step in range(last + 1):
        set_step(page, step)
        seen.append(pictures(page)[0])
        assert rows.count() == len(flights)
        for index, flight in enumerate(flights):
            texts = rows.nth(index).locator("td").all_inner_texts()
            shown = [text for text in texts[: last + 1] if text]
            assert len(shown) == min(step + 1, len(flight["rsrp_dbm"]))
            for text, level in zip(shown, flight["rsrp_dbm"], strict=False):
                assert float(text.replace("\N{MINUS SIGN}", "-")) == pytest.approx(level, abs=0.06)
    # Later on, what is left may be stuck, or fly below others.
    paths = [flight["path"] for flight in flights]
    moved = min(step for path in paths for step, point in enumerate(path) if point != path[0])
    assert seen[moved] != seen[0], "the first move is not drawn"
    assert seen[-1] != seen[0], "the last move is not drawn"
    for index, flight in enumerate(flights):
        outcome = rows.nth(index).locator("td").last.inner_text()
        assert outcome.startswith("found" if flight["found"] else "not found")


def test_each_flight_ends_where_the_report_says(page: Page) -> None:
    a_map = gallery(page)[0]
    # Read from a copy: reading changes how the browser keeps a canvas.
    pixel = """(canvas, [x, y]) => {
      const copy = new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true });
      copy.drawImage(canvas, Math.floor(x), Math.floor(y), 1, 1, 0, 0, 1, 1);
      return [...copy.getImageData(0, 0, 1, 1).data.slice(0, 3)];
    }"""
    color = "swatch => getComputedStyle(swatch).backgroundColor.match(/\\d+/g).map(Number)"
    checked = 0
    for flight in flights_of(a_map):
        last = flight["path"][-1]
        if max(abs(last[axis] - flight["path"][0][axis]) for axis in range(2)) < START_CELLS:
            continue
        page.locator('#gallery-methods button[data-all="off"]').click()
        toggle = page.locator(f'#gallery-methods input[data-value="{flight["method"]}"]')
        toggle.check()
        expected = toggle.locator("xpath=..").locator(".swatch").evaluate(color)
        for name in ("heights", "rsrp"):
            canvas = page.locator(f"#{name}")
            side = canvas.evaluate("canvas => canvas.width") / a_map["cells"]
            place = [(last[1] + 0.5) * side, (last[0] + 0.5) * side]
            assert canvas.evaluate(pixel, place) == expected, flight["method"]
        checked += 1
    assert checked > 0, "no method moves"


def test_play_reaches_the_end(page: Page) -> None:
    last = int(page.locator("#step").get_attribute("max") or 0)
    finished = pictures(page)
    page.locator("#play").click()
    assert page.locator("#step").input_value() == "0"
    assert pictures(page) != finished
    page.wait_for_function(
        """last => document.getElementById("play").textContent === "Play"
             && Number(document.getElementById("step").value) === last""",
        arg=last,
    )
    assert pictures(page) == finished


def test_a_method_can_be_hidden(page: Page) -> None:
    flight = max(flights_of(gallery(page)[0]), key=lambda flight: len(flight["path"]))
    before = pictures(page)
    toggle = page.locator(f'#gallery-methods input[data-value="{flight["method"]}"]')
    toggle.uncheck()
    assert all(old != new for old, new in zip(before, pictures(page), strict=True))
    assert "off" in (page.locator(f'#step-table tr[data-method="{flight["method"]}"]').get_attribute("class") or "")
    toggle.check()
    assert pictures(page) == before


def test_the_readout_tells_the_cell(page: Page) -> None:
    canvas = page.locator("#heights")
    bounds = box(canvas)
    canvas.hover(position={"x": bounds["width"] / 2, "y": bounds["height"] / 2})
    middle = gallery(page)[0]["cells"] // 2
    assert page.locator("#readout").inner_text().startswith(f"Row {middle}, column {middle}: ")
    page.mouse.move(0, 0)
    canvas.press("ArrowRight")
    assert page.locator("#readout").inner_text().startswith(f"Row {middle}, column {middle + 1}: ")


# ---------------------------------------------------------------- how it looks


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", WIDTHS.values(), ids=WIDTHS.keys())
def test_it_fits_and_has_contrast(browser: Browser, output: Output, width: int, scheme: str) -> None:
    opened = open_page(browser, output, width, scheme)
    page = opened.page
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    colors = (
        "['color', 'backgroundColor'].map(name => getComputedStyle(document.body)[name].match(/\\d+/g).map(Number))"
    )
    ink, paper = (sum(channels[:3]) / 3 for channels in page.evaluate(colors))
    assert (ink > 200 and paper < 60) if scheme == "dark" else (ink < 60 and paper > 200)
    assert all(picture.startswith("data:image/png") for picture in pictures(page))
    page.context.close()
    assert opened.complaints == []
    assert opened.requests == []
