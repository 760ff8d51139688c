"""Commands about files: info, import, properties."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from planish.cli.console import print_json, shown
from planish.cli.options import (
    PATH,
    build_params,
    existing,
    json_option,
    options,
    out_option,
    verb,
    with_commands,
)
from planish.core.errors import FileError, PlanishError
from planish.core.typing import Entries
from planish.correct.params import CorrectParams
from planish.io.params import ImageParams, VolumeParams
from planish.run.compute import Compute, engine

if TYPE_CHECKING:
    from planish.io.inspection import Section


@verb(
    "planish info volume.tif",
    "planish info volume.tif --picture look.png",
    "planish info volume.tif --voxel-um 2,1.5,1.5",
    "planish info run --json",
)
@existing("path")
@click.option(
    "--picture", type=PATH, metavar="PNG", help="Draw the middle sections into this file."
)
@options(VolumeParams, "Size", only=("voxel_um", "override_size"))
@options(ImageParams, "Size", only=("pixel_um",))
@json_option
def info(path: Path, picture: Path | None, as_json: bool, **sizes: Any) -> None:
    """Show what PATH holds.

    Shape, type, voxel or pixel size and its source, grey values, and whatever looks wrong. A given
    size is compared with that of the file, as in a run.

    A terminal also shows the middle of a volume, where a sheet is a line across the axis that runs
    through it. --picture draws three sections: x and y across with z down, and x across with y
    down.
    """
    from planish.cli.show import fact_lines, run_facts, run_lines
    from planish.io import find_place
    from planish.io.inspection import as_text, best_section, write_picture

    sections: list[Section] = []
    is_utf = (sys.stdout.encoding or "").lower().startswith("utf")
    has_drawing = not as_json and is_utf and sys.stdout.isatty()
    facts = run_facts(path)
    if facts is not None:
        lines = run_lines(facts)
    else:
        needs_look = picture is not None or has_drawing
        facts = _facts_of_file(path, sizes, sections if needs_look else None)
        lines = fact_lines(facts)
        if has_drawing and len(sections) > 1:
            lines += as_text(best_section(sections, facts["through"]))
    if picture is not None:
        if not sections:
            raise FileError(
                f"There is nothing of {find_place(path).name} to draw: give a volume or an image"
                " that can be looked at."
            )
        write_picture(sections, picture)
    if as_json:
        print_json(facts)
    else:
        click.echo(shown("\n".join(lines)))


def _facts_of_file(path: Path, sizes: Entries, sections: list[Section] | None) -> Entries:
    """What a file holds; its middle sections are added to ``sections``, where it is a list.

    ``sizes``: the options on its size, None where not given.
    """
    from planish.io import describe
    from planish.io.inspection import middle_sections

    if (path / "run.toml").is_file():
        from planish.run.run import open_results

        open_results(path)  # says what is wrong with it
    given_sizes = {name: size for name, size in sizes.items() if size is not None}
    facts = describe(
        path,
        look=None if sections is None else lambda v: sections.extend(middle_sections(v)),
        **given_sizes,
    )
    ctx = click.get_current_context()
    facts["warnings"] = [with_commands(warning, ctx) for warning in facts["warnings"]]
    return facts


@verb(
    "planish import scan/ --out sheet.zarr",
    "planish import sections/ --out sheet.zarr --through y",
    name="import",
)
@existing("volume")
@out_option("Store to make, such as sheet.zarr; it must not exist.")
@options(
    VolumeParams,
    "Volume",
    only=(
        "voxel_um",
        "override_size",
        "unusual_size",
        "through",
        "channel",
        "fixed_rows",
        "fixed_cols",
    ),
)
@options(CorrectParams, "Corrections")
@options(Compute, "Resources", only=("memory_bytes", "scheduler"))
@click.option(
    "--ome",
    type=click.Choice(["0.5", "0.4"]),
    default="0.5",
    show_default=True,
    help="Version of OME-Zarr.",
)
def import_(volume: Path, out: Path, ome: Literal["0.5", "0.4"], **values: Any) -> None:
    """Import VOLUME into a working store: chunked, in several resolutions, with checksums.

    For volumes that do not fit into memory. Serial sections, which need --through, are aligned and
    joined. The store is OME-Zarr and opens in other programs, too. The same command resumes an
    import that was killed.
    """
    from planish.cli.show import stages
    from planish.io.run_folder import refuse_existing
    from planish.io.store import write_store
    from planish.run import read_whole

    compute = build_params(Compute, values)
    params = build_params(VolumeParams, values, path=str(volume.absolute()))
    correct = build_params(CorrectParams, values)
    if correct != CorrectParams() and not correct.asked:
        raise click.UsageError(
            "--rotation-axis and -centre-um belong to --correct-rings and --correct-cupping."
        )
    record_path = out.with_name(f"{out.stem}.corrections.json")
    picture_path = record_path.with_suffix(".png")
    correction = None
    with stages(2) as progress:
        scan = read_whole(params, compute, progress)
        if correct.asked:
            from planish.correct import correct_volume

            refuse_existing(record_path, picture_path)
            correction = correct_volume(
                scan,
                params=correct,
                memory_bytes=compute.volume_bytes,
                progress=lambda step, share_text: progress("correct", f"{step}, {share_text}"),
            )
            for sentence in correction.record.sentences:
                click.echo(sentence)
            if clipped_share := correction.record.clipped:
                percent = f"{100 * clipped_share:.2g} %"
                click.echo(
                    f"{percent} of the voxels left the range of {scan.dtype} and were clipped."
                )
        with engine(compute) as workers:
            write_store(
                scan if correction is None else correction.volume,
                out,
                memory_bytes=compute.block_bytes,
                ome=ome,
                executor=workers.executor,
                workers=workers.at_once,
                progress=lambda step, done, blocks: progress(step, f"block {done} of {blocks}"),
            )
    if correction is not None:
        from planish.correct import write_picture

        try:
            text = json.dumps(correction.record.to_json(), indent=2)
            record_path.write_text(f"{text}\n", encoding="utf-8", newline="\n")
        except OSError as error:
            raise FileError(
                f"{record_path} cannot be written: {error.strerror}. The store itself is whole."
            ) from error
        if correction.before is not None:
            write_picture(correction, scan, picture_path)
    click.echo(f"{out}: {' x '.join(map(str, scan.shape))} voxels")


@verb("planish properties", "planish map volume.tif --out run --property porosity --solid-grey 180")
def properties() -> None:
    """List the maps that --property takes: name, unit and what they show."""
    from planish.cli.console import table
    from planish.core.plugins import plugins
    from planish.measure import find_property, registered

    included = registered()
    rows = [(prop.name, prop.units, prop.long_name) for prop in included.values()]
    for plugin in plugins("property"):
        if plugin.name in included:
            continue
        try:
            prop = find_property(plugin.name)
        except PlanishError as error:
            rows.append((plugin.name, "", error.text))
        else:
            title = f"{prop.long_name} (package {plugin.package} {plugin.version})"
            rows.append((prop.name, prop.units, title))
    table("Properties", ("name", "unit", ""), rows)
