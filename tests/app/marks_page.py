"""What tests of pages share, and those of its marks."""

import re

import numpy as np

VOLUME, IMAGE = "Volume side", "Image side"


class Browsed:
    """A page in the browser; ``faults`` are the errors of its console, ``asked`` the addresses it
    asked for."""

    def __init__(self, page):
        self.page = page
        self.faults: list[str] = []
        self.asked: list[str] = []
        page.on(
            "console", lambda line: self.faults.append(line.text) if line.type == "error" else None
        )
        page.on("pageerror", lambda error: self.faults.append(str(error)))
        page.on("request", lambda request: self.asked.append(request.url))

    def field(self, label):
        return self.page.get_by_label(label, exact=True)

    def fill(self, label, text):
        box = self.field(label)
        box.fill(text)
        box.press("Enter")


def expect(what):
    """Wait until the page shows something."""
    from playwright.sync_api import expect as wait_for

    wait_for.set_options(timeout=20000)
    return wait_for(what)


def api(shown, path):
    """The answer of the server to a question of the page."""
    ask = (
        "([path, token]) => fetch(path, {headers: {Authorization: 'Bearer ' + token}}).then(r =>"
        " r.json())"
    )
    return shown.page.evaluate(ask, [f"/api/{path}", shown.server.token])


def drag(page, start, end, *, key=""):
    """Press the mouse at one place of the screen, perhaps with a key, and let it go at another."""
    page.mouse.move(*start)
    if key:
        page.keyboard.down(key)
    page.mouse.down()
    page.mouse.move(*end, steps=5)
    page.mouse.up()
    if key:
        page.keyboard.up(key)


def message(shown):
    return shown.role("status", "Message")


def ends(rows):
    """Places of the rows, (n, 4)."""
    return np.array([[float(cell) for cell in row[2:6]] for row in rows])


def settled(shown):
    """The rows when the fit of the chosen model has followed."""
    expect(shown.role("table", "Marks")).not_to_contain_text("follows")
    return shown.rows()


def pair(shown, moving, fixed):
    """Set a pair with two clicks of the mouse."""
    rows = len(shown.rows())
    shown.click(VOLUME, *moving)
    expect(message(shown)).to_have_text(re.compile(rf"Mark set in the {VOLUME}.*Saved", re.DOTALL))
    shown.click(IMAGE, *fixed)
    expect(shown.role("table", "Marks").get_by_role("row")).to_have_count(rows + 2)


def forget_lost(shown):
    """Take the requests that failed while the server was away, or refused, from the faults of the
    console."""
    shown.faults[:] = [fault for fault in shown.faults if "Failed to load resource" not in fault]
