"""What a message tells to do can be done: an option that it names is one of the command that said
it, or the command that has it is named."""

import re

import click
import messages
import numpy as np
import pytest
import tifffile

import planish as pl
from planish.cli import planish as group
from planish.cli.options import with_commands, words_of_command
from planish.core.errors import SizeError
from planish.core.parameter_words import in_terminal_words, names_in
from planish.io import describe
from planish.run.study import in_study_words

FLAG = re.compile(r"(?<![\w-])--[a-z][a-z0-9-]*")


def commands(command=group, name="planish"):
    """Every command, with those below it."""
    yield name, command
    if isinstance(command, click.Group):
        for key in command.list_commands(click.Context(command)):
            yield from commands(command.get_command(click.Context(command), key), f"{name} {key}")


COMMANDS = dict(commands())


def flags_of(command):
    options = [param for param in command.params if isinstance(param, click.Option)]
    return {flag for option in options for flag in option.opts if flag.startswith("--")}


ALL_FLAGS = set().union(*map(flags_of, COMMANDS.values())) | {"--help", "--version"}


def context(name):
    """The context in which a command runs."""
    outer = click.Context(group, info_name="planish")
    return click.Context(COMMANDS[name], parent=outer, info_name=name)


@pytest.mark.ci  # collects all messages
def test_every_option_that_a_message_names_exists():
    unknown = {
        (message.module, flag)
        for message in messages.messages()
        for flag in FLAG.findall(message.text)
        if flag not in ALL_FLAGS
    }
    assert unknown == set()


@pytest.mark.ci  # collects all messages
def test_every_command_that_a_message_names_has_the_options_beside_it():
    # The command and its options, as "planish link RUN IMAGE --out OTHER".
    written = re.compile(r"planish ([a-z]+)((?: [A-Z…][\w./…]*| \.\.\.| --[a-z-]+(?: [\w…]+)?)*)")
    faults = [
        f"{message.module}: planish {verb} {flag}"
        for message in messages.messages()
        for verb, options in written.findall(message.text)
        for flag in FLAG.findall(options)
        if flag not in flags_of(COMMANDS[f"planish {verb}"]) | {"--help"}
    ]
    assert faults == []


@pytest.mark.parametrize("name", [name for name in COMMANDS if name != "planish"])
def test_an_option_of_another_command_is_said_with_that_command(name):
    ctx, words = context(name), words_of_command(COMMANDS[name])
    for key in sorted({flag[2:].replace("-", "_") for flag in ALL_FLAGS - {"--help", "--version"}}):
        text = in_terminal_words(with_commands(f"Give `{key}`.", ctx))
        said = re.findall(r"'(planish [\w ]+)'", text)
        assert bool(said) is (key not in words), text
        for verb in said:
            assert key in words_of_command(COMMANDS[verb])


def test_several_options_are_said_with_the_fewest_commands():
    text = "Give `pixel_um=SIZE` and add `override_size=True`."
    assert with_commands(text, context("planish holes")) == text
    assert in_terminal_words(with_commands(text, context("planish flatten"))) == (
        "Give --pixel-um SIZE and add --override-size. --pixel-um and --override-size are options"
        " of 'planish link' and 'planish info'."
    )
    more = with_commands(
        "Check `hole_um`, or give `marks`, or `swap`.", context("planish register")
    )
    assert more.endswith(
        " `hole_um` and `marks` are options of 'planish link'. `swap` is an option of 'planish"
        " marks convert'."
    )
    named = "planish marks convert turns pixels into um, given `unit=pixel`."
    assert with_commands(named, context("planish register")) == named
    assert with_commands("`nonsense` is none.", context("planish map")) == "`nonsense` is none."


def test_a_study_names_the_section_of_the_image():
    text = "Give the right pixel size with `pixel_um` and add `override_size=True`."
    assert "add image.override_size" in in_study_words(text)
    assert "add volume.override_size" in in_study_words(text.replace("pixel", "voxel"))


