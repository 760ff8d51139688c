"""What the tests of pages read of a page."""

import re
from html.parser import HTMLParser

VOID = {"meta", "link", "img", "br", "input"}


class Page(HTMLParser):
    """What a test asks of a page: sections, headings, figures, text, addresses; and that its tags are balanced."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.sections: list[str] = []
        self.drawings = 0
        self.images: list[dict[str, str]] = []
        self.addresses: list[str] = []
        self.metas: list[dict[str, str]] = []
        self.tags: set[str] = set()
        self.svgs: list[dict[str, str]] = []
        self.boxes: list[dict[str, str]] = []
        self.loose: list[str] = []
        self.handlers: list[str] = []
        self.words: dict[str, list[str]] = {}
        self._open: list[str] = []
        self._classes: list[str] = []
        self.feed(html)
        self.close()
        assert self._open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {k: v or "" for k, v in attrs}
        self.tags.add(tag)
        self.handlers += [k for k in given if k.startswith("on")]
        self.addresses += [given[k] for k in ("src", "href", "action", "srcset", "data") if k in given]
        if tag == "section":
            self.sections.append(given["id"])
        self.drawings += tag == "svg" and given.get("role") == "img"
        if tag == "svg" and "svg" not in self._open:
            self.svgs.append(given)
        style = given.get("class", "").split()
        if "scroll" in style:
            self.boxes.append(given)
        # What is wider than a narrow page: it must lie in a box that scrolls.
        wide = "wide" in style or (tag == "svg" and "svg" not in self._open and "full" in self._classes)
        if wide and "scroll" not in self._classes:
            self.loose.append(f"{tag} {style}")
        if tag == "image":
            self.images.append(given)
        if tag == "meta":
            self.metas.append(given)
        if tag not in VOID:
            self._open.append(tag)
            self._classes.append(given.get("class", ""))

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.handle_endtag(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self._open.pop() == tag, f"</{tag}> closes nothing"
        self._classes.pop()

    def handle_data(self, data: str) -> None:
        for tag in set(self._open):
            self.words.setdefault(tag, []).append(data)

    def text(self, tag: str = "body") -> str:
        return re.sub(r"[ \n]+", " ", "".join(self.words.get(tag, [])))
