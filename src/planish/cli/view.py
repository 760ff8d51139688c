"""The command that opens a run in the browser, to check and correct it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from planish.cli.options import json_option, options, verb
from planish.io.params import ImageParams

LOCAL = "127.0.0.1"

_image_options = options(ImageParams, "image", "Image", only=("pixel_um", "channel", "side"))


@verb(
    "planish view run",
    "planish view run-map image.tif --pixel-um 2.6",
    name="view",
)
@click.argument("run", type=click.Path(path_type=Path))
@click.argument("image", type=click.Path(path_type=Path), required=False)
@click.option(
    "--port", type=click.IntRange(0, 65535), default=0, help="Port to serve on; a free one where 0.  [default: 0]"
)
@click.option("--no-browser", is_flag=True, help="Print the address only, and open no browser.")
@click.option("--read-only", is_flag=True, help="Look only: nothing can be changed.")
@click.option(
    "--host", default=LOCAL, metavar="ADDRESS", help="Address to serve on; others than this machine need --expose."
)
@click.option("--expose", is_flag=True, help="Serve to other machines, over a connection that is not encrypted.")
@_image_options
@json_option
def view(
    run: Path, image: Path | None, port: int, no_browser: bool, read_only: bool, host: str, expose: bool, as_json: bool,
    **values: Any,
) -> None:  # fmt: skip
    """Open RUN in the browser: check its marks, surfaces and maps, correct them, and apply that to a new run.

    RUN is the folder of a link. Where a link was refused at the marks, give the maps that it kept, OUT-map, and IMAGE,
    and set the marks by hand. Every change is saved at once in RUN/edits; RUN itself stays as it is.
    """
    from planish.app.server import serve
    from planish.app.session import Session
    from planish.cli.options import build_params

    if host not in (LOCAL, "localhost") and not expose:
        raise click.UsageError(
            f"--host {host} lets other machines on the network see and change this run, over a connection that is not "
            "encrypted. Give --expose as well if you mean it; for one other machine, an ssh tunnel is safer."
        )
    shown = None if image is None else build_params(ImageParams, values, "image", path=str(image))
    session = Session.open(run, shown, read_only=read_only)

    def started(url: str) -> None:
        if as_json:
            click.echo(json.dumps({"url": url, "run": str(run), "read_only": session.read_only}))
        else:
            click.echo(url)
        if session.reason:
            click.echo(f"planish: read only. {session.reason}", err=True)
        if host not in (LOCAL, "localhost"):
            click.echo(
                f"planish: exposed on {host}: whoever gets this address, token included, sees this run's maps and "
                "marks and can change them; nothing is encrypted.", err=True,
            )  # fmt: skip
        if not no_browser:
            click.launch(url)

    serve(session, host=host, port=port, started=started)
