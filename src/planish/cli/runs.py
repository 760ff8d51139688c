"""Commands that make a run: link, map, run, demo.

A study file for one, new; how the options become a study.
"""

import ctypes
import filecmp
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import click

from planish.analyze.params import CorrelateParams
from planish.cli.console import animated, sentence
from planish.cli.options import (
    PATH,
    Command,
    Option,
    build_params,
    existing,
    figures_option,
    given_options,
    json_option,
    options,
    out_option,
    stack,
    strict_option,
    verb,
    wrong_usage,
)
from planish.cli.show import finish, run_facts, stages
from planish.cli.time_left import TimeLeft, expected_stages
from planish.core.errors import PlanishError
from planish.core.files import free_path
from planish.core.source_hash import is_this_code
from planish.core.typing import Entries, Texts
from planish.flatten.params import FlattenParams
from planish.io.params import ImageParams, VolumeParams
from planish.marks.params import HoleParams
from planish.measure.params import MeasureParams
from planish.register.params import RegistrationParams
from planish.run.compute import Compute
from planish.run.study import EDITS, EDITS_APPLIED, RUN_TOML, AboutParams, Study
from planish.surface.params import SurfaceParams

OUT = "Folder to make for the results; it must not exist."
volume_options = options(VolumeParams, "Volume")
image_options = options(ImageParams, "Image")
# Of images alone: a run says them once, with those of the volume.
_SIZE_WORDS = ("override_size", "unusual_size")
image_size_options = options(VolumeParams, "Image", only=_SIZE_WORDS)
surface_options = options(SurfaceParams, "Surface search")
property_options = options(MeasureParams, "Properties")
hole_options = options(HoleParams, "Marks and registration")
compute_options = options(Compute, "Resources")
_run_options = stack(
    volume_options,
    surface_options,
    property_options,
    options(FlattenParams, "Flattening"),
    options(AboutParams, "Page"),
    compute_options,
    figures_option,
    strict_option,
    json_option,
)
_folder_option = out_option("Folder to make; a new one where not given.", required=False)


def _set_option(text: str) -> Command:
    return click.option(
        "--set", "changes", multiple=True, metavar="[LAYER.]SECTION.NAME=VALUE", help=text
    )


def image_params(path: Path, values: Entries) -> ImageParams:
    """How an image is read, with the words on its size that it shares with a volume."""
    sizes = {name: bool(values[name]) for name in _SIZE_WORDS}
    return build_params(ImageParams, values, path=str(path), **sizes)


def study_from(layers: tuple[str | Path, ...], values: Entries, *, chain: bool = False) -> Study:
    """Build a study from the command line; what is wrong with it is wrong usage."""
    from planish.run.build import study_of, words_of
    from planish.run.study import with_paths

    with wrong_usage():
        study = study_of(layers, given_options(values, words_of()), chain=chain)
    return with_paths(study, lambda path: str(Path(path).absolute()))


def _reuse_freed_memory() -> None:
    """Have arrays of up to 32 MB take memory that others left, as fresh pages take long.

    glibc does so by itself once it was given back as much; others do as they do.
    """
    with suppress(AttributeError, OSError, TypeError):
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(-3, 32 << 20)  # M_MMAP_THRESHOLD
        mallopt(-1, 64 << 20)  # M_TRIM_THRESHOLD


def _run_and_show(
    study: Study,
    out: Path,
    values: Entries,
    *,
    changes: Texts = (),
    old_run: Path | None = None,
) -> int:
    """Run a study into ``out``, show it, and give the exit code.

    ``values`` are the options of the command; ``changes`` those of ``--set``, each NAME=VALUE;
    ``old_run`` is the one whose stages may be taken over.
    """
    from planish.run import run_study
    from planish.run.study import with_values

    _reuse_freed_memory()
    with wrong_usage("--set: "):
        study = with_values(study, changes) if changes else study
    time_left = TimeLeft(expected_stages(study)) if animated() else None
    with stages(8 + 3 * len(study.layers), time_left) as progress:
        compute = build_params(Compute, values)
        figures = values.get("figures", False)
        run = run_study(
            study, out, progress=progress, compute=compute, old=old_run, figures=figures
        )
    return finish(run, out, as_json=values["as_json"], strict=values["strict"])


