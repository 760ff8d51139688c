"""The line of a run: read, map, register, overlay, compare, judge, write.

Each step is one call. A layer is a :class:`~planish.run.study.GivenLayer`
in the study, a :class:`~planish.run.layers.MappedLayer` on its own grid once it is read or mapped,
and a :class:`~planish.run.layers.LinkedLayer` on the pixels of the reference.
"""

from pathlib import Path

from planish.run.compare import compare_layers
from planish.run.compute import Compute, Progress, silent
from planish.run.explain import with_declared_model
from planish.run.judging import judge_link, judge_sheet
from planish.run.map_scales import with_declared_scales
from planish.run.overlay import overlay_layers, take_light_off
from planish.run.reading import read_inputs
from planish.run.registering import register_layers
from planish.run.run import Run
from planish.run.study import Study
from planish.run.workspace import open_workspace


def run_study(
    study: Study,
    out: str | Path | None = None,
    *,
    compute: Compute | None = None,
    progress: Progress = silent,
    old: Path | None = None,
    figures: bool = False,
) -> Run:
    """Do what a study says, and write the run folder ``out`` where it is given.

    A run that was killed goes on where it stood when it is started again.

    Parameters
    ----------
    study : Study
    out : Path, optional
        Folder to make.
    compute : Compute, optional
        What the run may use.
    progress : callable, optional
        Called with the name of a stage and a few words.
    old : Path, optional
        A run of which stages are taken whose volume and parameters are the same.
    figures : bool
        Whether the run folder also holds the figures of the page as files, in ``figures``.

    Raises
    ------
    PlanishError
        Any of the tree in :mod:`planish.core.errors`; nothing is left at ``out`` then. What was
        mapped of a link stays beside it, as ``OUT-map``.
    """
    with open_workspace(study, out, compute or Compute(), progress, old) as work:
        with work.keeping_maps():
            inputs = read_inputs(study, work.regions, progress)
            layers = work.map_layers(inputs.layers)
            if study.is_link:
                layers, links = register_layers(study, layers, inputs.holes, progress)
                overlay = overlay_layers(study, layers, links, inputs.regions, work.store, progress)
                if study.correlate.light is not None:
                    overlay = take_light_off(study, overlay)
                comparison = compare_layers(study, overlay, progress)
                run = judge_link(study, overlay, comparison, inputs.holes)
            else:
                run = judge_sheet(study, layers[0])
            run = with_declared_scales(with_declared_model(run))
        return work.write(run, figures=figures)
