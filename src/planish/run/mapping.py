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
    for params in study.layers:
        if params.kind == "volume" and params.name not in work.sheets:
            work.sheets[params.name] = map_layer(
                params,
                compute=work.compute,
                progress=work.progress,
                tile_dir=work.tile_folder(params.name),
                old_sheet=work.similar_sheets.get(params.name),
            )
    mapped = {**work.sheets, **layers}
    return [mapped[params.name] for params in study.layers]
