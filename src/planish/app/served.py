"""What an app serves: the run it was started on, or one that Apply made."""

from pathlib import Path

from starlette.applications import Starlette
from starlette.requests import Request

from planish.app.apply import Applying
from planish.app.live import Live
from planish.app.pictures import Tiles
from planish.app.session import Session
from planish.app.slices import SlicedSheet


class Served:
    """A run that is served, and all that belongs to it.

    A request holds one from its start to its end, whatever is served meanwhile. Its name, that of
    the folder, says which run a page shows: all runs of an app stand side by side. ``message`` is
    what a page that opens it says first.
    """

    def __init__(self, session: Session, applying: Applying, message: str = "") -> None:
        self.session = session
        self.applying = applying
        self.message = message
        self.live = Live(session)
        self.tiles = Tiles(session.pictures)
        self.sheets = dict[str, SlicedSheet]()
        self.run = session.folder.name

    def close(self) -> None:
        """End it: no run is made any more, and others may change this one."""
        self.applying.close()
        self.session.close()


def served_of(request: Request) -> Served:
    """The run that was served when a request came in."""
    return request.state.served


def open_new_run(app: Starlette) -> str:
    """Serve the run that Apply made in place of the one it was made from; give its name.

    Pages of runs that were made stay. Where none was made, the session stays.

    Raises
    ------
    FileError
        If the run cannot be opened, as where another planish has it open.
    """
    with app.state.switching:  # two windows may ask at once
        before: Served = app.state.served
        progress = before.applying.progress
        if progress.state == "done" and progress.run is not None:
            session = Session.open(Path(progress.run))
            idle = progress.model_copy(update={"state": "idle"})
            opened_text = f"{session.folder.name} is open. What was changed after Apply is in"
            app.state.served = Served(
                session,
                Applying(session, before.applying.reports, idle),
                f"{opened_text} {before.run} only.",
            )
            before.close()
        return app.state.served.run
