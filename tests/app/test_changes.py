"""Changes of a session, and undo against a model that keeps every state."""

import json

import pytest

from planish.app import changes


def state():
    made = [
        {"id": f"m0-{k}", "label": f"hole {k}", "moving": (k, 2.0), "fixed": (3.0, k)}
        for k in (1, 2, 3)
    ]
    marks = tuple(map(changes.Mark.model_validate, made))
    return changes.State(marks={"sheet": marks, "other": ()}, first_layer="sheet")


def after(one, line, **change):
    return changes.applied(one, changes.numbered(changes.change_of(json.dumps(change)), line))


def test_added_and_imported_marks_get_the_id_of_their_line():
    found = after(state(), 7, do="add", moving=[10, 20]).of(None)[-1]
    assert (found.id, found.label, found.used) == ("m7", "mark 1", True)
    assert (found.moving.xy, found.moving.source, found.fixed) == ((10.0, 20.0), "clicked", None)
    mark = {"id": "m0", "label": "a", "moving": [1, 2], "fixed": [3, 4]}
    found = after(state(), 9, do="import", layer="other", marks=[mark, mark | {"label": "b"}])
    assert ([m.id for m in found.of("other")], len(found.of("sheet"))) == (["m9-1", "m9-2"], 3)


def test_a_moved_end_is_clicked_and_a_change_leaves_the_state_before():
    one = after(
        state(), 1, do="move", id="m0-1", moving={"x": 1, "y": 2, "cov_xx": 4, "source": "detected"}
    )
    two = after(one, 2, do="move", id="m0-1", fixed=[5, 6]).mark(None, "m0-1")
    assert (two.moving.cov_xx, two.moving.source) == (4.0, "detected")
    assert (two.fixed.xy, two.fixed.source) == ((5, 6), "clicked")
    before = state()
    kept = before.of(None)
    after(before, 1, do="delete", id="m0-2")
    assert before.of(None) is kept


@pytest.mark.parametrize(
    "change",
    [
        {"do": "add"},
        {"do": "add", "moving": [1, 2], "label": "hole 1"},
        {"do": "add", "moving": [1, 2], "label": "two\nlines"},
        {"do": "add", "moving": [1, 2], "label": " "},
        {"do": "add", "moving": [1, 2], "layer": "no"},
        {"do": "move", "id": "m0-1"},
        {"do": "move", "id": "m99", "moving": [1, 2]},
        {"do": "delete", "id": "m99"},
        {"do": "label", "id": "m0-1", "label": "hole 2"},
        {"do": "unregion", "id": "r1"},
    ],
)
def test_what_cannot_be_done_is_refused(change):
    with pytest.raises(changes.ChangeError):
        after(state(), 1, **change)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[[[",
        "[" * 100_000,
        "null",
        "{}",
        '{"do":"drop"}',
        '{"do":"add","moving":[1,NaN]}',
        '{"do":"add","moving":[1e400,0]}',
        '{"do":"add","moving":[1e10,0]}',
        '{"do":"add","moving":["1",2]}',
        '{"do":"add","moving":[true,2]}',
        '{"do":"add","moving":[1,2,3]}',
        '{"do":"add","moving":[1,2],"path":"/etc"}',
        '{"do":"use","id":"../x","used":true}',
        '{"do":"use","id":"m1","used":1}',
        '{"do":"model","model":"best"}',
        '{"do":"label","id":"m1","label":"' + "a" * 300 + '"}',
        '{"do":"add","label":"\\ud800","moving":[1,2]}',
        '{"do":"region","name":"a","polygon":[[0,0],[1,1]]}',
    ],
)
def test_what_is_no_change_is_refused(text):
    with pytest.raises(changes.ChangeError, match="This is no change"):
        changes.change_of(text)


# --- undo and redo against a slow model -----------------------------------------------------------
def random_change(draw, now):  # noqa: PLR0911
    ids = [m.id for m in now.of(None)]
    point = [draw.uniform(0, 100), draw.uniform(0, 100)]
    kinds = ["add", "model", "region", "correct"] + (
        ["move", "use", "delete", "label"] * 2 if ids else []
    )
    match draw.choice(kinds):
        case "add":
            return {"do": "add", draw.choice(["moving", "fixed"]): point}
        case "model":
            return {"do": "model", "model": draw.choice(["auto", "similarity", "affine", "tps"])}
        case "region":
            return {"do": "region", "name": "stain", "polygon": [point, [0, 0], [1, 0]]}
        case "correct":
            return {"do": "correct", "points": [{"z": 1, "y": 2, "x": 3, "face": "top"}]}
        case "move":
            return {"do": "move", "id": draw.choice(ids), "fixed": point}
        case "use":
            return {"do": "use", "id": draw.choice(ids), "used": draw.random() < 0.5}
        case "delete":
            return {"do": "delete", "id": draw.choice(ids)}
        case _:
            return {"do": "label", "id": draw.choice(ids), "label": f"label {draw.random()}"}
