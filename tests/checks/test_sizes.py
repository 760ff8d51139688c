"""A size from a default resolution is a look, unless a registration confirms it."""

from types import SimpleNamespace

import pytest

from planish.checks import SizedLayer, run_checks
from planish.core.facts import InputFile
from planish.run.judging import _size_checks

DOUBT = "84.67 um a pixel is 300 dpi, which cameras and editors write by default."


def source(doubt, size_um=(84.67, 84.67)):
    return InputFile(
        name="i.jpg",
        shape=(9,) * len(size_um),
        dtype="uint8",
        bytes=9,
        sha256="",
        size_um=size_um,
        size_source="the JPEG resolution of 300 dpi",
        size_doubt=doubt,
    )


def layer(name, doubt, scale=None, to="", model="similarity"):
    registration = None
    if scale is not None:
        registration = SimpleNamespace(to=to, model=model, scale=scale)
    return SimpleNamespace(name=name, source=source(doubt), registration=registration)


@pytest.mark.parametrize(
    ("scale", "state", "words"),
    [(None, "look", "300 dpi"), (1.002, "pass", "confirms it"), (1.2, "look", "300 dpi")],
)
def test_a_doubted_size_is_a_look_unless_a_scale_confirms_it(scale, state, words):
    (check,) = run_checks(SizedLayer(source=source(DOUBT), scale=scale))
    assert check.state == state
    assert words in check.sentence
    assert ("`pixel_um=SIZE`" in check.remedy) == (state == "look")
    (check,) = run_checks(SizedLayer(source=source(DOUBT, (1, 1, 1))))
    assert "`voxel_um=SIZE`" in check.remedy
    assert run_checks(SizedLayer(source=source(""))) == []


@pytest.mark.parametrize(
    ("layers", "states"),
    [
        ([layer("sheet", "")], []),
        ([layer("sheet", "", 1.001, "image"), layer("image", DOUBT)], ["pass"]),
        ([layer("sheet", "", 1.5, "image"), layer("image", DOUBT)], ["look"]),
        ([layer("sheet", "", 1.0, "image", "rigid"), layer("image", DOUBT)], ["look"]),
        ([layer("a", DOUBT, 1.0, "b"), layer("b", DOUBT)], ["look", "look"]),
    ],
)
def test_only_a_layer_of_another_size_confirms(layers, states):
    assert [check.state for check in _size_checks(layers)] == states
