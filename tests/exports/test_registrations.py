"""Registrations in the files of other programs move points where planish moves them."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import map_coordinates
from tests.exports.contents import HISTORY, transform_pair

from planish.exports import FORMATS, ExportParams, transforms, writer_of

sitk = pytest.importorskip("SimpleITK")
RNG = np.random.default_rng(3)
SHEET = np.stack([RNG.uniform(-60, 1840, 200), RNG.uniform(-10, 1470, 200)], axis=1)
IMAGE = np.stack([RNG.uniform(0, 2100, 200), RNG.uniform(0, 1700, 200)], axis=1)
LIMIT_UM = 0.02  # 1/400 of a pixel in the middle of a cell, a little more beside it


def folder(tmp_path, to, *, bent, unit="um"):
    """Both directions as a folder of them has them."""
    pair, form = transform_pair(bent=bent), FORMATS[to]
    endings = form.endings_of(affine=not bent)
    for content in (pair.forward, pair.back) if form.apart else (pair,):
        name = content.name if form.apart else pair.forward.name
        writer_of(to)(
            content, tmp_path / f"{name}{endings[0]}", HISTORY, ExportParams(to=to, unit=unit)
        )
    names = ("sheet_to_image", "image_to_sheet") if form.apart else ("sheet_to_image",)
    assert {f"{name}{ending}" for name in names for ending in endings} == {
        path.name for path in tmp_path.iterdir()
    }
    return tmp_path


def pairs(bent):
    both = transform_pair(bent=bent)
    return (
        ("sheet_to_image", SHEET, both.forward.function),
        ("image_to_sheet", IMAGE, both.back.function),
    )


@pytest.mark.parametrize(("bent", "unit"), [(False, "um"), (True, "mm")])
def test_itk_reads_the_transform(tmp_path, bent, unit):
    scale = 1.0 if unit == "um" else 1e-3
    place = folder(tmp_path, "itk", bent=bent, unit=unit)
    for name, points, function in pairs(bent):
        text = (place / f"{name}.tfm").read_text(encoding="utf-8")
        assert HISTORY.study_sha256 in text
        transform = sitk.ReadTransform(str(place / f"{name}.tfm"))
        found = (
            np.array([transform.TransformPoint(point) for point in (points * scale).tolist()])
            / scale
        )
        assert np.abs(found - function(points)).max() < (LIMIT_UM if bent else 1e-6)
        # Far beside the layer the affine map holds, not the identity.
        far = [30000.0 * scale, -20000.0 * scale]
        off = (
            np.array(transform.TransformPoint(far)) / scale
            - function(np.array([[30000.0, -20000.0]]))[0]
        )
        assert np.abs(off).max() < 10.0


@pytest.mark.parametrize("bent", [False, True])
def test_itk_reads_the_field(tmp_path, bent):
    place = folder(tmp_path, "nrrd", bent=bent)
    for name, points, function in pairs(bent):
        field = sitk.ReadImage(str(place / f"{name}.nrrd"), sitk.sitkVectorFloat64)
        assert field.GetMetaData("value_unit") == "um"
        assert json.loads(field.GetMetaData("planish"))["study_sha256"] == HISTORY.study_sha256
        transform = sitk.DisplacementFieldTransform(field)
        found = np.array([transform.TransformPoint(point) for point in points.tolist()])
        assert np.abs(found - function(points)).max() < LIMIT_UM


def test_the_store_of_fields_is_read_by_another_library(tmp_path):
    import tensorstore as ts

    place = folder(tmp_path, "zarr", bent=True) / "sheet_to_image.zarr"
    about = json.loads((place / "zarr.json").read_text(encoding="utf-8"))["attributes"]
    assert about["format"] == "planish displacement 1"
    for name, points, function in pairs(bent=True):
        spec = {"driver": "zarr3", "kvstore": {"driver": "file", "path": ""}}
        x, y, dx, dy = (
            ts.open(spec | {"kvstore": {"driver": "file", "path": str(place / name / key)}})
            .result()
            .read()
            .result()
            for key in ("x", "y", "displacement_x", "displacement_y")
        )
        moved = points + RegularGridInterpolator((y, x), np.stack([dx, dy], axis=-1))(
            points[:, ::-1]
        )
        assert np.abs(moved - function(points)).max() < LIMIT_UM


def parameters(path):
    """Parameters of an elastix file by name, as text."""
    text = path.read_text(encoding="utf-8")
    return dict(re.findall(r"^\((\w+) (.*)\)$", text, flags=re.MULTILINE))


def numbers(text):
    return np.array(text.split(), dtype=float)


@pytest.mark.parametrize("bent", [False, True])
def test_elastix_parameters_are_the_map(tmp_path, bent):
    place = folder(tmp_path, "elastix", bent=bent)
    for name, points, function in pairs(bent):
        last = parameters(place / f"{name}.txt")
        at = points
        if bent:
            assert last["InitialTransformParametersFileName"] == f'"{name}_local.txt"'
            local = parameters(place / f"{name}_local.txt")
            assert (local["Transform"], local["BSplineTransformSplineOrder"]) == (
                '"BSplineTransform"',
                "1",
            )
            cols, rows = numbers(local["GridSize"]).astype(int)
            values = numbers(local["TransformParameters"]).reshape(2, rows, cols)
            origin, pitch = numbers(local["GridOrigin"]), numbers(local["GridSpacing"])
            index = ((points - origin) / pitch).T[::-1]
            at = points + np.stack(
                [map_coordinates(part, index, order=1) for part in values], axis=1
            )
        linear = numbers(last["TransformParameters"])
        middle = numbers(last["CenterOfRotationPoint"])
        moved = (at - middle) @ linear[:4].reshape(2, 2).T + middle + linear[4:]
        assert np.abs(moved - function(points)).max() < (LIMIT_UM if bent else 1e-6)
        assert (last["Size"], last["Spacing"]) == (
            ("640 500", "3 3") if name == "sheet_to_image" else ("534 435", "4 4")
        )


def test_a_field_is_as_fine_as_needed_and_missing_values_take_the_affine_map():
    bent, plain = (
        transforms.displacement(transform_pair(bent=True).forward),
        transforms.displacement(transform_pair(bent=False).forward),
    )
    assert plain.pitch_um == 192.0  # 64 pixels of 3 um: an affine map needs no more
    assert plain.error_um < 1e-9
    assert 10.0 < bent.pitch_um < 100.0
    assert bent.error_um <= 3.0 / 400
    # 3 um x (2 pi / 900 um)^2 / 8 x pitch^2 is what a wave leaves between nodes, in each direction.
    assert bent.error_um == pytest.approx(
        np.sqrt(2) * 3.0 * (2 * np.pi / 900) ** 2 / 8 * bent.pitch_um**2, rel=0.3
    )
    both = transform_pair(bent=True).forward
    cut = replace(
        both,
        function=lambda points: np.where(points[..., :1] > 500.0, np.nan, both.function(points)),
    )
    field = transforms.before_affine(cut)
    assert field.n_filled > 0
    assert np.isfinite(field.vectors).all()
    assert not field.vectors[:, -1].any()
