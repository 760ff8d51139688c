"""What a reader finds who has only the page of a run: counted in actions, by what is seen on the
screen."""

import re
from dataclasses import dataclass
from typing import Any

import pytest

from planish.cli import main
from planish.run import open_run

pytestmark = pytest.mark.nightly

MOST = 12
"""Actions that the answers may take together; a screen further or a click is one."""

SEEN = """() => {
  const walk = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const words = [];
  for (let node; (node = walk.nextNode()); ) {
    const range = document.createRange();
    range.selectNodeContents(node);
    const box = range.getBoundingClientRect();
    const inside = box.top >= 0 && box.left >= 0
      && box.bottom <= innerHeight && box.right <= innerWidth;
    if (box.width && inside && node.parentElement.checkVisibility()) words.push(node.textContent);
  }
  return words.join(" ").replace(/\\s+/g, " ");
}"""


@dataclass
class Reader:
    """A page on a screen, and how many actions were taken on it."""

    page: Any
    actions: int = 0

    def seen(self):
        """What can be read on the screen now."""
        return self.page.evaluate(SEEN)

    def look_for(self, pattern):
        """Go on, screen by screen, until it is seen."""
        while not (found := re.search(pattern, self.seen())):
            assert self.actions < MOST, f"{pattern} is not seen"
            self.act(lambda: self.page.keyboard.press("PageDown"))
        return found

    def follow(self, link):
        """Click a link to another place of the page."""
        self.act(self.page.get_by_role("link", name=link, exact=True).click)

    def act(self, action):
        """Do what moves the page, which glides, and wait until it stands still."""
        self.actions += 1
        start = before = self.page.evaluate("scrollY")
        action()
        for _ in range(100):
            self.page.wait_for_timeout(200)
            now = self.page.evaluate("scrollY")
            if now == before != start:
                return
            before = now
        pytest.fail("The page did not move.")


@pytest.fixture(scope="module")
def signed_run(linked_run, specimen_files, tmp_path_factory):
    """The small run, linked once more by somebody who says who, when and what."""
    out = tmp_path_factory.mktemp("signed") / "run"
    words = (
        "--title",
        "Coating of sample 12",
        "--author",
        "A. Weber",
        "--date",
        "2026-11-20",
        "--note",
        "Third of five",
    )
    with pytest.raises(SystemExit) as end:
        main(["link", str(linked_run), str(specimen_files[1]), *words, "--out", str(out)])
    assert end.value.code in (0, 4)
    return out


def test_a_reader_finds_what_how_sure_why_who_and_how_to_cite(signed_run, chromium):
    context = chromium.new_context(viewport={"width": 1366, "height": 768})
    reader = Reader(context.new_page())
    reader.page.goto((signed_run / "report.html").as_uri())

    # Who made it, when, and of what: on the first screen.
    first = reader.seen()
    assert "Coating of sample 12" in first
    assert re.search("Author A. Weber.*Date 2026-11-20.*Note Third of five", first)

    # What was found, and how sure that is: as the results have it.
    results = open_run(signed_run).results
    row = max(
        (row for row in results.correlations if (row.a_map, row.b_map) == ("coating_top", "image")),
        key=lambda row: row.point_um,
    )
    found = re.search(
        r"The image is lighter .*where coating thickness \(top side\) is larger: r = (\S+) with a"
        r" 95 % interval of "
        r"(\S+) to (\S+), over \d+ points of 100.µm, (\d+) of them independent",
        first,
    )
    assert found, first
    said = [float(word) for word in found.groups()]
    assert said[:3] == pytest.approx([row.r, *row.interval], abs=0.5e-2)
    assert said[3] == round(row.n_eff)
    assert reader.actions == 0
    reader.look_for(f"All {len(results.checks)} checks passed")
    reader.look_for("What would make it more certain")

    # Whether light from one side explains it.
    light = reader.look_for(
        r"(\d+) % of what image and sheet share follows slopes of the face, as under light from one"
        r" side: "
        "too little to affect r"
    )
    assert int(light[1]) == round(100 * results.moving[0].registration.lag.light)
    assert reader.actions <= 2

    # How to cite it.
    reader.follow("How to cite")
    cited = reader.seen()
    assert "A. Weber: Coating of sample 12 (2026-11-20)" in cited
    assert f"planish, version {results.planish}" in cited
    assert "Introducing a concept to link 3D paper structure to 2D paper properties" in cited
    assert reader.actions <= MOST
    context.close()
