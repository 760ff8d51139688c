"""``planish new``: a study file to be filled in."""

from __future__ import annotations

from pathlib import Path

import click

from planish.cli.console import sentence
from planish.cli.options import verb


@verb(
    "planish new study.toml volume.tif image.tif", "planish new study.toml scan/", "planish run study.toml", name="new"
)
@click.argument("study", type=click.Path(path_type=Path))
@click.argument("volume", type=click.Path(path_type=Path))
@click.argument("image", required=False, type=click.Path(path_type=Path))
def new(study: Path, volume: Path, image: Path | None) -> None:
    """Write STUDY, a commented file with all options, for VOLUME and IMAGE; 'planish run STUDY' then does it.

    What the files state stands in it: sizes, shapes, grey values, the axis that seems to run through the sheet. What
    they do not state is listed at its top, with line numbers. Without IMAGE it is a study that maps VOLUME.
    """
    from planish.core.errors import FileError
    from planish.core.files import write_whole
    from planish.io.run_folder import refuse_existing
    from planish.pipeline.draft import draft_study

    if study.suffix.lower() != ".toml":
        raise click.UsageError(f"STUDY comes first and ends in .toml; {study} does not.")
    refuse_existing(study)
    draft = draft_study(volume, image, home=study.absolute().parent, name=study.name)
    if not study.absolute().parent.is_dir():
        raise FileError(f"The folder of {study} does not exist. Make it, or choose another one.")
    write_whole(study, draft.text.encode())
    click.echo(f"{study}: written")
    for needed, words in ((True, "fill in"), (False, "look at")):
        for gap in draft.missing:
            if gap.needed is needed:
                sentence(f"{words} line {gap.line}, {gap.key}: {gap.why}")
    click.echo(f"then: planish run {study}")
