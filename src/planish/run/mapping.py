"""Map the volumes of a study that are not mapped yet."""

from collections.abc import Mapping

from planish.run.layers import MappedLayer
from planish.run.sheet import map_layer
from planish.run.study import Study
from planish.run.workspace import Workspace


def map_layers(
    study: Study, layers: Mapping[str, MappedLayer], work: Workspace
) -> list[MappedLayer]:
    """Give all layers of a study in its order: those read, and the sheets of its volumes."""
    for given in study.layers:
        if given.kind == "volume" and given.name not in work.sheets:
            work.sheets[given.name] = map_layer(
                given,
                compute=work.compute,
                progress=work.progress,
                tile_dir=work.tile_folder(given.name),
                old_sheet=work.similar_sheets.get(given.name),
            )
    mapped = {**work.sheets, **layers}
    return [mapped[given.name] for given in study.layers]
