"""A base of single fibres: its mass, its voids, its faces, and a film below it."""

from dataclasses import replace

import numpy as np
import pytest

from planish.synthetic import (
    PRESETS,
    BurnParams,
    FibreParams,
    FilmParams,
    PaperParams,
    SpecimenParams,
    make_specimen,
)
from planish.synthetic.fibres import WALL_G_PER_CM3, Structure
from planish.synthetic.sheet import PITCH_UM, make_sheet

PAPER = PaperParams(
    base_um=50.0,
    coating_top_um=10.0,
    coating_bottom_um=10.0,
    coating_sd_um=3.8,
    least_coating_um=0.5,
    filler=0.0,
    roughness_um=3.2,
    fibres=FibreParams(g_per_m2=33.0),
)
NONE = np.zeros((0, 2))


def sheet_of(paper=PAPER, *, seed=0, size_um=900.0, **more):
    corner = np.array([0.5 * size_um, 0.4 * size_um])
    holes = more.pop("holes", NONE)
    return make_sheet(
        paper, BurnParams(), low=-corner, high=corner, centres=holes, seed=seed, **more
    )


@pytest.fixture(scope="module")
def sheet():
    return sheet_of()


def heights(structure):
    """Middles of the cells."""
    return structure.low_um + structure.cell_um * (np.arange(structure.density.shape[2]) + 0.5)


def test_a_base_has_the_mass_of_its_fibres_and_the_voids_of_paper(sheet):
    structure = sheet.structure
    mass = structure.density.sum(axis=2).mean() / 100 * structure.cell_um * WALL_G_PER_CM3
    assert mass == pytest.approx(PAPER.fibres.g_per_m2, rel=0.05)
    z = heights(structure)
    in_base = (z < sheet.faces[1][..., None]) & (z > sheet.faces[2][..., None])
    void = np.mean(structure.density[in_base] < 30)
    assert 0.35 < void < 0.6  # 40 to 55 % in papers of 50 to 135 g/m2
    near = in_base & (z > sheet.faces[1][..., None] - 5.0)
    # The face is a face of fibres.
    assert structure.density[near].mean() > structure.density[in_base].mean() + 10


@pytest.mark.parametrize("name", PRESETS)
def test_papers_by_name_have_their_thickness_and_keep_all_their_fibres(name):
    paper = PRESETS[name][1]
    sheet = sheet_of(replace(paper, filler=0.0), seed=2, size_um=550.0)
    top, inner, lower, bottom = (float(face.mean()) for face in sheet.faces)
    wanted = (paper.coating_top_um, paper.base_um, paper.coating_bottom_um)
    np.testing.assert_allclose((top - inner, inner - lower, lower - bottom), wanted, atol=0.3)
    assert (sheet.faces[1] - sheet.faces[2]).min() > 0.2 * paper.base_um
    structure = sheet.structure
    mass = structure.density.sum(axis=2).mean() / 100 * structure.cell_um * WALL_G_PER_CM3
    assert mass == pytest.approx(paper.fibres.g_per_m2, rel=0.08)


def test_the_coating_lies_on_every_fibre_and_its_faces_bound_the_walls(sheet):
    top, inner, lower, bottom = sheet.faces
    assert min((top - inner).min(), (lower - bottom).min()) >= PAPER.least_coating_um - 1e-3
    assert (top - inner).mean() == pytest.approx(PAPER.coating_top_um, abs=0.6)
    z = heights(sheet.structure)
    outside = (z > inner[..., None] + 1.0) | (z < lower[..., None] - 1.0)
    assert sheet.structure.density[outside].max() == 0


@pytest.mark.parametrize(("thickness_um", "is_seen"), [(20.0, True), (2.4, True), (1.6, False)])
def test_the_face_is_where_the_blurred_wall_reaches_half_of_its_grey(thickness_um, is_seen):
    # A wall of thickness t under a Gaussian of 4 um full width has a peak of erf(t / 2 / sqrt(2) /
    # 1.70 um): .5 at 2.3.
    cell, count = 0.2, 300
    z = cell * (np.arange(count) + 0.5)
    wall = np.where((z > 30 - thickness_um / 2) & (z < 30 + thickness_um / 2), 100, 0).astype(
        np.uint8
    )
    structure = Structure(density=np.broadcast_to(wall, (9, 9, count)), low_um=0.0, cell_um=cell)
    face = structure.face(4.0, PITCH_UM, top=True)
    if thickness_um > 10:
        assert face == pytest.approx(30 + thickness_um / 2, abs=0.05)
        assert structure.face(4.0, PITCH_UM, top=False) == pytest.approx(
            30 - thickness_um / 2, abs=0.05
        )
    assert np.isfinite(face).all() == is_seen


def test_a_film_lies_under_the_sheet_with_air_between_and_has_no_holes():
    film = FilmParams(film_um=20.0, gap_um=15.0)
    structure = sheet_of(film=film, size_um=600.0).structure
    z, bottom = heights(structure), sheet_of(size_um=600.0).faces[3].min()
    profile = structure.density[..., z < bottom]
    is_film = (profile == round(100 * film.grey)).all(axis=(0, 1))
    assert np.count_nonzero(is_film) * structure.cell_um == pytest.approx(20.0, abs=2.0)
    assert bottom - z[z < bottom][is_film].max() == pytest.approx(15.0, abs=1.5)
    assert structure.film_um == pytest.approx(bottom - 15.0, abs=0.1)


def test_a_film_under_a_slab_or_under_a_given_sheet_without_one_is_refused(sheet):
    for paper, given in ((PaperParams(), None), (PAPER, sheet)):
        with pytest.raises(ValueError, match="a film lies under a base of fibres only"):
            make_specimen(SpecimenParams(paper=paper, film=FilmParams()), sheet=given)
