"""A volume of labels runs through the whole line: what is measured in grey values is left out,
nothing stops late."""

import numpy as np
import pytest
import tifffile
from scipy import ndimage

from planish.core.errors import InputError
from planish.run import as_study, open_run, run_study
from planish.surface import LabelParams, SurfaceParams

pytestmark = pytest.mark.ci


@pytest.fixture(scope="module")
def labels(specimen, tmp_path_factory):
    """The small specimen as another program would segment it: 0 air, 1 base, 2 coating."""
    grey = ndimage.gaussian_filter(specimen.volume.astype(np.float32), 0.7)
    air, base, coating = (float(np.percentile(grey, q)) for q in (5, 92, 99.8))
    paper = grey > 0.5 * (air + base)
    coat = ndimage.binary_dilation(grey > 0.5 * (base + coating), np.ones((3, 1, 1)))
    path = tmp_path_factory.mktemp("labels") / "labels.tif"
    tifffile.imwrite(path, np.where(paper, np.where(coat, 2, 1), 0).astype(np.uint8))
    return path


def study(labels, **sections):
    volume = {"path": str(labels), "voxel_um": (4.0, 4.0, 4.0)}
    return as_study({"volume": volume, "surface": SurfaceParams(labels=LabelParams()), **sections})


def test_labels_are_mapped_and_linked_to_the_end(labels, specimen_files, tmp_path):
    run = run_study(study(labels, image={"path": str(specimen_files[1])}), tmp_path / "run")
    assert "linked" in run.groups
    checks = {check.name for check in run.checks}
    assert {"coverage", "fold-over"} <= checks
    assert not {"saturation", "missing voxels"} & checks
    assert np.isfinite(run.groups["maps"]["thickness"].values).mean() > 0.5
    assert (tmp_path / "run" / "report.html").stat().st_size > 10_000


def test_grey_properties_of_labels_are_refused(labels, tmp_path):
    maps = ("porosity", "half_thickness_top")
    with pytest.raises(InputError, match=r"porosity.*: measured in grey values"):
        run_study(study(labels, properties={"maps": maps}), tmp_path / "run")


def test_halves_of_the_thickness_are_mapped_from_labels(labels, tmp_path):
    maps = ("half_thickness_top", "half_thickness_bottom")
    study_of_halves = study(labels, properties={"maps": maps})
    maps = run_study(study_of_halves, tmp_path / "run").maps
    total_um = maps["half_thickness_top"] + maps["half_thickness_bottom"]
    np.testing.assert_allclose(total_um, maps["thickness"], atol=1e-3)
    assert np.isfinite(total_um).mean() > 0.5


def test_labels_without_a_coating_are_said_on_the_command_line(passes, refuses, labels, tmp_path):
    """The base is then the whole sheet; the same label may not mean both."""
    out = tmp_path / "run"
    meaning = ("--labels", "--label-base", "1,2", "--voxel-um", "4")
    refuses("map", labels, *meaning, words="The label 2 was given two meanings")
    passes("map", labels, *meaning, "--label-coating", "none", "-o", out)
    maps = open_run(out).groups["maps"]
    np.testing.assert_allclose(maps["base_thickness"], maps["thickness"], atol=1e-3)
    assert open_run(out).study.layers[0].surface.labels.coating == ()
