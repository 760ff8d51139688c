"""Give a registration as other programs take it, as affine map and field.

The programs and formats are ITK, elastix, BigWarp, NRRD and zarr.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import zarr

from planish.core.files import write_text
from planish.core.grid import Grid
from planish.core.transform import Affine, grid_points
from planish.core.typing import Array, Bools, Floats, Ints, Pair, Shape2D, Texts, pair_of
from planish.exports.content import CORNERS, ExportHistory, Maps
from planish.exports.formats import ExportParams
from planish.marks.exchange import write_any


@dataclass(frozen=True, slots=True)
class DirectedTransform:
    """A transformation from one layer to another."""

    source: str
    target: str
    #: takes points (..., 2), (x, y) in um, of the source to the target, or NaN.
    function: Callable[[Floats], Floats]
    grid: Grid  #: pixels of the source
    affine: Affine  #: the affine map that is closest at the middle of the marks
    exact: bool  #: whether the affine map is all of it

    @property
    def name(self) -> str:
        """Name of its files: ``sheet_to_image``."""
        return f"{self.source}_to_{self.target}"


@dataclass(frozen=True, slots=True)
class TransformPair:
    """A registration in both directions, and its model."""

    forward: DirectedTransform
    back: DirectedTransform
    model: str


@dataclass(frozen=True, slots=True, eq=False)
class DisplacementField:
    """Displacements on a regular grid, between whose nodes they are linear."""

    vectors: Floats  # (rows, cols, 2): displacement along x and y in um
    origin_um: Pair  # place of the first node, (x, y)
    pitch_um: float  # distance of nodes
    error_um: float  # largest error in the middle of a cell, over the source layer
    n_filled: int  # nodes without a value, where the affine map stands

    @property
    def shape(self) -> Shape2D:
        """Rows and columns of nodes."""
        return self.vectors.shape[0], self.vectors.shape[1]

    def facts(self) -> dict[str, float]:
        """Errors of the field, for the history."""
        return {
            "largest_error_um": float(f"{self.error_um:.3g}"),
            "nodes_by_affine_map": self.n_filled,
        }


def displacement(transform: DirectedTransform) -> DisplacementField:
    """Sample what has to be added to a point of the source to get its image.

    The samples cover the source and a tenth around it.
    """
    return _sampled(transform, lambda points: points, np.eye(2))


def before_affine(transform: DirectedTransform) -> DisplacementField:
    """Sample what is added to a point of the source before the affine map.

    Beside the field the affine map holds alone.
    """
    return _sampled(transform, transform.affine, transform.affine.inverse.matrix())


def _sampled(
    transform: DirectedTransform, near: Callable[[Floats], Floats], factor: Floats
) -> DisplacementField:
    """Sample ``factor @ (function - near)`` as coarsely as it may be.

    ``near`` takes points (..., 2), (x, y) in um, to places close to those that the transform takes
    them to; ``factor`` (2, 2) turns what is left into the displacement that is stored. The pitch is
    halved until the field is fine enough.
    """
    grid = transform.grid
    pixel_um = np.array(grid.pixel_um[::-1])  # along x and y, as all that follows
    size_um = np.array(grid.shape[::-1]) * pixel_um
    # Of the layer's longer side: the field reaches so far beyond it.
    margin_um = 0.1 * float(size_um.max())
    low_um = np.array(grid.origin_um) - 0.5 * pixel_um - margin_um
    length_um = size_um + 2 * margin_um
    high_um = low_um + length_um
    # At most so many pixels of the layer between nodes.
    pitch_um = 64 * float(np.sqrt(pixel_um.prod()))

    def nodes(node_shift: float, n_nodes: Ints) -> Floats:
        """Places of nodes (rows, cols, 2), or with a shift of half a cell its middles."""
        steps = [np.arange(n - (node_shift > 0)) + node_shift for n in n_nodes]
        return low_um + pitch_um * grid_points(*steps)

    def offsets(points: Floats) -> tuple[Floats, Bools]:
        """What is stored at points before ``factor``, and where the transform takes them at all."""
        images = transform.function(points)
        has_image = np.asarray(np.isfinite(images).all(axis=-1))
        images[~has_image] = transform.affine(points[~has_image])
        return images - near(points), has_image

    while True:
        n_nodes = np.ceil(length_um / pitch_um).astype(np.intp) + 1
        centres = nodes(0.5, n_nodes)
        vectors, has_image = offsets(nodes(0.0, n_nodes))
        # In the middle of a cell the field is the mean of its corners; the transform may differ.
        sampled, is_inside = offsets(centres)
        interpolated = np.zeros_like(sampled)
        for corner in CORNERS:
            interpolated += 0.25 * vectors[corner]
            is_inside &= has_image[corner]
        is_over_layer = (centres >= low_um + margin_um) & (centres <= high_um - margin_um)
        is_inside &= is_over_layer.all(axis=-1)
        errors_um = np.linalg.norm(interpolated - sampled, axis=-1)
        error_um = float(errors_um[is_inside].max(initial=0.0))
        # In the middle between nodes it may err by so much. An affine map needs no finer grid.
        if error_um <= 1 / 400 * pixel_um.min() or 2 * vectors.size > 2_000_000:  # nodes
            break
        pitch_um /= 2
    n_filled = int(np.count_nonzero(~has_image))
    return DisplacementField(vectors @ factor.T, pair_of(low_um), pitch_um, error_um, n_filled)


UNITS = {"um": 1.0, "mm": 1e-3}
_DIRECTION = (1, 0, 0, 1)  # of the axes, as a matrix row by row
_FALSE = ["false"]
_TRUE = ["true"]
_NO_TRANSFORM = "NoInitialTransform"


def write_itk(
    transform: DirectedTransform, path: Path, history: ExportHistory, params: ExportParams
) -> None:
    """Write an affine transform as text, or a composite of one with a displacement field before it.

    A composite applies its last transform first. Points are those of planish, x and y in the unit
    asked for; images whose first pixel lies elsewhere than at 0 need their origin.
    """
    per_um = UNITS[params.unit]
    matrix_and_shift, center = _affine_parameters(transform, per_um)
    affine_lines = _itk_transform("AffineTransform", matrix_and_shift, center)
    lines = ["#Transform 0", *affine_lines]
    field_facts: dict[str, float] = {}
    if not transform.exact:
        field = before_affine(transform)
        field_facts = field.facts()
        rows, cols = field.shape
        places = [per_um * um for um in (*field.origin_um, field.pitch_um, field.pitch_um)]
        geometry = [cols, rows, *places, *_DIRECTION]
        vectors = (field.vectors * per_um).ravel()
        lines = ["#Transform 0", "Transform: CompositeTransform_double_2_2"]
        lines += ["#Transform 1", *affine_lines]
        lines += ["#Transform 2", *_itk_transform("DisplacementFieldTransform", vectors, geometry)]
    title = f"#{transform.name}: {history.json(**field_facts)}"
    _write_lines(path, ["#Insight Transform File V1.0", title, *lines])


def _itk_transform(
    class_name: str, parameters: Iterable[float], fixed_parameters: Iterable[float]
) -> list[str]:
    """Lines of a transform in two dimensions with its numbers."""
    lines = [f"Transform: {class_name}_double_2_2"]
    for keyword, values in (("Parameters", parameters), ("FixedParameters", fixed_parameters)):
        numbers = [f"{float(v):.12g}" for v in values]
        lines.append(" ".join([f"{keyword}:", *numbers]))
    return lines


def write_elastix(
    transform: DirectedTransform, path: Path, history: ExportHistory, params: ExportParams
) -> None:
    """Write transform parameters for ``transformix -tp``.

    A field before the affine map stands in ``NAME_local.txt``.

    elastix takes fixed points to moving ones: ``image_to_sheet.txt`` brings maps onto the image,
    and points of the image into the sheet. A B-spline of first order is linear between nodes; its
    coefficients are displacements.
    """
    per_um = UNITS[params.unit]
    # The image that transformix makes lies on the pixels of the source.
    grid = transform.grid
    raster = {
        "Size": grid.shape[::-1],
        "Index": [0, 0],
        "Spacing": [um * per_um for um in grid.pixel_um[::-1]],
        "Origin": [um * per_um for um in grid.origin_um],
        "Direction": _DIRECTION,
        "UseDirectionCosines": _TRUE,
    }
    note = f"// {transform.name}: takes points of {transform.source} to {transform.target}. "
    initial_file = _NO_TRANSFORM
    if not transform.exact:
        field = before_affine(transform)
        initial_file = f"{transform.name}_local.txt"
        coefficients = np.moveaxis(field.vectors, -1, 0).ravel() * per_um
        bspline = _elastix_parameters("BSplineTransform", coefficients, _NO_TRANSFORM)
        field_grid = {
            "GridSize": field.shape[::-1],
            "GridIndex": [0, 0],
            "GridSpacing": [field.pitch_um * per_um] * 2,
            "GridOrigin": [um * per_um for um in field.origin_um],
            "GridDirection": _DIRECTION,
            "BSplineTransformSplineOrder": [1],
            "UseCyclicTransform": _FALSE,
        }
        field_note = note + history.json(**field.facts())
        _write_elastix_file(path.with_name(initial_file), field_note, bspline | field_grid | raster)
    matrix_and_shift, center = _affine_parameters(transform, per_um)
    affine = _elastix_parameters("AffineTransform", matrix_and_shift, initial_file)
    affine["CenterOfRotationPoint"] = center
    # Beside the image stands -1e30: elastix reads no NaN, and 0 would be taken for a measurement.
    resampling = {
        "ResampleInterpolator": ["FinalBSplineInterpolator"],
        "FinalBSplineInterpolationOrder": [1],
        "Resampler": ["DefaultResampler"],
        "DefaultPixelValue": [-1e30],
        "ResultImageFormat": ["nrrd"],
        "ResultImagePixelType": ["float"],
        "CompressResultImage": _FALSE,
    }
    _write_elastix_file(path, note + history.json(), affine | raster | resampling)


def write_zarr(
    pair: TransformPair, path: Path, history: ExportHistory, _params: ExportParams
) -> None:
    """Write a group for each direction: ``displacement_x`` and ``displacement_y`` (y, x) in um.

    ``y`` and ``x`` are places of the nodes in the layer that the direction starts from.
    """
    root = zarr.open_group(path, mode="w-", zarr_format=3)
    root.attrs["format"] = "planish displacement 1"
    root.attrs["model"] = pair.model
    root.attrs["history"] = history.json()
    for transform in (pair.forward, pair.back):
        source = transform.source
        target = transform.target
        field = displacement(transform)
        group = root.create_group(transform.name)
        group.attrs.update({"source": source, "target": target} | field.facts())
        arrays: dict[str, tuple[Any, Texts, str]] = {}  # values, dims and name in words
        for k, axis in ((1, "y"), (0, "x")):  # vectors and places are (x, y), the field is (y, x)
            steps = np.arange(field.shape[1 - k])
            coords_um = field.origin_um[k] + field.pitch_um * steps
            arrays[axis] = (coords_um, (axis,), f"{axis} of {source}")
        for k, axis in enumerate("xy"):
            long_name = f"{axis} of {target} minus {axis} of {source}"
            arrays[f"displacement_{axis}"] = (field.vectors[..., k], ("y", "x"), long_name)
        for name, (values, dims, long_name) in arrays.items():
            array = group.create_array(
                name, shape=values.shape, dtype=values.dtype, dimension_names=dims
            )
            array[...] = values
            array.attrs.update({"units": "um", "long_name": long_name})


def write_landmarks(
    marks: xr.Dataset, path: Path, _history: ExportHistory, _params: ExportParams
) -> None:
    """Write marks as landmarks of BigWarp."""
    write_any(marks, path, to="bigwarp")


def _affine_parameters(
    transform: DirectedTransform, per_um: float
) -> tuple[list[float], list[float]]:
    """Matrix and shift of the affine map, and the point around which it turns.

    The matrix stands row by row; shift and point are (x, y) in the unit of the other program,
    ``per_um`` of which make a um.
    """
    affine = transform.affine
    source, target = np.array([affine.source, affine.target]) * per_um
    matrix_and_shift: list[float] = [*affine.matrix().ravel(), *(target - source)]
    return matrix_and_shift, list(source)


def _elastix_parameters(
    class_name: str, parameters: Sequence[float] | np.ndarray, first_file: str
) -> dict[str, Sequence[object]]:
    """What every transform of elastix states; it is applied after that of ``first_file``."""
    return {
        "Transform": [class_name],
        "NumberOfParameters": [len(parameters)],
        "TransformParameters": [float(v) for v in parameters],
        "InitialTransformParametersFileName": [first_file],
        "HowToCombineTransforms": ["Compose"],
        "FixedImageDimension": [2],
        "MovingImageDimension": [2],
        "FixedInternalImagePixelType": ["float"],
        "MovingInternalImagePixelType": ["float"],
    }


def _write_elastix_file(
    path: Path, note_text: str, parameters: Mapping[str, Sequence[object]]
) -> None:
    lines = [note_text]
    for name, values in parameters.items():
        value_texts = [f'"{v}"' if isinstance(v, str) else f"{v:.12g}" for v in values]  # type: ignore[str-format]
        lines.append(f"({name} {' '.join(value_texts)})")
    _write_lines(path, lines)


def _write_lines(path: Path, lines: Iterable[str]) -> None:
    write_text(path, "\n".join(lines) + "\n")


def write_nrrd(
    content: DirectedTransform | Maps, path: Path, history: ExportHistory, params: ExportParams
) -> None:
    """Write one map, or the displacement (x, y) of every node of a field, behind a header in text.

    Sizes and places are in the unit asked for, and so are displacements. Beside the field other
    programs take 0.
    """
    unit = params.unit
    if isinstance(content, DirectedTransform):
        field = displacement(content)
        title = f"displacement of points of {content.source} to {content.target}"
        dtype = field.vectors.dtype
        components = ["vector"]
        shape = field.shape
        x, y = field.origin_um
        dx_um = dy_um = field.pitch_um
        value_unit = unit
        note = history.json(**field.facts())
        blocks: Iterable[Array] = [field.vectors * UNITS[unit]]
    else:
        (name,) = content.names
        title = content.titles[name]
        dtype = content.dtype_of(name)
        components = []
        shape = content.shape
        y, x = content.origin_um
        dy_um, dx_um = content.pixel_um
        value_unit = content.units[name]
        note = history.json(**content.facts())
        blocks = (band for _, band in content.bands(name))
    per_um = UNITS[unit]
    x, y, dx, dy = (f"{um * per_um:.12g}" for um in (x, y, dx_um, dy_um))
    rows, cols = shape
    # The axis that runs fastest comes first: x and y of a vector, then columns, then rows.
    axis_sizes = [*("2" for _ in components), str(cols), str(rows)]
    nrrd_type = {"float32": "float", "float64": "double"}.get(dtype.name, dtype.name)
    header_lines = [
        "NRRD0005",
        f"content: {title}",
        f"type: {nrrd_type}",
        f"dimension: {len(axis_sizes)}",
        "space dimension: 2",
        f"sizes: {' '.join(axis_sizes)}",
        f"space directions: {'none ' * len(components)}({dx},0) (0,{dy})",
        f"kinds: {' '.join([*components, 'domain', 'domain'])}",
        "endian: little",
        "encoding: raw",
        f'space units: "{unit}" "{unit}"',
        f"space origin: ({x},{y})",
        f"value_unit:={value_unit}",
        f"planish:={note}",
    ]
    with path.open("wb") as file:
        file.write(("\n".join(header_lines) + "\n\n").encode())
        for block in blocks:
            file.write(np.ascontiguousarray(block, block.dtype.newbyteorder("<")).data)
