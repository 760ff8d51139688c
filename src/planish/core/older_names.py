"""What older results call things, and what the same is called today.

Of results, studies and stores of maps alike; the changelog has the table.
"""

import re
from collections.abc import Container
from typing import Any

FORMAT = 4
"""Version of what a run writes; planish 0.1.0 wrote none, 0.2.0 wrote 2."""

_KEYS = {
    "ceiling": "attenuation_limit",
    "ceiling_noise": "attenuation_limit_noise",
    "ceiling_both": "attenuation_limit_both",
    "roughness": "roughness_about_centre",
    "second_opinion": "conley_interval",
    "silence": "reason",
    "twice": "agreement",
}
# A map, its error and its slopes, alone or after a layer's name, and no file or folder.
_OF_MAP = r"_(?=(?:top|bottom|difference|sd_ratio|correlation|n)(?:_se|_um|_x|_y)?\b(?![./\\]))"
_OF_TITLE = r"(?=,? \(?(?:top|bottom) )"
# Up to format 3 both were heights above the centre surface.
_WORDS = {
    rf"(?<![\w/\\])topography{_OF_MAP}": "half_thickness_",
    rf"(?<![\w/\\])roughness{_OF_MAP}": "roughness_about_centre_",
    rf"\bTopography{_OF_TITLE}": "Face above the centre surface",
    rf"\btopography{_OF_TITLE}": "face above the centre surface",
    rf"\bRoughness{_OF_TITLE}": "Roughness about the centre surface",
    rf"\broughness{_OF_TITLE}": "roughness about the centre surface",
    r"\bRelative grey\b": "Grey value, uncalibrated",
    r"\brelative grey\b": "grey value, uncalibrated",
}


def todays_names(stored: Any) -> Any:
    """Give JSON, or the attributes of maps, of an older format the names of today."""
    if isinstance(stored, dict):
        return {_KEYS.get(k) or todays_names(k): todays_names(v) for k, v in stored.items()}  # type: ignore[reportUnknownVariableType]
    if isinstance(stored, list | tuple):
        return [todays_names(part) for part in stored]  # type: ignore[reportUnknownVariableType]
    if isinstance(stored, str):
        for pattern, todays in _WORDS.items():
            stored = re.sub(pattern, todays, stored)
    return stored


def todays_study(stored: dict[str, Any]) -> dict[str, Any]:
    """Give a study of an older format the names of today, of maps to be measured what can be."""
    study = todays_names(stored)
    for layer in study["layers"]:
        names = layer["properties"]["maps"]
        layer["properties"]["maps"] = [_measured_today(name) for name in names]
    return study


def renamed(name: str) -> str:
    """A sentence on a map that older runs have, to follow a message; none on any other."""
    todays = _measured_today(todays_names(name))
    return "" if todays == name else f" Ask for {todays} in place of {name}, as older runs call it."


def _measured_today(name: str) -> str:
    return name.replace("roughness_about_centre", "roughness")  # whose form is the face's own


def height_map(side: str, maps: Container[object]) -> str:
    """Name of the heights of a face: its topography; of older maps, that above the centre."""
    older_name = f"half_thickness_{side}"
    topography = f"topography_{side}"
    return older_name if topography not in maps and older_name in maps else topography