@verb(
    "planish link volume.tif image.tif --out run",
    "planish link run bottom.tif --out run-bottom --image-side bottom --pixel-um 2.6",
)
@click.argument("layers", nargs=-1, required=True, metavar="LAYER... REFERENCE")
@out_option(OUT)
@image_options
@hole_options
@options(RegistrationParams, "Marks and registration")
@options(CorrelateParams, "Correlation")
@click.option(
    "--chain",
    is_flag=True,
    cls=Option,
    group="Marks and registration",
    help="Register each layer to the next one, and so on to the reference.",
)
@_set_option(
    "Set a parameter of one layer, such as large.image.pixel_um=5.3,5.3 for the layer large=PATH;"
    " may be given again."
)
@_run_options
def link(layers: Texts, out: Path, chain: bool, changes: Texts, **values: Any) -> int:
    """Link layers of one specimen to the last of them: all maps on its pixels, correlation, report.

    A layer is a volume (TIFF stack, folder of slices or sections, store), the folder of a run that
    planish made of one, or an image (TIFF, PNG, JPEG); NAME=PATH gives it a name. All show the same
    specimen, marked with laser holes.

    'planish link VOLUME IMAGE --out RUN' is the usual case: all 3D properties on the image's own
    pixels. RUN gets maps.zarr, marks.json, results.json, report.html and run.toml. With two
    volumes, two images or more than two layers, the flattened maps and images are laid onto the
    last layer (docs/linking.md). Options of volumes hold for all of them; --set gives one layer
    another value.
    """
    if len(layers) < 2:
        raise click.UsageError(
            "Something to link it to is missing: give two layers or more, the reference last."
        )
    return _run_and_show(study_from(layers, values, chain=chain), out, values, changes=changes)


@verb(
    "planish map volume.tif --out run",
    "planish map scan/ --out run --voxel-um 1.37 --through y --memory 4GB",
    name="map",
)
@existing("volume")
@out_option(OUT)
@_run_options
def map_(volume: Path, out: Path, **values: Any) -> int:
    """Map VOLUME: flattened maps of all properties, without an image."""
    return _run_and_show(study_from((volume,), values), out, values)


@verb(
    "planish run study.toml --out run",
    "planish run run/run.toml --out again --threads 2",
    "planish run run/run.toml --set correlate.point_um=50 --out run-50",
)
@existing("study")
@_folder_option
@_set_option(
    "Change a parameter, such as registration.model=affine, or of one layer"
    " sheet.surface.cutoff_um=600; may be given again. Stages whose parameters stay are taken from"
    " the run beside STUDY."
)
@compute_options
@strict_option
@json_option
def run(study: Path, out: Path | None, changes: Texts, **values: Any) -> int:
    """Run a STUDY, or repeat a run.

    STUDY is a file of 'planish new', or the run.toml of a run.

    Mistakes in STUDY are reported with line, key and the likely word. A run that is repeated
    without changes has the same bytes; files that differ from those beside STUDY are listed.
    """
    from planish.report import FIGURES
    from planish.run.study import in_study_words, read_study

    if study.is_dir():
        study = study / RUN_TOML
    parsed = read_study(study)
    old_run = None
    default_out = study.with_suffix("")
    if study.name == RUN_TOML:
        old_run = study.absolute().parent  # the run that STUDY is of
        default_out = old_run.with_name(f"{old_run.name}-{'2' if changes else 'again'}")
        values["figures"] = (old_run / FIGURES).is_dir()
    out_folder = out or free_path(default_out)
    try:
        code = _run_and_show(
            parsed, out_folder, values, changes=changes, old_run=old_run if changes else None
        )
    except PlanishError as error:
        raise type(error)(in_study_words(error.text)) from error
    if old_run is not None and not changes:
        _compare(old_run, out_folder)
    return code


