"""Four tasks that a person comes with, done with what the screen offers; a click, drag, choice or text is an action.

Once on a sheet and its image, once on two images.
"""

import re
from collections.abc import Generator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import xarray as xr

from app.conftest import Served, beside, start
from app.marks_page import api, drag, expect
from app.test_maps_page import known
from planish.run import open_run

pytestmark = pytest.mark.nightly

MOST = 12
"""Actions that a task may take."""


@dataclass(frozen=True)
class Case:
    """A run that is served, and what its page calls what it shows."""

    server: Served
    panes: tuple[str, str]
    maps: xr.Dataset  #: two maps on the pixels of the reference, and ``valid``
    layers: tuple[str, str]  #: names of the two maps
    titles: tuple[str, str]


@dataclass
class Person:
    """A page, and how many actions were taken on it."""

    shown: Any
    case: Case
    actions: int = 0

    def press(self, role: str, name: str, **more: Any) -> None:
        self.actions += 1
        self.shown.page.get_by_role(role, name=name, exact=True).click(**more)

    def choose(self, label: str, words: str) -> None:
        self.actions += 1
        self.shown.field(label).select_option(label=words)

    def write(self, label: str, words: str) -> None:
        self.actions += 1
        self.shown.fill(label, words)

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        self.actions += 1
        drag(self.shown.page, start, end)

    def click(self, x: float, y: float) -> None:
        self.actions += 1
        self.shown.page.mouse.click(x, y)

    def place(self, view: str, across: float, down: float) -> tuple[float, float]:
        """A place of a view on the screen, as shares of its width and height."""
        box = self.shown.role("application", view).bounding_box()
        return box["x"] + across * box["width"], box["y"] + down * box["height"]

    def applied(self) -> str:
        """Make the new run, and give the text of the report that the page opens."""
        run = self.case.server.run
        made = run.with_name(f"{run.name}-{len([*run.parent.iterdir()]) + 1}")
        self.press("button", "Apply")
        link = self.shown.role("link", f"Open report of {made.name}")
        link.wait_for(timeout=180_000)
        expect(self.shown.page.get_by_text("This page still shows the run before.")).to_be_visible()
        self.actions += 1
        with self.shown.page.context.expect_page() as report:
            link.click()
        return report.value.locator("body").inner_text()


def sheet_and_image(_run, linked) -> tuple[Any, ...]:
    titles = ("Coating thickness, top side, µm", "Relative grey")
    return ("Volume side", "Image side"), linked, ("coating_top", "image"), titles


def two_images(run, _linked) -> tuple[Any, ...]:
    white, uv = (open_run(run).groups[f"layers/{name}"].load() for name in ("white", "uv"))
    maps = xr.Dataset({"white/image": white.image, "uv/image": uv.image, "valid": white.valid & uv.valid})
    return ("white", "uv"), maps, ("white/image", "uv/image"), ("white: Relative grey", "uv: Relative grey")


@pytest.fixture(scope="module", params=[("upright", sheet_and_image), ("images", two_images)], ids=["sheet", "images"])
def case(request, kinds, linked, tmp_path_factory) -> Generator[Case]:
    name, facts_of = request.param
    run = beside(kinds(name), tmp_path_factory.mktemp("case"))
    server = start(run)
    yield Case(server, *facts_of(run, linked))
    server.end()


@pytest.fixture
def as_linked(case) -> Generator[Case]:
    """The case as it was linked: what the person changes is taken back when the page is closed."""
    yield case
    case.server.take_back()


@pytest.fixture
def person(as_linked, window):
    # A laptop's screen for the sheet, a desk's for the images.
    width, height = (1366, 768) if "Volume side" in as_linked.panes else (1920, 1080)
    shown = window(as_linked.server, width=width, height=height)
    expect(shown.role("table", "Marks").get_by_role("row").nth(1)).to_be_visible()
    return Person(shown, as_linked)


def scattered(person):
    expect(person.shown.page.get_by_text(re.compile("Scatter of [0-9]+ points"))).to_be_visible()


