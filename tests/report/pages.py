"""What the tests of pages read of a page."""

import re
from html.parser import HTMLParser

HOSTILE = "<script>alert('x')</script>\"><img src=x onerror=alert(1)> $\\frac$ 紙 {{ 7*7 }}"
VOID = {"meta", "link", "img", "br", "input"}


class Page(HTMLParser):
    """What a test asks of a page: sections, headings, figures, text, addresses; and that its tags
    are balanced."""

    def __init__(self, html):
        super().__init__()
        self.sections = []
        self.drawings = 0
        self.images = []
        self.addresses = []
        self.metas = []
        self.tags = set()
        self.svgs = []
        self.boxes = []
        self.loose = []
        self.handlers = []
        self.words = {}
        self._open = []
        self._classes = []
        self.feed(html)
        self.close()
        assert self._open == []

    def handle_starttag(self, tag, attrs):
        given = {k: v or "" for k, v in attrs}
        self.tags.add(tag)
        self.handlers += [k for k in given if k.startswith("on")]
        self.addresses += [
            given[k] for k in ("src", "href", "action", "srcset", "data") if k in given
        ]
        if tag == "section":
            self.sections.append(given["id"])
        self.drawings += tag == "svg" and given.get("role") == "img"
        if tag == "svg" and "svg" not in self._open:
            self.svgs.append(given)
        style = given.get("class", "").split()
        if "scroll" in style:
            self.boxes.append(given)
        # What is wider than a narrow page: it must lie in a box that scrolls.
        wide = "wide" in style or (
            tag == "svg" and "svg" not in self._open and "full" in self._classes
        )
        if wide and "scroll" not in self._classes:
            self.loose.append(f"{tag} {style}")
        if tag == "image":
            self.images.append(given)
        if tag == "meta":
            self.metas.append(given)
        if tag not in VOID:
            self._open.append(tag)
            self._classes.append(given.get("class", ""))

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.handle_endtag(tag)

    def handle_endtag(self, tag):
        assert self._open.pop() == tag, f"</{tag}> closes nothing"
        self._classes.pop()

    def handle_data(self, data):
        for tag in set(self._open):
            self.words.setdefault(tag, []).append(data)

    def text(self, tag="body"):
        return re.sub(r"[ \n]+", " ", "".join(self.words.get(tag, [])))


def captions_of(html):
    return re.findall(r"<figcaption>(.*?)</figcaption>", html, flags=re.DOTALL)


def assert_alone(page):
    """A page fetches nothing and runs nothing."""
    assert {a.split(":")[0] for a in page.addresses if not a.startswith("#")} == {"data"}
    assert not page.tags & {"script", "iframe", "object", "embed", "form"}
    assert page.handlers == []
