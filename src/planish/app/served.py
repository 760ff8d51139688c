"""Which session an app serves: that of the run it was started on, or of one that Apply made."""

from pathlib import Path

from starlette.applications import Starlette

from planish.app.apply import Applying
from planish.app.live import Live
from planish.app.pictures import Tiles
from planish.app.session import Session


def serve_session(app: Starlette, session: Session) -> None:
    """Serve a session; handlers find it as ``request.app.state.session``."""
    app.state.session = session
    app.state.live = Live(session)
    app.state.tiles = Tiles(session.pictures)
    app.state.sheets = {}
    app.state.applying = Applying(session)


def close_session(app: Starlette) -> None:
    """End what an app serves: no run is made any more, and others may change the run."""
    app.state.applying.close()
    app.state.session.close()


def open_new_run(app: Starlette) -> str:
    """Serve the run that Apply made in place of the one it was made from; give its name.

    Pages of runs that were made stay. Where none was made, the session stays.

    Raises
    ------
    FileError
        If the run cannot be opened, as where another planish has it open.
    """
    applying: Applying = app.state.applying
    if applying.progress.run is None:
        return app.state.session.folder.name
    session = Session.open(Path(applying.progress.run))
    close_session(app)
    serve_session(app, session)
    app.state.applying.reports |= applying.reports
    return session.folder.name