# --- sizes: what info says is what the readers take ----------------------------------------------
VOXELS = np.random.default_rng(0).integers(0, 200, (20, 30, 40)).astype("u1")
UM = {axis: {f"PhysicalSize{a}": axis for a in "XYZ"} for axis in (2, 0.002, 3000, 900)}
PER_CM = {"resolution": (2500, 2500), "resolutionunit": "CENTIMETER"}  # pixels of 4 um
SITUATIONS = {
    "none": {},
    "of the slice alone": PER_CM,
    "ImageJ without spacing": {
        "imagej": True,
        "resolution": (0.5, 0.5),
        "metadata": {"unit": "um"},
    },
    "along x alone": {"resolution": (2500, 1), "resolutionunit": "CENTIMETER"},
    "72 dpi": {"resolution": (72, 72), "resolutionunit": "INCH"},
    "contradictory": {"metadata": UM[2]} | PER_CM,
    "mm as um": {"metadata": UM[0.002]},
    "nm as um": {"metadata": UM[3000]},
    "too large": {"metadata": UM[900]},
    "unusual and contradictory": {"metadata": UM[0.002]} | PER_CM,
}
STATED_FOR_IMAGES = ("of the slice alone", "ImageJ without spacing")
PLACEHOLDER = {"SIZE": 4.0, "Z": 4.0, "Y": 4.0, "X": 4.0}


def remedies(text, word):
    """Options of each way out that a message names: size and switches."""
    for way in text.split(" If it is meant, "):
        options = {
            name: True for name in names_in(way) if name in ("override_size", "unusual_size")
        }
        written = re.search(rf"Give [^.]*`{word}(?:=([^`]*))?`", way)
        if written:
            parts = (written[1] or "SIZE").split(",")
            sizes = [PLACEHOLDER.get(part) or float(part) for part in parts]
            options[word] = sizes[0] if len(sizes) == 1 else tuple(sizes)
        yield options


@pytest.mark.parametrize("kind", ["volume", "image"])
@pytest.mark.parametrize("situation", SITUATIONS)
def test_the_options_that_info_names_are_what_the_reader_needs(tmp_path, situation, kind):
    fields = {
        key: dict(v) if isinstance(v, dict) else v for key, v in SITUATIONS[situation].items()
    }
    is_ome = "metadata" in fields and "imagej" not in fields
    path = tmp_path / ("scan.ome.tif" if is_ome else "scan.tif")
    if kind == "image" and is_ome:
        fields["metadata"].pop("PhysicalSizeZ")
    if is_ome:
        fields["metadata"]["axes"] = "ZYX" if kind == "volume" else "YX"
    tifffile.imwrite(path, VOXELS if kind == "volume" else VOXELS[0], **fields)
    read, word = {
        "volume": (pl.read_volume, "voxel_um"),
        "image": (pl.read_image, "pixel_um"),
    }[kind]
    facts = describe(path)
    if situation in STATED_FOR_IMAGES and kind == "image":
        assert facts["size_um"] == list(read(path).attrs[word])
        return
    with pytest.raises(SizeError) as caught:
        read(path)
    assert caught.value.text in facts["warnings"]  # info says it in the same words
    command = COMMANDS["planish map" if kind == "volume" else "planish holes"]
    ways = list(remedies(caught.value.text, word))
    assert all(ways)
    for options in ways:
        assert read(path, **options).attrs[word]
        assert {*options} <= words_of_command(command)


@pytest.mark.ci
@pytest.mark.parametrize("verb", ["holes", "register", "resample", "view"])
def test_commands_that_read_an_image_take_a_size_in_place_of_its_own(verb):
    assert {"override_size", "unusual_size", "pixel_um"} <= words_of_command(
        COMMANDS[f"planish {verb}"]
    )


@pytest.mark.ci
def test_holes_are_found_with_the_options_that_the_refusal_names(passes, tmp_path):
    path, out = tmp_path / "image.ome.tif", tmp_path / "holes.json"
    fields = {"metadata": {"axes": "YX", "PhysicalSizeX": 2, "PhysicalSizeY": 2}} | PER_CM
    tifffile.imwrite(path, VOXELS[0], **fields)
    passes("holes", path, "-o", out, codes=(3,))
    passes("holes", path, "-o", out, "--pixel-um", "2", "--override-size")
    assert out.is_file()