def _compare(old_run: Path, new_run: Path) -> None:
    """Say which files of a repeated run differ from those of the run before.

    Of a run of another version, which has other files, that alone.
    """
    from planish.run.run import MAPS

    old_facts = run_facts(old_run)
    if old_facts is not None and old_facts["warning"]:
        click.echo(f"{old_run.name} was {old_facts['warning']}", err=True)
        return
    if not (old_run / "results.json").is_file():
        return
    files = _files_of(old_run) | _files_of(new_run)
    _, differing, unmatched = filecmp.cmpfiles(old_run, new_run, files, shallow=False)
    names = sorted([*differing, *unmatched])
    text = "same bytes as"
    if names:
        verb = "differs" if len(names) == 1 else "differ"
        text = f"{', '.join(_phrases(names, MAPS))} {verb} from"
    origin_text = ""
    if old_facts is not None and not is_this_code(old_facts["planish"], old_facts["code"]):
        origin_text = f", which was made by other code (planish {old_facts['planish']})"
    click.echo(f"{new_run}: {text} {old_run}{origin_text}", err=True)


def _phrases(names: Sequence[str], store: str) -> list[str]:
    """Files by name; those of the store, of which a map has many, as a count and their groups."""
    stored = [Path(name).parts for name in names if name.startswith(f"{store}/")]
    phrases = [name for name in names if not name.startswith(f"{store}/")]
    if stored:
        # Deeper ones lie in the folder of a group.
        groups = {parts[1] for parts in stored if len(parts) > 2}
        store_text = f"{store} ({', '.join(sorted(groups))})" if groups else store
        phrases.insert(0, f"{len(stored)} file{'s' * (len(stored) > 1)} of {store_text}")
    return phrases


def _files_of(run: Path) -> set[str]:
    """Files of a run that are compared: no hidden note of maps, and no changes in the browser."""
    names: set[str] = set()
    for path in run.rglob("*"):
        if not path.is_file() or path.name.startswith("."):
            continue
        file = path.relative_to(run)
        if file.parts[0] != EDITS or file.name in EDITS_APPLIED:
            names.add(file.as_posix())
    return names


@verb("planish demo", "planish demo --out try --seed 2")
@_folder_option
@click.option("--seed", default=1, show_default=True, help="Another seed gives another specimen.")
@strict_option
@json_option
def demo(out: Path | None, seed: int, **values: Any) -> int:
    """Make a synthetic specimen with laser holes, link it, and show what comes out."""
    from dataclasses import replace

    from planish.synthetic import DEMO, make_specimen, write_instruments

    folder = out or free_path(Path("planish-demo"))
    width, height = (um / 1000 for um in DEMO.size_um)
    click.echo(f"specimen: a warped sheet of {width:g} x {height:g} mm, seed {seed}", err=True)
    files = write_instruments(make_specimen(replace(DEMO, seed=seed)), folder / "specimen")
    assert files.image is not None
    return _run_and_show(study_from((files.volume, files.image), {}), folder / "run", values)


@verb(
    "planish new study.toml volume.tif image.tif",
    "planish new study.toml scan/",
    "planish run study.toml",
)
@existing("study")
@existing("volume")
@click.argument("image", required=False, type=PATH)
def new(study: Path, volume: Path, image: Path | None) -> None:
    """Write STUDY, a commented file with all options, for VOLUME and IMAGE.

    'planish run STUDY' then carries it out.

    It holds what the files state: sizes, shapes, grey values, the axis that seems to run through
    the sheet. What they do not state is listed at its top, with line numbers. Without IMAGE, the
    study maps VOLUME.
    """
    from planish.core.errors import FileError
    from planish.core.files import write_whole
    from planish.io.run_folder import refuse_existing
    from planish.run.study_template import draft_study

    if study.suffix.lower() != ".toml":
        raise click.UsageError(f"STUDY comes first and ends in .toml; {study} does not.")
    refuse_existing(study)
    draft = draft_study(volume, image, home=study.absolute().parent, name=study.name)
    if not study.absolute().parent.is_dir():
        raise FileError(f"The folder of {study} does not exist. Make it, or choose another one.")
    write_whole(study, draft.text.encode())
    click.echo(f"{study}: written")
    for is_needed, advice in ((True, "fill in"), (False, "look at")):
        for gap in draft.missing:
            if gap.needed is is_needed:
                sentence(f"{advice} line {gap.line}, {gap.key}: {gap.why}")
    click.echo(f"then: planish run {study}")
