"""The command that makes a specimen with known answers, as files that any program can read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

_VOLUMES = {"ct": "scanner", "sections": "sections", "stack": "stack"}


@click.command()
@click.option(
    "--preset", "paper", default="wfc135", show_default=True, metavar="NAME", help="Paper; --list names them."
)
@click.option(
    "--size", type=click.Choice(["T0", "T1", "T2", "T3"]), default="T1", show_default=True,
    help="0.8 x 0.6, 3 x 2, 8 x 6 or 20 x 15 mm; the last has no voxels.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Another one, another specimen.")
@click.option(
    "--instrument", "instruments", type=click.Choice(["ct", "sections", "stack", "image", "print"]), multiple=True,
    help="What is written; may be given again. All but 'stack' where not given.",
)  # fmt: skip
@click.option("--voxel-um", type=click.FloatRange(min=0.5), default=3.0, show_default=True, help="Voxel of the scan.")
@click.option(
    "--nuisance", "nuisances", multiple=True, metavar="NAME",
    help="Only these are on; may be given again. 'none': no nuisance at all. All are on where not given.",
)  # fmt: skip
@click.option("--out", "-o", type=click.Path(path_type=Path), help="Folder to make; it must not exist.")
@click.option("--list", "listed", is_flag=True, help="Name papers and nuisances and end.")
def specimen(
    paper: str,
    size: str,
    seed: int,
    instruments: tuple[str, ...],
    voxel_um: float,
    nuisances: tuple[str, ...],
    out: Path | None,
    listed: bool,
) -> int:
    """Make a specimen with known answers: files as instruments write them, and the truth apart from them.

    DIR gets scan/ (slices with the log file of NRecon), sections/ (photographs with the cut counter), image.ome.tif,
    printed.ome.tif, and truth/: maps on the pixels of the image, holes, poses, parameters. In scan/ and sections/ the
    sheet's normal runs along the rows: give --through y to link them.
    """
    from planish.io.run_folder import new_folder, refuse_existing
    from planish.synthetic import (
        MICRO_CT,
        NUISANCES,
        PRESETS,
        SIZES_UM,
        HoleParams,
        SpecimenParams,
        make_specimen,
        preset,
        with_only,
        write_image,
        write_instruments,
        write_nodes,
        write_truth,
    )

    if listed:
        _list()
        return 0
    if out is None:
        raise click.UsageError("Missing option '--out' / '-o': the folder to make.")
    if paper not in PRESETS:
        raise click.UsageError(f"--preset: there is no paper {paper!r}; there are {', '.join(PRESETS)}.")
    unknown = [name for name in nuisances if name not in NUISANCES and name != "none"]
    if unknown:
        raise click.UsageError(f"--nuisance: {', '.join(unknown)}: there is none of that name; --list names them all.")
    refuse_existing(out)
    chosen = instruments or ("ct", "sections", "image", "print")
    # A field of a millimetre has no room for the coded pattern.
    holes = HoleParams(pattern="irregular", count=3) if size == "T0" else HoleParams()
    params = SpecimenParams(
        size_um=SIZES_UM[size],
        paper=preset(paper),
        holes=holes,
        scanner=replace(MICRO_CT, voxel_um=voxel_um),
        seed=seed,
    )
    if nuisances:
        params = with_only(params, [name for name in nuisances if name != "none"])
    made = make_specimen(params)
    with new_folder(out) as folder:
        for name in chosen:
            click.echo(f"write: {name}", err=True)
            if name in _VOLUMES and size == "T3":
                continue
            if name in _VOLUMES:
                write_instruments(made, folder, volume=_VOLUMES[name], image=False)  # type: ignore[reportArgumentType]
            else:
                printed = name == "print"
                write_image(made, folder / f"{'printed' if printed else 'image'}.ome.tif", printed=printed)
        if size == "T3":
            write_nodes(made, folder / "nodes.npz")
        click.echo("write: truth", err=True)
        write_truth(made, folder / "truth")
    click.echo(f"specimen: {out}", err=True)
    return 0


def _list() -> None:
    from planish.cli.show import table
    from planish.synthetic import NUISANCES, PRESETS

    table("Papers", ("name", "what it is"), [(name, title) for name, (title, _) in PRESETS.items()])
    table("Nuisances", ("name", "what it is"), [(name, n.title) for name, n in NUISANCES.items()])
