"""Commands that do the whole line for one volume: map, run, demo, import; properties and info."""

from __future__ import annotations

import filecmp
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

import click

from planish.cli.options import (
    SURFACE,
    Memory,
    Numbers,
    channel_option,
    column_option,
    compute_options,
    correction_options,
    direction_option,
    existing,
    json_option,
    meaning_of,
    out_option,
    property_options,
    section_options,
    surface_options,
    volume_options,
)
from planish.cli.show import fact_lines, finish, finish_layers, run_facts, run_lines, stages

if TYPE_CHECKING:
    from planish.pipeline import Run
    from planish.study import LayersStudy, Study

OUT = "Folder to make for the results; it must not exist."


def volume_section(path: Path, options: dict[str, Any]) -> dict[str, Any]:
    """What the options say of a volume, for the study."""
    return {
        "path": str(path.absolute()),
        "voxel_um": options["voxel_um"],
        "through": options["through"],
        "top": options["top"],
        "override_size": options["override_size"],
        "channel": options["volume_channel"],
        "column_um": options["column_um"],
        "fixed_rows": options["fixed_rows"],
        "fixed_cols": options["fixed_cols"],
        "md_deg": options["md_deg"],
    }


def surface_section(options: dict[str, Any]) -> dict[str, Any]:
    """What the options say of the surface search."""
    return {k: options[k] for k in SURFACE} | {"labels": meaning_of(options)}


def properties_section(options: dict[str, Any]) -> dict[str, Any]:
    """What the options say of further maps."""
    names = ("maps", "rays", "coating_g_cm3", "base_g_cm3", "grammage_g_m2", "coat_weight_top_g_m2",
             "coat_weight_bottom_g_m2", "solid_grey", "ink_grey")  # fmt: skip
    return {k: options[k] for k in names}


def checked(data: dict[str, Any]) -> Study:
    """Build the study of one volume; a value out of range is wrong usage."""
    from planish.study import Study

    return cast("Study", validated(Study, data))


def validated(kind: type[Any], data: dict[str, Any]) -> Any:
    """Build a study from what the options say; a value out of range is wrong usage."""
    from pydantic import ValidationError

    try:
        return kind.model_validate(data)
    except ValidationError as error:
        faults = "; ".join(f"{_option(e['loc'])}{e['msg'].removeprefix('Value error, ')}" for e in error.errors())
        raise click.UsageError(faults) from error


def _option(place: tuple[Any, ...]) -> str:
    words = [str(part) for part in place if not isinstance(part, int)]
    return f"--{words[-1].replace('_', '-')}: " if len(words) > 1 else ""


def run_and_show(
    study: Study | LayersStudy, out: Path, *, as_json: bool, options: dict[str, Any] | None = None,
    sheet: Run | None = None,
) -> int:  # fmt: skip
    """Do what a study says, show it, and return the exit code."""
    from planish.compute import Compute
    from planish.pipeline import run_study
    from planish.study import LayersStudy

    told = options or {}
    compute = Compute(**{k: told.get(k) for k in ("memory_bytes", "threads", "scheduler")})
    if isinstance(study, LayersStudy):
        with stages(3 * len(study.layers) + 2) as tell:
            layers = run_study(study, out, progress=tell, compute=compute)
        return finish_layers(layers, out, as_json=as_json)
    with stages(11 if study.image is not None else 8) as tell:
        run = run_study(study, out, progress=tell, compute=compute, sheet=sheet)
    return finish(run, out, as_json=as_json)


@click.command("map")
@existing("volume")
@out_option(OUT)
@volume_options
@direction_option
@channel_option
@section_options
@column_option
@surface_options
@property_options
@compute_options
@json_option
def map_(volume: Path, out: Path, as_json: bool, **options: Any) -> int:
    """Map VOLUME: flattened maps of all properties, without an image."""
    study = checked(
        {
            "volume": volume_section(volume, options),
            "surface": surface_section(options),
            "properties": properties_section(options),
        }
    )
    return run_and_show(study, out, as_json=as_json, options=options)


@click.command()
@existing("study")
@click.option(
    "--out", "-o", type=click.Path(path_type=Path), help="Folder to make; beside the old one where not given."
)
@compute_options
@json_option
def run(study: Path, out: Path | None, as_json: bool, **options: Any) -> int:
    """Repeat the run described by STUDY, the run.toml of a run folder.

    The result has the same bytes; files that differ from those beside STUDY are named.
    """
    from planish.study import read_study

    checked = read_study(study)
    old = study.absolute().parent
    target = out or _free(old.with_name(f"{old.name}-again"))
    code = run_and_show(checked, target, as_json=as_json, options=options)
    if (old / "results.json").is_file():
        different = _different(old, target)
        text = "same bytes as" if not different else f"{', '.join(different)} differ from"
        click.echo(f"{target}: {text} {old}", err=True)
    return code


