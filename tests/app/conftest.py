"""A server on a copy of a run, and a browser: for the tests of the page with real mouse and
keys."""

import json
import shutil
import subprocess
import sys
import urllib.request
from collections.abc import Callable, Generator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
import pytest

from app.exploring.made import put
from app.marks_page import Browsed
from planish.app import Session
from planish.marks.exchange import MarkPlaces, make_marks
from planish.register import fit_transform
from planish.run import Registration
from report.runs import a_run

START_S = 60.0
"""How long a server may take to print its address on a loaded machine."""


@dataclass
class Served:
    """A running ``planish view``: its address with the token, its run, and the process."""

    url: str
    run: Path
    process: subprocess.Popen[str]
    arguments: tuple[str, ...] = ()

    @property
    def base(self) -> str:
        return self.url.partition("/#")[0]

    @property
    def token(self) -> str:
        return self.url.partition("token=")[2]

    @property
    def port(self) -> int:
        return int(self.base.rpartition(":")[2])

    def ask(self, path: str, *, body: dict[str, Any] | None = None) -> Any:
        """Answer of the server; a body makes it a request that changes something."""
        headers = {
            "Authorization": f"Bearer {self.token}",
            "Origin": self.base,
            "Content-Type": "application/json",
        }
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(f"{self.base}/api/{path}", data, headers)
        with urllib.request.urlopen(request, timeout=START_S) as answer:
            return json.load(answer)

    def take_back(self) -> None:
        """Undo all changes: the run stands as it was linked."""
        while self.ask("state")["can_undo"]:
            self.ask("undo", body={})

    def kill(self) -> None:
        """End it at once, as a machine that fails does."""
        self.process.kill()
        self.process.wait()

    def end(self) -> None:
        """End it in an orderly way."""
        if self.process.poll() is None:
            self.process.terminate()
        self.process.wait(timeout=START_S)
        assert self.process.stdout is not None
        self.process.stdout.close()


def start(run: Path, *arguments: str, stderr: IO[str] | int = subprocess.DEVNULL) -> Served:
    """Start ``planish view`` and read its address."""
    command = [
        sys.executable,
        "-m",
        "planish",
        "view",
        str(run),
        *arguments,
        "--json",
        "--no-browser",
    ]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stderr, text=True)
    assert process.stdout is not None
    line = process.stdout.readline()
    assert line, f"planish view ended with {process.wait()}"
    return Served(url=json.loads(line)["url"], run=run, process=process, arguments=arguments)


@pytest.fixture
def serve() -> Generator[Callable[..., Served]]:
    """Return a function from a run folder, and options, to its server; all servers end with the
    test."""
    servers: list[Served] = []

    def begin(run: Path, *arguments: str, **how: Any) -> Served:
        servers.append(start(run, *arguments, **how))
        return servers[-1]

    yield begin
    for server in servers:
        server.end()


def beside(run: Path, tmp_path: Path) -> Path:
    """A copy of a run that a test may change, where the paths to its files still lead to them."""
    place = run.parent.parent / f"{tmp_path.parent.name}-{tmp_path.name}"
    return Path(shutil.copytree(run, place / "run"))


@pytest.fixture
def run_copy(linked_run, tmp_path) -> Path:
    """A copy of the small run."""
    return beside(linked_run, tmp_path)


@pytest.fixture(scope="session")
def one_server(linked_run, tmp_path_factory) -> Generator[Served]:
    """A server on a copy of the small run for all tests: it takes seconds to start."""
    server = start(beside(linked_run, tmp_path_factory.mktemp("served")))
    yield server
    server.end()


@pytest.fixture
def served(one_server) -> Generator[Served]:
    """That server, with the run as it was linked: what the test changes is taken back.

    To be asked for before ``window``, so that the page is closed by then.
    """
    yield one_server
    one_server.take_back()


