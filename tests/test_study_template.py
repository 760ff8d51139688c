"""``planish new`` writes a study that can be run, and ``planish run`` runs it."""

import re
import tomllib

import numpy as np
import pytest
import tifffile

from planish.core.options import Params
from planish.run import as_study, draft_study, read_study, study_of

KEY = re.compile(r"^#(\w+) = ([^#]*)", re.MULTILINE)


@pytest.fixture(scope="module")
def draft(specimen_files, tmp_path_factory):
    home = tmp_path_factory.mktemp("draft")
    draft = draft_study(*specimen_files, home=home, name="study.toml")
    (home / "study.toml").write_text(draft.text, encoding="utf-8", newline="\n")
    return draft, home / "study.toml"


def test_it_is_the_study_of_link_with_what_the_files_state(draft, specimen_files):
    assert read_study(draft[1]) == study_of(specimen_files, {})
    text = draft[0].text
    assert 'through = "z"  # along which the grey changes most' in text
    assert "#voxel_um = [4.0, 4.0, 4.0]  # um; as stated" in text
    assert "#pixel_um = [5.0, 5.0]  # um; as stated" in text
    assert re.search(r"# volume\.tif: TIFF, \d+ x \d+ x \d+ voxels \(z, y, x\), uint8", text)
    assert max(map(len, text.splitlines())) <= 110


def fields(model, place=()):
    for name, field in model.model_fields.items():
        inner = field.annotation
        if isinstance(inner, type) and issubclass(inner, Params):
            yield from fields(inner, (*place, name))
        else:
            yield (*place, name)


def test_every_option_stands_in_it_with_its_default(draft):
    """Taking the signs away changes nothing, but for options without a default, which are left as
    they are."""
    text, path = draft[0].text, draft[1]
    found = list(KEY.finditer(text))
    given = read_study(path)
    examples = {
        "neutral",
        "refine",
        "side",
        "marks",
        "design",
        "headline",
        "regions",
        "air",
        "base",
        "coating",
        "void",
    }
    examples |= {"channel", "corrections", "white", "dark", "gamma", "light"}

    def taken(match):
        try:
            tomllib.loads(match[0][1:])
        except tomllib.TOMLDecodeError:
            assert re.search(r"[A-Z]{1,6}", match[2]), "a word for what is to be filled in"
            return match[0]
        return match[0] if match[1] in examples else match[0][1:]

    whole = as_study(tomllib.loads(KEY.sub(taken, text)))
    drop = {"path", "voxel_um", "pixel_um"}

    def plain(study):
        return [
            {k: v for k, v in part.items() if k not in drop} if isinstance(part, dict) else part
            for layer in study.model_dump()["layers"]
            for part in layer.values()
        ] + [study.holes, study.registration, study.correlate]

    assert plain(whole) == plain(given)
    names = {match[1] for match in found} | {"path", "through"}
    for model in (
        type(given.layers[0].surface),
        type(given.layers[0].properties),
        type(given.layers[0].flatten),
        type(given.layers[0].volume),
        type(given.layers[1].image),
        type(given.holes),
        type(given.registration),
        type(given.correlate),
    ):
        assert {name[-1] for name in fields(model)} <= names | {"labels"}, model


def test_labels_become_a_table_at_the_end_of_theirs(draft):
    text = (
        draft[0]
        .text.replace("#[surface.labels]", "[surface.labels]")
        .replace("#base = [1]", "base = [1, 3]")
    )
    assert as_study(tomllib.loads(text)).layers[0].surface.labels.base == (1, 3)


def test_what_is_missing_is_listed_with_its_line(planish, refuses, tmp_path):
    values = np.random.default_rng(0).integers(0, 255, (12, 20, 30)).astype(np.uint8)
    tifffile.imwrite(tmp_path / "scan.tif", values)
    study = tmp_path / "study.toml"
    code, out, err = planish("new", study, tmp_path / "scan.tif")
    assert (code, err) == (0, "")
    lines = study.read_text(encoding="utf-8").splitlines()
    assert "path = 'scan.tif'" in lines
    line = next(k for k, text in enumerate(lines, 1) if text.startswith("#voxel_um"))
    assert lines[line - 1] == "#voxel_um = [Z, Y, X]  # um; fill in"
    assert f"fill in line {line}, volume.voxel_um: scan.tif states no voxel size" in out
    assert f"#   line {line}: volume.voxel_um: scan.tif states no voxel size" in "\n".join(lines)
    assert "the axis through the sheet, which the grey does not tell" in out
    assert "--" not in "\n".join(lines), "keys, no options of the command line"
    refuses("run", study, words="Give it with volume.voxel_um", out=False)


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("volume", "image"), 2, "STUDY comes first and ends in .toml"),
        (("s.toml", "image", "volume"), 3, "is an image. Give the volume first"),
        (("s.toml", "volume", "volume"), 3, "is a volume. Give the volume first"),
        (("s.toml", "run", "image"), 3, "is a run, which was mapped already"),
        (("s.toml", "nothing.tif"), 3, "nothing.tif does not exist"),
        (("nowhere/s.toml", "volume"), 3, "The folder of"),
        (("con.toml", "volume"), 3, "Windows keeps that name"),
    ],
)
def test_what_is_refused_writes_nothing(refuses, specimen_files, tmp_path, arguments, code, words):
    run = tmp_path / "a run"
    (run / "maps.zarr").mkdir(parents=True)
    (run / "run.toml").touch()
    known = {"volume": specimen_files[0], "image": specimen_files[1], "run": run}
    refuses(
        "new",
        *(known.get(word, tmp_path / word) for word in arguments),
        words=words,
        code=code,
        out=False,
    )


def test_mistakes_come_before_work(refuses, draft, tmp_path):
    path = tmp_path / "study.toml"
    text = draft[0].text.replace('through = "z"', 'thruogh = "z"')
    path.write_text(text, encoding="utf-8", newline="\n")
    line = text[: text.index("thruogh")].count("\n") + 1
    refuses(
        "run", path, words=f"line {line}, volume.thruogh: unknown; did you mean through?", out=False
    )


def test_the_study_gives_what_link_gives(passes, draft, linked_run, monkeypatch):
    monkeypatch.chdir(draft[1].parent)
    out, _ = passes("run", "study.toml", codes=(0, 4))
    assert "report: study/report.html" in out.replace("\\", "/")
    for name in ("results.json", "marks.json", "figures.csv"):
        assert (draft[1].parent / "study" / name).read_bytes() == (linked_run / name).read_bytes()
