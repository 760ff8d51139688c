"""Check the built site: links lead somewhere, and reading a page fetches nothing from a network.

``python docs/_ext/check_site.py FOLDER`` names each fault and ends with 1 where there is one.
"""

from __future__ import annotations

import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

_LOADED = {
    "img": "src",
    "script": "src",
    "iframe": "src",
    "source": "src",
    "video": "src",
    "audio": "src",
    "link": "href",
}
# Kinds of <link> that a browser does not load.
_NAMED_ONLY = {"canonical", "index", "search", "next", "prev", "author"}


class Page(HTMLParser):
    """What a page links to, what it loads, and the places that it offers."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.places: set[str] = set()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note identifiers, links and loaded files of one tag."""
        values = {name: value or "" for name, value in attrs}
        self.places |= {values[name] for name in ("id", "name") if values.get(name)}
        if tag == "a" and values.get("href"):
            self.links.append(values["href"])
        target = values.get(_LOADED.get(tag, ""))
        if target and not (tag == "link" and values.get("rel", "") in _NAMED_ONLY):
            self.loads.append(target)


def faults(site: Path) -> list[str]:
    """Return a sentence for each broken link and each file that would come from a network."""
    # There: templates.
    written = [path for path in sorted(site.rglob("*.html")) if "_static" not in path.parts]
    pages = {path: Page(path.read_text(encoding="utf-8")) for path in written}
    found: list[str] = []
    for path, page in pages.items():
        name = path.relative_to(site).as_posix()
        for link in page.links:
            found += [f"{name}: {fault}" for fault in _fault_of_link(link, path, site, pages)]
        for link in page.loads:
            parts = urlsplit(link)
            if parts.scheme == "data":
                continue
            if parts.scheme or parts.netloc:
                found.append(f"{name}: loads {link} from a network")
            elif not (path.parent / unquote(parts.path)).exists():
                found.append(f"{name}: loads {link}, which is not there")
    for path in sorted(site.rglob("*.css")):
        remote = re.findall(
            r"(?:url\(|@import)\s*[\"']?((?:https?:)?//[^)\"']+)", path.read_text(encoding="utf-8")
        )
        found += [
            f"{path.relative_to(site).as_posix()}: loads {link} from a network" for link in remote
        ]
    return found


def _fault_of_link(link: str, path: Path, site: Path, pages: dict[Path, Page]) -> list[str]:
    parts = urlsplit(link)
    # By form only: a check that asks the network fails when others do.
    if parts.scheme in {"http", "https"}:
        return [] if re.fullmatch(r"[\w-]+(\.[\w-]+)+", parts.netloc) else [f"{link} names no host"]
    if parts.scheme:
        return [] if parts.scheme == "mailto" else [f"{link} has an unusual scheme"]
    target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    if target.is_dir():
        target /= "index.html"
    if site.resolve() not in target.resolve().parents or not target.exists():
        return [f"{link} leads to nothing"]
    known = pages.get(target)
    if parts.fragment and known is not None and unquote(parts.fragment) not in known.places:
        return [f"{link} leads to no place on that page"]
    return []


def main(folder: str) -> int:
    """Print every fault; 1 where there is one."""
    site = Path(folder).resolve()
    found = faults(site)
    print("\n".join(found) or f"Links are whole, nothing comes from a network: {folder}/index.html")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