def _different(old: Path, new: Path) -> list[str]:
    """Name the files of either folder that are not the same in both."""
    files = {p.relative_to(root).as_posix() for root in (old, new) for p in root.rglob("*") if p.is_file()}
    return sorted(
        name
        for name in files
        if not (
            (old / name).is_file() and (new / name).is_file() and filecmp.cmp(old / name, new / name, shallow=False)
        )
    )


def _free(path: Path) -> Path:
    """Give the first of path, path-2, path-3 ... that does not exist."""
    candidate, k = path, 1
    while candidate.exists():
        k += 1
        candidate = path.with_name(f"{path.name}-{k}")
    return candidate


@click.command()
@click.option("--out", "-o", type=click.Path(path_type=Path), help="Folder to make; planish-demo here where not given.")
@click.option("--seed", default=1, show_default=True, help="Another number gives another specimen.")
@json_option
def demo(out: Path | None, seed: int, as_json: bool) -> int:
    """Make a synthetic specimen with laser holes, link it, and show what comes out."""
    from dataclasses import replace

    from planish.io.run_folder import refuse_existing
    from planish.synthetic import DEMO, make_specimen, write_instruments

    folder = out or _free(Path("planish-demo"))
    refuse_existing(folder)
    width, height = (um / 1000 for um in DEMO.size_um)
    click.echo(f"specimen: a warped sheet of {width:g} x {height:g} mm, seed {seed}", err=True)
    files = write_instruments(make_specimen(replace(DEMO, seed=seed)), folder / "specimen")
    assert files.image is not None
    study = checked({"volume": {"path": str(files.volume.absolute())}, "image": {"path": str(files.image.absolute())}})
    return run_and_show(study, folder / "run", as_json=as_json)


@click.command("import")
@existing("volume")
@out_option("Store to make, such as sheet.zarr; it must not exist.")
@click.option(
    "--voxel-um",
    type=Numbers(3, repeat=True, metavar="SIZE|Z,Y,X"),
    help="Voxel size in um, where the file does not state it.",
)
@click.option("--override-size", is_flag=True, help="Take the size given here where the file states another.")
@click.option("--through", type=click.Choice(["z", "y", "x"]), default="z", help="Serial sections: as for a run.")
@channel_option
@section_options
@correction_options
@click.option("--ome", type=click.Choice(["0.5", "0.4"]), default="0.5", show_default=True, help="Version of OME-Zarr.")
@click.option("--memory", "memory_bytes", type=Memory(), help="Most memory to use, such as 4GB; half of what is free.")
def import_(volume: Path, out: Path, ome: Literal["0.5", "0.4"], memory_bytes: int | None, **options: Any) -> None:
    """Bring VOLUME into a working store: chunked, in several resolutions, with checksums.

    For volumes that do not fit into memory. Serial sections are aligned and joined on the way; give --through for them.
    The store is OME-Zarr and opens in other programs too. An import that was killed goes on where it stood when the
    same command is given again.
    """
    from planish.cli.stages import corrected_for_import
    from planish.compute import Compute
    from planish.io.run_folder import refuse_existing
    from planish.io.store import write_store
    from planish.pipeline import read_whole

    refuse_existing(out)
    compute = Compute(memory_bytes=memory_bytes)
    study = checked({"volume": volume_section(volume, options | {"top": "high", "column_um": None, "md_deg": None})})
    with stages(2) as tell:
        data = read_whole(study.volume, compute, tell)
        data, write_record = corrected_for_import(data, out, options, memory_bytes=compute.volume_bytes, tell=tell)
        write_store(
            data, out, memory_bytes=compute.volume_bytes, ome=ome,
            tell=lambda what, done, count: tell(what, f"block {done} of {count}"),
        )  # fmt: skip
    write_record()
    click.echo(f"{out}: {' x '.join(map(str, data.shape))} voxels")


@click.command()
def properties() -> None:
    """List the maps that --property takes: name, unit and what they show."""
    from planish.cli.show import table
    from planish.measure import registered

    table("Properties", ("name", "unit", ""), [(p.name, p.units, p.long_name) for p in registered().values()])


@click.command()
@existing("path")
@json_option
def info(path: Path, as_json: bool) -> int:
    """Tell what PATH holds: shape, type, voxel or pixel size and where it was read, grey values, what looks wrong."""
    from planish.io import describe

    run = run_facts(path)
    facts = run or describe(path)
    if as_json:
        click.echo(json.dumps(facts, indent=2, allow_nan=False))
        return 0
    for line in run_lines(facts) if run else fact_lines(facts):
        click.echo(line)
    return 0
