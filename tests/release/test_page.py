"""Checks the page of a release, index.html, in a browser, without a network.

RELEASE names the directory of a release; without it, one is made by HOLESCOUT of HOLESCOUT_DATASET. CHROMIUM is the
browser (by default Debian's). What is missing is an error, never a skipped test.
"""

import base64
import json
import os
import subprocess
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page

sys.path.insert(0, str(Path(__file__).parents[1]))
from browser import Opened, chromium, close, required, visit  # noqa: E402

VERSION = "1.2.0"
MAX_BYTES = 4_000_000
WIDTHS = {"desktop": 1280, "phone": 360}
# What each colouring counts in.
UNITS = {
    "split": " record",
    "hole_share": "% of outdoor cells",
    "reliability": "% of outdoor cells",
    "height_source": "% of built cells",
}
# Points on the map, every few pixels, at which the pointer tells a record; by the record's name.
SWEEP = """canvas => {
  const [box, found] = [canvas.getBoundingClientRect(), {}];
  for (let y = 4; y < box.height; y += 3) for (let x = 4; x < box.width; x += 3) {
    canvas.dispatchEvent(new PointerEvent("pointermove", { clientX: box.left + x, clientY: box.top + y }));
    const id = document.getElementById("hover").textContent.split(" ")[0];
    if (id) (found[id] ??= []).push([x, y]);
  }
  canvas.dispatchEvent(new PointerEvent("pointerleave"));
  return found;
}"""
# How many colours a canvas has, up to a hundred. Read from a copy: reading changes how the browser keeps a canvas.
COLORS = """canvas => {
  const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true });
  copy.drawImage(canvas, 0, 0);
  const pixels = new Uint32Array(copy.getImageData(0, 0, canvas.width, canvas.height).data.buffer);
  const seen = new Set();
  for (const pixel of pixels) if (seen.add(pixel).size >= 100) break;
  return seen.size;
}"""


