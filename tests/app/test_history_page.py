"""Undo and redo in a real browser: against a slow model, through reloads and kills of the server."""

import random
import threading
import time
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from typing import Any

import pytest

from app.marks_page import IMAGE, VOLUME, forget_lost, settled

pytestmark = pytest.mark.nightly

SEQUENCES, STEPS = 20, 6
APART_UM = 60.0
"""A click nearer to a mark chooses that one."""

SHOWN = """() => {
  const find = (selector) => document.querySelector(selector);
  const rows = [...document.querySelectorAll("table[aria-label=Marks] tbody tr")].map((row) => ({
    label: row.cells[0].textContent, used: row.querySelector("input").checked,
    ends: [2, 3, 4, 5].map((k) => Number(row.cells[k].textContent)),
  }));
  const can = ["undo", "redo"].map((id) => !find(`#${id}`).disabled);
  const model = [...document.querySelectorAll("label")].find((label) => label.textContent === "Model");
  return model ? { rows, can, model: model.control.value } : null; // null as long as the page loads
}"""

HELD = """async () => {
  const headers = { Authorization: `Bearer ${sessionStorage.getItem("planish-token")}` };
  const { marks, model } = await (await fetch("/api/state", { headers })).json();
  const none = [null, null];
  return { model, marks: marks.map(({ label, used, moving, fixed }) =>
    ({ label, used, ends: [...(moving ?? none), ...(fixed ?? none)] })) };
}"""


@dataclass
class Model:
    """What the page has to show, as slowly as can be: a copy of everything for every change."""

    marks: list[dict]
    model: str
    past: list[tuple] = field(default_factory=list)
    future: list[tuple] = field(default_factory=list)

    def step(self) -> None:
        """Before a change."""
        self.past.append(deepcopy((self.marks, self.model)))
        self.future.clear()

    def undo(self) -> None:
        self.future.append(deepcopy((self.marks, self.model)))
        self.marks, self.model = self.past.pop()

    def redo(self) -> None:
        self.past.append(deepcopy((self.marks, self.model)))
        self.marks, self.model = self.future.pop()

    @property
    def rows(self) -> list[dict]:
        return [mark for mark in self.marks if None not in mark["ends"]]

    @property
    def seen(self) -> dict:
        return {"rows": self.rows, "can": [bool(self.past), bool(self.future)], "model": self.model}

    @classmethod
    def of(cls, page) -> "Model":
        found = page.evaluate(SHOWN)
        assert found["can"] == [False, False]
        return cls(marks=found["rows"], model=found["model"])


def alike(marks: list[dict], expected: list[dict]) -> bool:
    """Whether marks are the same, with places to the two decimals that the page writes."""
    return [[mark["label"], mark["used"], *mark["ends"]] for mark in marks] == [
        [mark["label"], mark["used"], *(pytest.approx(end, abs=0.011) for end in mark["ends"])] for mark in expected
    ]


def first_match(page, script: str, states: Sequence, matches: Callable[[dict, Any], bool]) -> int:
    """Wait until what a script reads in the page matches one of some states: which."""
    end = time.monotonic() + 10
    while True:
        shown = page.evaluate(script)
        for k, state in enumerate(states):
            if shown is not None and matches(shown, state):
                return k
        assert time.monotonic() < end, f"{shown} is none of {states}"
        page.wait_for_timeout(15)


def shows(page, wanted: dict) -> None:
    """Wait until the page shows a state."""
    exact = ("can", "model")
    first_match(
        page, SHOWN, [wanted], lambda a, b: all(a[k] == b[k] for k in exact) and alike(a["rows"], b["rows"])
    )  # fmt: skip


