"""Surfaces come back by meshio: nodes, cells, maps, colours; and which way is outside."""

import meshio
import numpy as np
import pytest
from tests.exports.contents import HISTORY, surface, written

from planish.core.errors import StudyError
from planish.exports import ExportParams, meshes

PARAMS = ExportParams(to="ply")


def expected():
    made = surface()
    known = np.isfinite(made.data["top"].values)
    y, x = np.meshgrid(made.data["y"].values, made.data["x"].values, indexing="ij")
    points = np.stack([x[known], y[known], made.data["top"].values[known]], axis=1)
    return points.astype(np.float32), made.data["coating_top"].values[known]


@pytest.mark.parametrize(("to", "name"), [("ply", "top.ply"), ("vtk", "top.vtu")])
def test_nodes_and_all_maps(tmp_path, to, name):
    path = written(surface(), tmp_path / name, to)
    found = meshio.read(path)
    points, values = expected()
    np.testing.assert_array_equal(found.points, points)
    np.testing.assert_array_equal(found.point_data["coating_top_um"], values)
    (cells,) = found.cells
    # a hole of 4 x 5 nodes takes 5 x 6 cells.
    assert (cells.type, len(cells)) == ("quad", 29 * 39 - 5 * 6)
    assert HISTORY.study_sha256.encode() in path.read_bytes()
    assert b"x, y, z of the volume" in path.read_bytes()


def test_ply_obj_and_stl_have_colours(tmp_path):
    found = meshio.read(written(surface(), tmp_path / "top.ply", "ply"))
    colours = np.stack([found.point_data[c] for c in ("red", "green", "blue")], axis=1).astype(
        np.uint8
    )
    assert colours[0].tolist() == [212, 214, 216]  # the first one has no value
    from matplotlib import colormaps

    assert colours[100].tolist() == [
        int(v) for v in colormaps["viridis"](100 / 1200, bytes=True)[:3]
    ]
    path = written(surface(), tmp_path / "top.obj", "obj")
    found = meshio.read(path)
    points, _ = expected()
    np.testing.assert_allclose(found.points[:, :3], points, rtol=1e-7)
    np.testing.assert_allclose(found.points[0, 3:], np.array([212, 214, 216]) / 255, atol=1e-4)
    assert len(found.cells[0]) == 29 * 39 - 30
    assert HISTORY.study_sha256 in path.read_text(encoding="utf-8")
    path = written(surface(), tmp_path / "top.stl", "stl")
    found = meshio.read(path)
    assert (found.cells[0].type, len(found.cells[0])) == ("triangle", 2 * (29 * 39 - 30))
    points, _ = expected()
    rows = {tuple(row) for row in points.tolist()}
    assert {tuple(row) for row in found.points.astype(np.float32).tolist()} <= rows
    data = path.read_bytes()
    assert data[:80].decode().startswith("planish 0.2.0, top, um, study abab")
    colour = np.frombuffer(data[84:], dtype=[("shape", "12f4"), ("colour", "<u2")])["colour"]
    assert (colour >> 15 == 1).all()
    assert len(set(colour.tolist())) > 20


@pytest.mark.parametrize("seen", [False, True])
@pytest.mark.parametrize("top", ["high", "low"])
@pytest.mark.parametrize("through", ["z", "y", "x"])
@pytest.mark.parametrize("name", ["top", "bottom"])
def test_cells_run_anticlockwise_as_seen_from_outside(through, top, name, seen):
    mesh = meshes.mesh_of(surface(through, top, name), PARAMS.model_copy(update={"as_seen": seen}))
    a, b, c = (mesh.points[mesh.quads[:, k]].astype(np.float64) for k in (0, 1, 2))
    up = np.cross(b - a, c - a)[:, "xyz".index(through)] * (1 if top == "high" else -1)
    if seen and through == "y":
        up = -up  # y itself is turned around
    assert (up > 0).all() if name == "top" else (up < 0).all()


def test_a_mesh_takes_every_kth_column_and_turns_y_as_displayed():
    fine, coarse = (
        meshes.mesh_of(surface(), PARAMS),
        meshes.mesh_of(surface(), PARAMS.model_copy(update={"mesh_um": 6.0})),
    )
    assert len(coarse.points) == 15 * 14 - 2 * 2  # without those in the hole
    assert {tuple(row) for row in coarse.points.tolist()} <= {
        tuple(row) for row in fine.points.tolist()
    }
    plain, seen = (
        meshes.mesh_of(surface(), PARAMS.model_copy(update={"as_seen": flag}))
        for flag in (False, True)
    )
    np.testing.assert_array_equal(seen.points, plain.points * [1, -1, 1])
    assert "sign turned" in seen.description


@pytest.mark.parametrize(
    ("mesh_um", "words"), [(1.0, "less than a column of 3 um"), (500.0, "no cell at these nodes")]
)
def test_a_mesh_that_cannot_be_is_refused(mesh_um, words):
    with pytest.raises(StudyError, match=words):
        meshes.mesh_of(surface(), PARAMS.model_copy(update={"mesh_um": mesh_um}))


@pytest.mark.parametrize("to", ["ply", "obj", "stl", "vtk"])
def test_the_same_surface_gives_the_same_bytes(tmp_path, to):
    one, two = (written(surface(), tmp_path / name, to).read_bytes() for name in ("one", "two"))
    assert one == two