def test_a_mark_is_corrected_and_applied(person):
    label = person.shown.rows()[0][0]
    person.press("button", label)  # the views go to it
    x, y = person.place(person.case.panes[1], 0.5, 0.5)
    person.drag((x, y), (x + 14, y + 9))
    expect(person.shown.role("status", "Message")).to_contain_text("Mark moved")
    moved = person.shown.rows()[0]
    person.press("button", "Snap")
    expect(person.shown.role("status", "Message")).to_contain_text("snapped to its hole")
    assert person.shown.rows()[0][4:6] != moved[4:6]
    assert "marks" in person.applied()
    assert person.actions <= MOST


def test_r_of_a_region_and_its_interval(person):
    person.press("tab", "Maps")
    scattered(person)
    expect(person.shown.role("status", "Whole maps")).to_contain_text("95 % interval")
    person.press("button", "Draw region")
    person.drag(person.place("Left map", 0.42, 0.35), person.place("Left map", 0.6, 0.7))
    said = person.shown.role("status", "Selection")
    expect(said).to_have_text(re.compile(r"^n \d+; r .* 95 % interval"))
    # It stays beside the scatter whatever the cursor does, and is seen without scrolling.
    words = said.inner_text()
    for share in (0.3, 0.5, 0.7):
        person.shown.page.mouse.move(*person.place("Right map", share, share))
    expect(person.shown.role("table", "Values at the cursor")).to_be_visible()
    assert said.inner_text() == words
    box, scatter = said.bounding_box(), person.shown.role("application", "Scatter").bounding_box()
    assert box["y"] + box["height"] <= person.shown.page.viewport_size["height"]
    assert abs(box["x"] - scatter["x"]) < 2
    region = [float(v) for v in person.shown.field("Region, um").input_value().split(",")]
    a, b = known(person.case.maps, region, person.case.layers)
    assert int(re.match(r"n (\d+)", words)[1]) == pytest.approx(a.size, rel=0.02)
    assert float(re.search(r"r (-?[0-9.]+);", words)[1]) == pytest.approx(np.corrcoef(a, b)[0, 1], abs=0.02)
    assert " and ".join(title.removesuffix(", µm") for title in person.case.titles) in words
    assert person.actions <= MOST


def test_a_profile_is_saved_as_a_picture(person, tmp_path):
    person.press("tab", "Maps")
    scattered(person)
    person.press("button", "Draw line")
    person.drag(person.place("Left map", 0.4, 0.4), person.place("Left map", 0.6, 0.6))
    names = " and ".join(person.case.layers).replace("/", ".")  # which would end the pattern in the browser
    expect(person.shown.page.get_by_role("img", name=re.compile(f"^Profile over .* of {names}$"))).to_be_visible()
    for kind, first_bytes in (("PNG", b"\x89PNG"), ("SVG", b"<svg")):
        with person.shown.page.expect_download() as download:
            person.press("button", f"Profile: save as {kind}")
        download.value.save_as(tmp_path / kind)
        data = (tmp_path / kind).read_bytes()
        assert data.startswith(first_bytes)
    assert b"var(" not in data  # as other programs read it
    for title in person.case.titles:
        assert title in data.decode()
    assert person.actions <= MOST


def test_a_stain_is_excluded_and_the_report_of_the_new_run_read(person):
    person.press("tab", "Maps")
    scattered(person)
    person.press("button", "Draw polygon")
    corners = [person.place("Left map", *at) for at in ((0.45, 0.45), (0.55, 0.45), (0.5, 0.6))]
    for corner in [*corners, corners[-1]]:  # the last corner once more ends it
        person.click(*corner)
    person.write("Artefact: Author", "me")
    person.write("Artefact: Reason", "a stain")
    person.press("button", "Declare artefact")
    expect(person.shown.role("list", "Declared artefacts")).to_contain_text("a stain")
    report = person.applied()
    assert "a stain" in report
    assert person.actions <= MOST
    assert len(api(person.shown, "state")["regions"]) == 1
