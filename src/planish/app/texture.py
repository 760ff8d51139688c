"""Tiles of texture as the marks of a session: where the texture shows the place, or where a person says that it is."""

from planish.app.changes import ChangeError, Import
from planish.app.session import Session, pairs_of
from planish.core.transform import Similarity
from planish.core.typing import Pair
from planish.io.map_groups import read_group
from planish.run import register_texture
from planish.run.run import MAPS
from planish.run.study import changed


def texture_marks(session: Session, layer: str, *, near: Pair | None, place: Similarity | None) -> tuple[Import, str]:
    """Tiles of the maps in the image in place of all marks, and in words what was found.

    ``near``: about where the middle of the maps lies in the image, in um; ``place``: where it lies. Undecided where no
    place stands out, CannotRegister where too few tiles show it, ChangeError for a run that is linked.
    """
    if session.image is None:
        raise ChangeError("This run is linked. Link it anew by its texture: planish link ... --by texture.")
    holes = session.holes(layer)
    registration = register_texture(
        read_group(session.folder / MAPS, "maps"),
        session.image,
        params=changed(session.study.registration, near=near),
        mirrored=session.mirrored(layer),
        holes=(holes["moving"], holes["fixed"]),
        place=place,
    )
    return Import(layer=layer, marks=pairs_of(registration.marks)), registration.sentence or ""