@pytest.fixture(scope="session")
def made_run(tmp_path_factory) -> Path:
    """A made sheet of 0.8 x 0.5 mm, linked to its made image by five pairs of holes; which no test
    may change."""
    run, draw = a_run(), np.random.default_rng(3)
    moving = np.array([[150, 110], [640, 130], [420, 260], [180, 420], [700, 440]], dtype=float)
    fixed = moving @ [[0.99, 0.12], [-0.12, 0.99]] + (20, -15) + draw.normal(0, 1, moving.shape)
    known = {"diameter": 180.0, "cov_xx": 1.2, "cov_yy": 1.1, "cov_xy": 0.1}
    planes = {
        plane: MarkPlaces(
            um=um,
            source=["detected"] * 5,
            extras={k: v + draw.uniform(0, 0.1, 5) for k, v in known.items()},
        )
        for plane, um in (("moving", moving), ("fixed", fixed))
    }
    folder = put(
        tmp_path_factory.mktemp("made") / "run",
        run | {"groups": {k: run["groups"][k] for k in ("maps", "linked")}},
    )
    with (folder / "run.toml").open("a", encoding="utf-8") as study:
        study.write('[[layers]]\nname = "image"\n\n[layers.image]\npath = "image.png"\n')
    marks = make_marks([f"hole {k}" for k in range(1, 6)], planes)
    Registration(fit=fit_transform(moving, fixed), marks=marks).save(folder / "marks.json")
    return folder


@pytest.fixture
def made_copy(made_run, tmp_path) -> Path:
    """A copy of the made run, alone in its folder."""
    return Path(shutil.copytree(made_run, tmp_path / "made" / "run"))


@pytest.fixture
def session(made_copy):
    """A session on a copy of the made run."""
    session = Session.open(made_copy)
    yield session
    session.close()


@pytest.fixture
def linked_session(run_copy):
    """A session on a copy of the small run."""
    session = Session.open(run_copy)
    yield session
    session.close()


class Window(Browsed):
    """A page of a served session."""

    def __init__(self, page: Any, server: Served) -> None:
        super().__init__(page)
        self.server = server

    def role(self, role: str, name: str) -> Any:
        return self.page.get_by_role(role, name=name, exact=True)

    def middle(self, name: str) -> tuple[float, float]:
        """The middle of a map view on the screen."""
        view = self.role("application", name)
        view.scroll_into_view_if_needed()
        box = view.bounding_box()
        return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2

    def go(self, name: str, x_um: float, y_um: float, pixel_um: float | None = None) -> None:
        """Bring a point into the middle of a view by the fields beside it."""
        if pixel_um is not None:
            self.fill(f"{name}, um per screen pixel", str(pixel_um))
        self.fill(f"{name} centre, um", f"{x_um}, {y_um}")

    def click(self, name: str, x_um: float, y_um: float, pixel_um: float | None = None) -> None:
        """Click a point of a view with the mouse."""
        self.go(name, x_um, y_um, pixel_um)
        self.page.mouse.click(*self.middle(name))

    def rows(self) -> list[list[str]]:
        """Texts of the table's rows; the box `Used` as its state."""
        return [
            [
                *row.get_by_role("cell").all_inner_texts(),
                str(row.get_by_role("checkbox").is_checked()),
            ]
            for row in self.role("table", "Marks").get_by_role("row").all()[1:]
        ]


@pytest.fixture
def window(chromium) -> Generator[Callable[..., Window]]:
    """Return a function that opens the page of a server.

    Errors in its console, and requests to another machine or with the token, fail the test at the
    end.
    """
    opened: list[Window] = []

    def begin(
        server: Served, *, width: int = 1366, height: int = 768, context: Any = None, **options: Any
    ) -> Window:
        context = context or chromium.new_context(
            viewport={"width": width, "height": height}, **options
        )
        shown = Window(context.new_page(), server)
        shown.page.goto(server.url)
        opened.append(shown)
        return shown

    yield begin
    for shown in opened:
        if not shown.page.is_closed():
            shown.page.context.close()
    assert [fault for shown in opened for fault in shown.faults] == []
    here = ("http://127.0.0.1:", "data:", "blob:")
    for shown in opened:
        assert [
            url for url in shown.asked if not url.startswith(here) or shown.server.token in url
        ] == []
