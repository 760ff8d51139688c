"""The hash of the package's sources, and what depends on it."""

from planish.core import source_hash
from planish.run import compute


def test_names_and_bytes_of_the_sources_count_and_nothing_else(tmp_path, monkeypatch):
    monkeypatch.setattr(source_hash, "PACKAGE", tmp_path)
    states = list[str]()

    def state():
        states.append(source_hash.hash_sources.__wrapped__())
        return states[-1]

    (tmp_path / "stage").mkdir()
    (tmp_path / "stage" / "a.py").write_bytes(b"a = 1\n")
    before = state()
    (tmp_path / "page.html").write_text("no code")
    assert source_hash.hash_sources.__wrapped__() == before
    (tmp_path / "stage" / "a.py").write_bytes(b"a = 2\n")
    state()
    (tmp_path / "stage" / "a.py").rename(tmp_path / "a.py")
    state()
    (tmp_path / "b.py").write_bytes(b"")
    state()
    assert (len(set(states)), {len(text) for text in states}) == (4, {16})


def test_tiles_of_other_code_are_not_used_again(monkeypatch):
    before = compute.run_key({"a": 1}, ["hash"])
    assert compute.run_key({"a": 1}, ["hash"]) == before
    monkeypatch.setattr(compute, "hash_sources", lambda: "0" * 16)
    assert compute.run_key({"a": 1}, ["hash"]) != before
