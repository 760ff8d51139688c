"""Libraries of the page: unchanged, with their licences, and asking nobody for anything."""

import hashlib
import re
import tomllib
from importlib.resources import files

import pytest

VENDOR = files("planish.app") / "static" / "vendor"
LISTED = tomllib.loads((VENDOR / "vendored.toml").read_text(encoding="utf-8"))


def test_every_library_is_listed_and_every_import_is_a_file():
    there = {file.name for file in VENDOR.iterdir() if file.name.endswith((".js", ".css"))}
    assert there == set(LISTED)
    # The page's policy allows no import map: a bare name would not be found.
    static = files("planish.app") / "static"
    for folder in (static, VENDOR):
        for file in folder.iterdir():
            if file.name.endswith(".js") and file.name != "ol.js":
                text = file.read_text(encoding="utf-8")
                for name in re.findall(
                    r"""^(?:import|export)\b[^;'"]*?from\s*["']([^"']+)["']""", text, re.MULTILINE
                ):
                    assert name.startswith("./"), f"{file.name} imports {name}"
                    assert folder.joinpath(*name[2:].split("/")).is_file(), (
                        f"{file.name} imports {name}"
                    )


@pytest.mark.parametrize("name", LISTED)
def test_a_library_is_the_one_that_is_listed(name):
    facts, data = LISTED[name], (VENDOR / name).read_bytes()
    assert hashlib.sha256(data).hexdigest() == facts["sha256"]
    assert (VENDOR / facts["licence_file"]).read_text(encoding="utf-8").strip()
    assert "sourceMappingURL" not in data.decode()
