"""A server that other machines reach: it says what it exposes, and the page asks nothing but it."""

import re
import time

import pytest

from app.marks_page import expect, settled

pytestmark = pytest.mark.nightly

_INSIDE = ("data:", "blob:")


def said(path, seconds=10.0):
    """What a server wrote."""
    end = time.monotonic() + seconds
    while not (text := path.read_text()).endswith("\n"):
        assert time.monotonic() < end, "nothing was said"
        time.sleep(0.05)
    return text


def test_all_tabs_of_an_exposed_server_ask_nothing_of_other_machines(serve, window, chromium, run_copy, tmp_path):
    with (tmp_path / "said").open("w") as stderr:
        server = serve(run_copy, "--host", "0.0.0.0", "--expose", stderr=stderr)
    words = said(tmp_path / "said")
    for part in ("exposed on 0.0.0.0", "token included", "maps and marks", "can change them", "nothing is encrypted"):
        assert part in words
    assert server.token not in words

    context = chromium.new_context(viewport={"width": 1366, "height": 768})
    asked: list[str] = []
    context.on("request", lambda request: asked.append(request.url))
    shown = window(server, context=context)
    settled(shown)
    shown.role("tab", "Surfaces").click()
    expect(shown.role("status", "Slice position")).to_contain_text("µm")
    shown.role("tab", "Maps").click()
    expect(shown.page.get_by_text(re.compile("Scatter of [0-9]+ points"))).to_be_visible()
    shown.role("tab", "Flattening").click()
    expect(shown.role("img", "Sheet in space")).to_have_attribute("data-detail", "full")
    paths = {url.removeprefix(server.base) for url in asked}
    assert [url for url in asked if not url.startswith((f"{server.base}/", *_INSIDE))] == []
    for part in ("/api/state", "/api/tiles/", "/surfaces.js", "/maps.js", "/flattening.js", "/vendor/three.module.js"):
        assert any(path.startswith(part) for path in paths), part
    assert not any(server.token in url for url in asked), "the token is in the fragment, which is not sent"
