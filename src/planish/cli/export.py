"""Commands that show a run: export to other programs, explore as one page, view in the browser."""

import json
from pathlib import Path
from typing import Any

import click

from planish.cli.console import print_json, sentence, warn
from planish.cli.options import (
    PATH,
    build_params,
    existing,
    json_option,
    options,
    out_option,
    verb,
    wrong_usage,
)
from planish.cli.runs import image_params, image_size_options
from planish.exports import FORMATS, ExportParams
from planish.io.params import ImageParams
from planish.run.compute import Compute


@verb(
    "planish export run --to tiff --out maps",
    "planish export run --map coating_top --map image --to mat --out coating.mat",
    "planish export run --to csv --point-um 100 --out points.csv",
    "planish export run --to ply --map top --map coating_top --out top.ply",
    "planish export run --to ome-zarr --group straightened --out flat.ome.zarr",
)
@existing("run")
@out_option("Folder to make, or a file where it ends as those of the format do; it must not exist.")
@options(ExportParams, "What is exported")
@options(Compute, "Resources", only=("memory_bytes", "threads"))
@json_option
def export(run: Path, out: Path, as_json: bool, **values: Any) -> None:
    """Write maps, surfaces or the registration of a RUN for other programs.

    OUT becomes a folder with a file for each map (NAME.tif ...), or one file if it ends like those
    of the format. docs/export.md says which format suits which program. Lengths are um, missing
    values NaN if the format has it; the files hold their history.
    """
    from planish.cli.show import stages
    from planish.exports import export as export_run

    params = build_params(ExportParams, values)
    compute = build_params(Compute, values)
    with stages(20) as progress, wrong_usage():
        files = export_run(
            run, out, compute=compute, progress=progress, **params.model_dump(exclude_unset=True)
        )
    if as_json:
        print_json({"out": str(out), "format": params.to, "files": [str(path) for path in files]})
        return
    file_format = FORMATS[params.to]
    missing_text = ""
    if file_format.missing != "–":
        missing_text = f"; missing values: {file_format.missing.replace('`', '')}"
    click.echo(
        f"{out}: {file_format.title}, {len(files)} file{'s' * (len(files) > 1)}{missing_text}"
    )
    if file_format.note:
        click.echo(file_format.note, err=True)


@verb("planish explore run --out sheet.html")
@existing("run")
@out_option("HTML file to write; it must not exist.")
@options(Compute, "Resources", only=("memory_bytes", "threads"))
@json_option
def explore(run: Path, out: Path, as_json: bool, **values: Any) -> None:
    """Write a RUN as one interactive HTML file, for readers without planish.

    It shows two maps, their scatter and the slice at the cursor, in any browser since 2023, without
    server or network. To print and keep, take the report.
    """
    from planish.app import explore as write
    from planish.cli.show import stages

    with stages(6) as progress:
        page = write(run, out, compute=build_params(Compute, values), progress=progress)
    if as_json:
        facts = {"out": str(out), "bytes": page.bytes, "maps": page.maps, "slices": page.slices}
        print_json(facts | {"notes": list(page.notes)})
        return
    click.echo(f"{out}: {page.bytes / 1e6:.1f} MB, {page.maps} maps, {page.slices} slices")
    for note in page.notes:
        sentence(note)


@verb("planish view run", "planish view run-map image.tif --pixel-um 2.6")
@existing("run")
@click.argument("image", type=PATH, required=False)
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=0,
    help="Port to serve on; 0 takes a free one.  [default: 0]",
)
@click.option("--no-browser", is_flag=True, help="Print the address only; do not open a browser.")
@click.option("--read-only", is_flag=True, help="Look only; change nothing.")
@click.option(
    "--host",
    default="127.0.0.1",
    metavar="ADDRESS",
    help="Address to serve on; any but this machine's own needs --expose.",
)
@click.option(
    "--expose",
    is_flag=True,
    help="Serve to other machines, over a connection that is not encrypted.",
)
@options(ImageParams, "Image", without=("md_deg", "dark_grey", "white_grey", "screen_um"))
@image_size_options
@json_option
def view(
    run: Path,
    image: Path | None,
    port: int,
    no_browser: bool,
    read_only: bool,
    host: str,
    expose: bool,
    as_json: bool,
    **values: Any,
) -> None:
    """Open RUN in the browser to check and correct it.

    Check its marks, surfaces and maps, correct them, and apply that to a new run.

    RUN is the folder of a link. If a link was refused at the marks, give the maps that it kept,
    OUT-map, and IMAGE, and set the marks by hand. Every change is saved at once in RUN/edits; RUN
    itself stays as it is.
    """
    from planish.app.server import serve
    from planish.app.session import Session

    is_local = host in ("127.0.0.1", "localhost")
    if not is_local and not expose:
        raise click.UsageError(
            f"--host {host} lets other machines on the network see and change this run, over a"
            " connection that is not encrypted. Give --expose as well if you mean it; for one"
            " other machine, an ssh tunnel is safer."
        )
    shown_image = None if image is None else image_params(image, values)
    session = Session.open(run, shown_image, read_only=read_only)

    def started(url: str) -> None:
        """Print the address once it is served, and open it."""
        facts = {"url": url, "run": str(run), "read_only": session.read_only}
        click.echo(json.dumps(facts) if as_json else url)
        if session.reason:
            warn(f"read only. {session.reason}")
        if not is_local:
            warn(
                f"exposed on {host}: whoever gets this address, token included, sees this run's"
                " maps and marks and can change them; nothing is encrypted."
            )
        if not no_browser:
            click.launch(url)

    serve(session, host=host, port=port, on_open=started)