@pytest.fixture(scope="module")
def release(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if os.environ.get("RELEASE"):
        return required("RELEASE")
    out = tmp_path_factory.mktemp("page") / "out"
    command = [required("HOLESCOUT"), "release", required("HOLESCOUT_DATASET"), "--version", VERSION]
    subprocess.run([*command, "--date", "2026-07-01", "--out", out, "--quiet"], check=True, capture_output=True)
    return out


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as browser:
        yield browser


def open_page(browser: Browser, release: Path, width: int, scheme: str = "light", hash: str = "") -> Opened:
    home = (release / "index.html").as_uri()
    return visit(
        browser,
        home + hash,
        width,
        scheme,
        is_allowed=lambda url: url.split("#")[0] == home,
        is_complaint=lambda message: True,
    )


@pytest.fixture
def opened(browser: Browser, release: Path) -> Iterator[Opened]:
    """The page on a wide screen; whatever the test does, it must stay quiet and off the network."""
    opened = open_page(browser, release, WIDTHS["desktop"])
    yield opened
    close(opened)


@pytest.fixture
def page(opened: Opened) -> Page:
    return opened.page


def embedded(page: Page) -> dict[str, Any]:
    data = json.loads(page.locator("#data").text_content() or "")
    assert data["records"], "no records"
    return data


def drawn(page: Page) -> dict[str, Any]:
    """A record that the page has the pictures of."""
    return next(record for record in embedded(page)["records"] if record["planes"] is not None)


def listed(page: Page) -> list[str]:
    return page.locator("#list option").evaluate_all("options => options.map(option => option.value)")


def await_record(page: Page, id: str) -> None:
    """Waits until the record is selected, everywhere."""
    page.wait_for_function("id => location.hash === '#' + id", arg=id)
    assert page.locator("#selected").inner_text().startswith(f"{id} ")
    assert id in page.locator("#facts").inner_text()
    if id in listed(page):
        assert page.locator("#list").input_value() == id
    page.wait_for_function(
        """id => document.getElementById("panels").dataset.record === id
             || !document.getElementById("trouble").hidden""",
        arg=id,
    )


def go_to(page: Page, id: str) -> None:
    page.evaluate("id => { location.hash = id; }", id)
    await_record(page, id)


def planes_of(data: dict[str, Any], record: dict[str, Any]) -> dict[str, bytes]:
    raw = zlib.decompress(base64.b64decode(record["planes"]), wbits=-15)
    side = data["detail"]["cells"] ** 2
    assert len(raw) % side == 0
    parts = [raw[at : at + side] for at in range(0, len(raw), side)]
    return dict(zip(data["detail"]["planes"], parts, strict=False))


def picture(page: Page, id: str) -> str:
    return page.locator(f"#{id}").evaluate("canvas => canvas.toDataURL()")


def map_changes_from(page: Page, before: str) -> None:
    page.wait_for_function("before => document.getElementById('map').toDataURL() !== before", arg=before)


def settled(page: Page) -> None:
    """Waits for what is drawn with the next frame."""
    page.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")


# ---------------------------------------------------------------- what is on the page


def test_the_file_is_small_enough(release: Path) -> None:
    assert (release / "index.html").stat().st_size < MAX_BYTES


def test_the_header_tells_what_it_is(page: Page) -> None:
    data = embedded(page)
    header = page.locator("header").inner_text()
    for text in (data["name"], data["version"], data["description"], data["licence"], data["attribution"]):
        assert text in header
    for split in {record["split"] for record in data["records"]}:
        assert f"{sum(record['split'] == split for record in data['records'])} {split}" in header
    assert f"{data['cell_m']:g} m" in header
    assert f"\N{MINUS SIGN}{-data['hole_threshold_dbm']:g} dBm" in header
    assert "nothing here was measured" in header.lower() and "simulations" in header
    assert page.title().strip()
    assert "{{" not in page.locator("body").inner_text()


def test_every_record_is_in_the_list(page: Page) -> None:
    ids = sorted(record["id"] for record in embedded(page)["records"])
    assert listed(page) == ids
    await_record(page, ids[0])


def test_facts_equal_the_data(page: Page) -> None:
    record = embedded(page)["records"][-1]
    go_to(page, record["id"])
    facts = page.locator("#facts").inner_text()
    for share in ("hole_share", "built"):
        assert f"{100 * record[share]:.1f} %" in facts
    assert record["split"] in facts
    assert f"{record['shard']}, frame {record['frame']}" in facts
    assert f"{abs(record['center_lon_lat'][1]):.5f}°" in facts
    assert f"{record['max_height_m']:.1f} m" in facts
    assert page.locator("#command").inner_text() == f"holescout inspect DATASET --id {record['id']}"


@pytest.mark.parametrize("coloring", UNITS)
def test_each_colouring_has_a_legend_with_a_unit(page: Page, coloring: str) -> None:
    settled(page)
    before = picture(page, "map")
    page.locator("#colouring").select_option(coloring)
    assert UNITS[coloring] in page.locator("#legend").inner_text()
    assert page.locator("#legend").locator(".ramp, .swatch").count() > 0
    if coloring != "split":
        map_changes_from(page, before)


def test_every_colouring_is_checked(page: Page) -> None:
    options = page.locator("#colouring option").evaluate_all("options => options.map(option => option.value)")
    assert options == list(UNITS)


def test_canvases_are_not_blank(page: Page) -> None:
    data, record = embedded(page), drawn(page)
    go_to(page, record["id"])
    settled(page)
    planes = planes_of(data, record)
    assert page.locator("#errors").is_visible() == ("errors" in planes)
    for name in ("map", "heights", "levels", "holes", *(["errors"] if "errors" in planes else [])):
        canvas = page.locator(f"#{name}")
        assert canvas.is_visible()
        assert canvas.evaluate(COLORS) >= 3, name
        assert canvas.get_attribute("role") == "img"
        label = canvas.get_attribute("aria-label") or ""
        assert ("record" if name == "map" else record["id"]) in label
    captions = page.locator("#panels figcaption:visible").all_inner_texts()
    assert all(any(unit in caption for unit in (" m", "dBm", "dB")) for caption in captions)
    assert page.locator("#panels figcaption .ramp:visible").count() >= 2


def test_a_record_without_room_names_the_command(page: Page) -> None:
    records = [record for record in embedded(page)["records"] if record["planes"] is None]
    for record in records[:1]:
        go_to(page, record["id"])
        assert f"holescout inspect DATASET --id {record['id']}" in page.locator("#trouble").inner_text()
        assert not page.locator("#panels").is_visible()
    go_to(page, drawn(page)["id"])
    page.wait_for_selector("#panels", state="visible")
    assert not page.locator("#trouble").is_visible()


# ---------------------------------------------------------------- what can be done with it


def test_a_click_on_the_map_selects(page: Page) -> None:
    places = page.locator("#map").evaluate(SWEEP)
    records = {record["id"]: record for record in embedded(page)["records"]}
    assert places and set(places) <= set(records)
    first = page.locator("#list").input_value()
    for id in [id for id in places if id != first][:3]:
        x, y = places[id][len(places[id]) // 2]
        page.locator("#map").hover(position={"x": x, "y": y})
        assert page.locator("#hover").inner_text().startswith(f"{id} ")
        page.locator("#map").click(position={"x": x, "y": y})
        await_record(page, id)
        assert abs(page.evaluate("scrollX")) == 0


def test_the_map_is_north_up(page: Page) -> None:
    places = page.locator("#map").evaluate(SWEEP)
    side = embedded(page)["cells"] * embedded(page)["cell_m"]
    for axis, sign in ((0, 1), (1, -1)):
        at = {
            record["id"]: record["center_m"][axis]
            for record in embedded(page)["records"]
            if record["id"] in places
        }
        order = sorted(at, key=at.__getitem__)
        low, high = order[0], order[-1]
        if at[high] - at[low] > side:
            mean = {id: sum(point[axis] for point in places[id]) / len(places[id]) for id in (low, high)}
            assert sign * (mean[high] - mean[low]) > 0


def test_the_map_can_be_zoomed_and_dragged(page: Page) -> None:
    selected = page.locator("#list").input_value()
    settled(page)
    canvas = page.locator("#map")
    whole = picture(page, "map")
    bounds = canvas.bounding_box()
    assert bounds is not None
    x, y = bounds["x"] + bounds["width"] / 2, bounds["y"] + bounds["height"] / 2

    def drag() -> None:
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 60, y + 40, steps=4)
        page.mouse.up()

    def wheel() -> None:
        page.mouse.move(x, y)
        page.mouse.wheel(0, -300)

    ways = [wheel, drag, lambda: page.locator("#zoom-in").click(), lambda: page.locator("#zoom-out").click()]
    ways += [lambda key=key: canvas.press(key) for key in ("+", "-", "Shift+ArrowUp")]
    for way in ways:
        before = picture(page, "map")
        way()
        map_changes_from(page, before)
    page.locator("#zoom-all").click()
    page.mouse.move(0, 0)
    settled(page)
    assert picture(page, "map") == whole
    assert page.locator("#list").input_value() == selected, "a drag selects nothing"


def test_keys_follow_the_list(page: Page) -> None:
    ids = listed(page)
    await_record(page, ids[0])
    after = 1 % len(ids)
    for key, expected in (("ArrowRight", after), ("ArrowLeft", 0), ("n", after), ("p", 0), ("p", len(ids) - 1)):
        page.keyboard.press(key)
        await_record(page, ids[expected])


def test_keys_follow_the_order_and_the_filter(page: Page) -> None:
    records = {record["id"]: record for record in embedded(page)["records"]}
    page.locator("#order").select_option("hole_share")
    shares = [records[id]["hole_share"] for id in listed(page)]
    assert shares == sorted(shares)
    page.locator("#direction").click()
    shares = [records[id]["hole_share"] for id in listed(page)]
    assert shares == sorted(shares, reverse=True)
    boxes = page.locator("#splits input")
    for index in range(1, boxes.count()):
        boxes.nth(index).uncheck()
    split = boxes.first.get_attribute("value")
    ids = listed(page)
    assert set(ids) == {id for id, record in records.items() if record["split"] == split}
    go_to(page, ids[0])
    page.locator("#next").focus()
    page.keyboard.press("n")
    await_record(page, ids[1 % len(ids)])
    assert set(page.locator("#map").evaluate(SWEEP)) <= set(ids)
    boxes.first.uncheck()
    assert listed(page) == []
    page.locator("#next").press("n")
    await_record(page, ids[1 % len(ids)])


def test_keys_leave_controls_alone(page: Page) -> None:
    first = listed(page)[0]
    await_record(page, first)
    for control in ("#colouring", "#order", "#splits input >> nth=0"):
        for key in ("n", "p", "ArrowLeft"):
            page.locator(control).press(key)
    assert page.locator("#selected").inner_text().startswith(f"{first} ")
    for keys in ("Control+ArrowRight", "Alt+n", "Shift+ArrowRight"):
        page.locator("#next").press(keys)
    assert page.locator("#selected").inner_text().startswith(f"{first} ")


def test_the_list_works_by_keyboard(page: Page) -> None:
    ids = listed(page)
    page.locator("#list").press("ArrowDown")
    await_record(page, ids[min(1, len(ids) - 1)])


def test_the_address_is_kept_both_ways(browser: Browser, release: Path) -> None:
    plain = open_page(browser, release, WIDTHS["desktop"])
    ids = listed(plain.page)
    await_record(plain.page, ids[0])
    go_to(plain.page, ids[-1])
    close(plain)
    linked = open_page(browser, release, WIDTHS["desktop"], hash=f"#{ids[-1]}")
    await_record(linked.page, ids[-1])
    assert not linked.page.locator("#message").is_visible()
    close(linked)


@pytest.mark.parametrize("hash", ["nowhere", "%E0%A4%A", "<b>x</b>"])
def test_an_unknown_address_is_told(browser: Browser, release: Path, hash: str) -> None:
    opened = open_page(browser, release, WIDTHS["desktop"], hash=f"#{hash}")
    page = opened.page
    assert "no record" in page.locator("#message").inner_text()
    ids = listed(page)
    assert page.locator("#selected").inner_text().startswith(f"{ids[0]} ")
    page.keyboard.press("n")
    await_record(page, ids[1 % len(ids)])
    assert not page.locator("#message").is_visible()
    page.evaluate("hash => { location.hash = hash; }", hash)
    page.wait_for_selector("#message", state="visible")
    assert page.locator("#selected").inner_text().startswith(f"{ids[1 % len(ids)]} ")
    close(opened)


def test_the_readout_tells_the_cell(page: Page) -> None:
    data, record = embedded(page), drawn(page)
    go_to(page, record["id"])
    detail, planes = data["detail"], planes_of(data, record)
    side = detail["cells"]
    row, column = side // 3, side // 2
    canvas = page.locator("#levels")
    canvas.scroll_into_view_if_needed()
    bounds = canvas.bounding_box()
    assert bounds is not None
    before = [picture(page, name) for name in ("heights", "levels", "holes")]
    cell = bounds["width"] / side
    canvas.hover(position={"x": (column + 0.5) * cell - 1, "y": (row + 0.5) * cell - 1})
    text = page.locator("#readout").inner_text()
    assert text.startswith(f"Row {row}, column {column}: ")
    at = row * side + column
    assert f"height {planes['heights'][at] * detail['height_step_m']:.0f} m" in text
    level = planes["levels"][at]
    if level == 0:
        assert "obstacle" in text
    elif level == 1:
        assert "no path" in text
    else:
        shown = text.split("RSRP ")[1].split()[0].replace("\N{MINUS SIGN}", "-")
        assert float(shown) == pytest.approx(detail["level_low_dbm"] + (level - 2) * detail["level_step_db"], abs=0.51)
    if "holes" in planes and level > 0:
        assert f"P(hole) {min(100, 100 * planes['holes'][at] * detail['hole_step']):.0f} %" in text
    assert all(old != picture(page, name) for old, name in zip(before, ("heights", "levels", "holes"), strict=True))
    page.mouse.move(0, 0)
    canvas.press("Shift+ArrowRight")
    assert page.locator("#readout").inner_text().startswith(f"Row {side // 2}, column {side // 2 + 1}: ")
    assert page.locator("#selected").inner_text().startswith(f"{record['id']} ")


def test_many_fast_steps_stay_quiet(page: Page) -> None:
    ids = listed(page)
    await_record(page, ids[0])
    for _ in range(3 * len(ids) + 2):
        page.keyboard.press("ArrowRight")
    await_record(page, ids[2 % len(ids)])


# ---------------------------------------------------------------- how it looks


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", WIDTHS.values(), ids=WIDTHS.keys())
def test_it_fits_and_has_contrast(browser: Browser, release: Path, width: int, scheme: str) -> None:
    opened = open_page(browser, release, width, scheme)
    page = opened.page
    go_to(page, drawn(page)["id"])
    for coloring in UNITS:
        page.locator("#colouring").select_option(coloring)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
    colors = (
        "['color', 'backgroundColor'].map(name => getComputedStyle(document.body)[name].match(/\\d+/g).map(Number))"
    )
    ink, paper = (sum(channels[:3]) / 3 for channels in page.evaluate(colors))
    assert (ink > 200 and paper < 60) if scheme == "dark" else (ink < 60 and paper > 200)
    close(opened)


def test_focus_is_visible(page: Page) -> None:
    for control in ("#map", "#heights", "#list", "#next"):
        page.locator(control).focus()
        page.keyboard.press("Shift")
        style = page.locator(control).evaluate("element => getComputedStyle(element).outlineStyle")
        assert style != "none", control