class Person:
    """Somebody who does whatever comes to mind, in the page and in the model."""

    def __init__(self, shown, seed: int) -> None:
        self.shown, self.page, self.draw = shown, shown.page, random.Random(seed)
        settled(shown)
        self.first = Model.of(shown.page)
        self.model = deepcopy(self.first)
        self.labels = 0

    def act(self) -> None:
        """One random act; the page may not have shown it yet."""
        kinds = ["click", "click", "undo", "undo", "redo", "model_chosen"]
        if self.model.rows:
            kinds += ["use", "use", "label", "delete", "nudge"]
        getattr(self, self.draw.choice(kinds))()

    def undo(self) -> None:
        if self.model.past:
            self.model.undo()
            self.button_or_key("Undo", "Control+z")

    def redo(self) -> None:
        if self.model.future:
            self.model.redo()
            self.button_or_key("Redo", "Control+y")

    def button_or_key(self, name: str, keys: str) -> None:
        if self.draw.random() < 0.5:
            self.shown.role("button", name).click()
        else:
            self.shown.role("application", VOLUME).press(keys)

    def use(self) -> None:
        row = self.draw.choice(self.model.rows)
        self.model.step()
        row = next(mark for mark in self.model.marks if mark["label"] == row["label"])
        row["used"] = not row["used"]
        self.page.get_by_label(f"Use {row['label']}", exact=True).click()

    def model_chosen(self) -> None:
        self.model.step()
        self.model.model = self.draw.choice([m for m in ("rigid", "similarity", "affine") if m != self.model.model])
        self.page.get_by_label("Model", exact=True).select_option(self.model.model)

    def chosen(self) -> dict:
        row = self.draw.choice(self.model.rows)
        self.shown.role("button", row["label"]).click()
        self.model.step()
        return row

    def label(self) -> None:
        row = self.chosen()
        self.labels += 1
        row["label"] = f"called {self.labels}"
        self.shown.fill("Label", row["label"])

    def delete(self) -> None:
        self.model.marks.remove(self.chosen())
        self.shown.role("button", "Delete").click()

    def nudge(self) -> None:
        row = self.chosen()
        key, axis, sign = self.draw.choice(
            [("ArrowLeft", 0, -1), ("ArrowRight", 0, 1), ("ArrowUp", 1, -1), ("ArrowDown", 1, 1)]
        )
        self.shown.fill(f"{IMAGE}, um per screen pixel", "2")
        row["ends"][2 + axis] += 2 * sign
        self.shown.role("application", IMAGE).press(key)

    def click(self) -> None:
        """A click in one of the views; it gives its end to the mark that waits for it."""
        side = self.draw.choice([VOLUME, IMAGE])
        at = slice(0, 2) if side == VOLUME else slice(2, 4)
        taken = [mark["ends"][at] for mark in self.model.marks if None not in mark["ends"][at]]
        while True:
            place = [round(self.draw.uniform(100, 1000), 2), round(self.draw.uniform(100, 800), 2)]
            if all(max(abs(a - b) for a, b in zip(place, other, strict=True)) > APART_UM for other in taken):
                break
        self.model.step()
        waiting = next((mark for mark in reversed(self.model.marks) if None in mark["ends"]), None)
        if waiting is None:
            waiting = {"label": self.free_name(), "used": True, "ends": [None] * 4}
            self.model.marks.append(waiting)
        waiting["ends"][at] = place
        self.shown.click(side, *place, pixel_um=2.0)

    def free_name(self) -> str:
        taken = {mark["label"] for mark in self.model.marks}
        return next(name for k in range(1, 1000) if (name := f"mark {k}") not in taken)

    def settle(self) -> None:
        shows(self.page, self.model.seen)
        self.held(self.model)

    def held(self, *models: Model) -> int:
        """Wait until the server holds all marks of one of some models, those with one end too: which."""
        return first_match(
            self.page, HELD, models, lambda a, model: a["model"] == model.model and alike(a["marks"], model.marks)
        )

    def back_to_the_beginning(self) -> None:
        """Undo reaches the run as it was."""
        while self.model.past:
            self.model.undo()
            self.shown.role("button", "Undo").click()
            self.settle()
        shows(self.page, self.first.seen | {"can": [False, bool(self.model.future)]})


def alone(shown) -> None:
    """Views that do not follow each other: a place is set in one of them."""
    shown.page.get_by_label("Move views together").uncheck()


def test_twenty_sequences_of_changes_undo_and_redo_with_reloads_and_kills_between(serve, window, run_copy):
    """A kill of the server in the middle of a change loses that one at most."""
    shown = window(serve(run_copy))
    person, lost, pause = Person(shown, 7), 0, random.Random(12)
    for k in range(SEQUENCES):
        alone(shown)
        for _ in range(STEPS):
            person.act()
            person.settle()
        if k % 3:
            shown.page.reload()
        else:
            before = deepcopy(person.model)
            end = threading.Timer(pause.uniform(0, 0.4), shown.server.kill)
            end.start()
            person.act()  # its answer is not waited for
            end.join()
            shown.server = serve(run_copy)
            shown.page.goto(shown.server.url)
            settled(shown)
            if person.held(person.model, before):
                person.model, lost = before, lost + 1
        person.settle()
    print(f"{lost} changes in flight were lost")
    person.back_to_the_beginning()
    forget_lost(shown)
