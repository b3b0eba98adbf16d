"""Bad configurations: for each the place, the path and what the sentence says."""

from __future__ import annotations

from pathlib import Path

import pytest
from attrs import frozen

from uoarm.config import Problem, inspect

HEAD = "version: 1\nbridges: {python: {}}\nfunctions:\n"


@frozen
class Bad:
    """A configuration, and what must be reported of it."""

    text: str
    line: int
    column: int
    path: str
    says: str


def one(component: str) -> str:
    """A configuration of one function, its component in line 5 from column 7 on."""
    return f"{HEAD}  f:\n    components: [{component}]\n"


def component(rest: str) -> str:
    return one(f"{{name: a, bridge: python, {rest}}}")


def needing(text: str) -> str:
    """A configuration of one function with needs, which begin in line 4 after column 14."""
    return f"{HEAD}  f: {{needs: {{{text}}}}}\n"


def fed(function: str, source: str) -> str:
    return (
        f"  {function}: {{components: [{{name: c_{function}, bridge: python, "
        f"input: {{from: {source}, endpoint: [x]}}, output: {{endpoint: [x]}}}}]}}\n"
    )


def source(function: str, output: str = "output: {endpoint: [x]}") -> str:
    return f"  {function}: {{components: [{{name: c_{function}, bridge: python, {output}}}]}}\n"


AT = "$.functions.f.components[0]"

YAML = {
    "tab": Bad("version: 1\n\tbridges: {}\n", 2, 1, "$", "use spaces"),
    "no first character": Bad("a: %x\n", 1, 4, "$", "(write text in quotes)"),
    "open bracket": Bad("version: [1\n", 2, 1, "$", "this is not YAML"),
    "begun where": Bad("a: 1\nb: [1,\n  2\n", 4, 1, "$", "begun in line 2"),
    "control character": Bad("version: 1\na: \x01\n", 2, 4, "$", "U+0001"),
    "two documents": Bad("version: 1\n---\nversion: 1\n", 2, 1, "$", "one file holds one"),
    "empty": Bad("", 1, 1, "$", "the file is empty"),
    "only a comment": Bad("# nothing\n", 1, 1, "$", "the file is empty"),
    "python tag": Bad("a: !!python/object:os.system x\n", 1, 4, "$.a", "!!python/object:os.system"),
    "tag on a mapping": Bad("a: !!map {}\n", 1, 4, "$.a", "!!map"),
    "tag on a key": Bad("!!int 1: x\n", 1, 1, "$", "!!int"),
    "number as key": Bad("1: x\n", 1, 1, '$["1"]', "is not text (write it in quotes)"),
    "boolean as key": Bad("a: {true: x}\n", 1, 5, "$.a.true", "is not text"),
    "null as key": Bad("a: {~: x}\n", 1, 5, '$.a["~"]', "is not text"),
    "list as key": Bad("[1]: x\n", 1, 1, "$", "not a mapping or a list"),
    "alias as key": Bad("a: &x b\n*x : c\n", 2, 1, "$", "an alias cannot be a key"),
    "merge key": Bad("a: &x {b: 1}\nc: {<<: *x}\n", 2, 5, "$.c", "merge keys"),
    "no anchor": Bad("a: *x\n", 1, 4, "$.a", "*x"),
    "alias within itself": Bad("a: &x [*x]\n", 1, 8, "$.a[0]", "*x"),
    "key twice": Bad("version: 1\na: 2\nversion: 3\n", 3, 1, "$.version", "first in line 1"),
    "key twice, deep": Bad("a:\n  - b: 1\n    b: 2\n", 3, 5, "$.a[0].b", "first in line 2"),
    "nan": Bad("version: .nan\n", 1, 10, "$.version", "not a number of JSON"),
    "infinity": Bad("version: -.inf\n", 1, 10, "$.version", "not a number of JSON"),
    "overflow": Bad("version: 1e999\n", 1, 10, "$.version", "larger than the largest"),
    "long number": Bad(f"version: {'9' * 1001}\n", 1, 10, "$.version", "1,001 digits"),
    "too deep": Bad("a: " + "[" * 100, 1, 67, "$", "more than 64 levels"),
    "too deep in blocks": Bad("- " * 200 + "a", 1, 129, "$", "more than 64 levels"),
}

SHAPE = {
    "a size": Bad(
        "version: 1\nbridges: {python: {host: {memory: 512MB}}}\nfunctions: {}\n",
        *(2, 35, "$.bridges.python.host.memory", "expected text such as 512 MiB, got"),
    ),
    "a list": Bad("- 1\n", 1, 1, "$", "expected a mapping, got [1]"),
    "bridges without names": Bad(
        "version: 1\nbridges: {plugin: python}\nfunctions: {}\n",
        2,
        19,
        "$.bridges.plugin",
        "(the keys of bridges are names of bridges)",
    ),
    "inputs without names": Bad(
        component("inputs: {endpoint: [x]}"),
        5,
        63,
        f"{AT}.inputs.endpoint",
        'got ["x"] (the keys of inputs are names of inputs; one alone',
    ),
    "limits without paths": Bad(
        component("input: {endpoint: [x], limits: {minimum: 1}}"),
        5,
        85,
        f"{AT}.input.limits.minimum",
        "got 1 (the keys of limits are paths of numbers",
    ),
    "a word": Bad("hello\n", 1, 1, "$", 'expected a mapping, got "hello"'),
    "no version": Bad("bridges: {}\nfunctions: {}\n", 1, 1, "$", 'the key "version" is missing'),
    "other version": Bad(
        "version: 2\nbridges: {}\nfunctions: {}\n", 1, 10, "$.version", "expected 1, got 2"
    ),
    "version true": Bad(
        "version: true\nbridges: {}\nfunctions: {}\n", 1, 10, "$.version", "expected 1, got true"
    ),
    "misspelt at the top": Bad(
        "version: 1\nbridges: {}\nfunctoins: {}\n", 3, 1, "$.functoins", 'did you mean "functions"'
    ),
    "odd key": Bad(HEAD + '  f: {}\n"a b": 1\n', 5, 1, '$["a b"]', "unknown key"),
    "bridge of nothing": Bad(
        "version: 1\nbridges:\n  python:\nfunctions: {}\n",
        3,
        10,
        "$.bridges.python",
        "write {} where there is nothing to set",
    ),
    "bridge key": Bad(
        "version: 1\nbridges: {p: {plugn: python}}\nfunctions: {}\n",
        2,
        15,
        "$.bridges.p.plugn",
        'did you mean "plugin"?',
    ),
    "function name": Bad(
        HEAD + "  a.b: {components: []}\n", 4, 3, '$.functions["a.b"]', "the name"
    ),
    "name with a line end": Bad(
        HEAD + '  "f\\n": {components: []}\n', 4, 3, '$.functions["f\\n"]', "the name"
    ),
    "no components": Bad(HEAD + "  f: {components: []}\n", 4, 19, "$.functions.f.components", "1"),
    "component key": Bad(
        one("{name: a, bridge: python, outptu: {endpoint: [x]}}"),
        5,
        44,
        f"{AT}.outptu",
        'did you mean "output"?',
    ),
    "no name": Bad(
        one("{bridge: python, output: {endpoint: [x]}}"), 5, 18, AT, 'the key "name" is missing'
    ),
    "component name": Bad(
        one("{name: a b, bridge: python, output: {endpoint: [x]}}"),
        5,
        25,
        f"{AT}.name",
        'the name "a b" is not allowed',
    ),
    "priority": Bad(
        component("priority: high, output: {endpoint: [x]}"),
        5,
        54,
        f"{AT}.priority",
        'expected a whole number, got "high"',
    ),
    "half a priority": Bad(
        component("priority: 1.5, output: {endpoint: [x]}"), 5, 54, f"{AT}.priority", "got 1.5"
    ),
    "yes is text": Bad(
        component("priority: yes, output: {endpoint: [x]}"), 5, 54, f"{AT}.priority", '"yes"'
    ),
    "huge priority": Bad(
        component("priority: 10000000, output: {endpoint: [x]}"),
        5,
        54,
        f"{AT}.priority",
        "expected at most 1000000, got 10000000",
    ),
    "endpoint is text": Bad(
        component("output: {endpoint: x}"), 5, 63, f"{AT}.output.endpoint", 'write ["x"]'
    ),
    "endpoint of a number": Bad(
        component("output: {endpoint: [1]}"),
        5,
        64,
        f"{AT}.output.endpoint[0]",
        "expected text, got 1 (write it in quotes)",
    ),
    "empty endpoint": Bad(
        component("output: {endpoint: []}"), 5, 63, f"{AT}.output.endpoint", "at least 1"
    ),
    "no endpoint": Bad(component("output: {}"), 5, 52, f"{AT}.output", 'the key "endpoint"'),
    "queue policy": Bad(
        component("input: {endpoint: [x], queue: {policy: lastest}}"),
        5,
        83,
        f"{AT}.input.queue.policy",
        'expected latest, drop-oldest or block, got "lastest" (did you mean "latest"?)',
    ),
    "queue length": Bad(
        component("input: {endpoint: [x], queue: {length: 0}}"),
        5,
        83,
        f"{AT}.input.queue.length",
        "expected at least 1, got 0",
    ),
    "queue timeout": Bad(
        component("input: {endpoint: [x], queue: {timeout: 0}}"),
        5,
        84,
        f"{AT}.input.queue.timeout",
        "expected more than 0, got 0",
    ),
    "map is a list": Bad(
        component("input: {endpoint: [x], map: [a]}"), 5, 72, f"{AT}.input.map", "a mapping"
    ),
    "map rule is a number": Bad(
        component("input: {endpoint: [x], map: {a: 1}}"),
        5,
        76,
        f"{AT}.input.map.a",
        "expected a path in the source, or from, const or each; got 1",
    ),
    "map rule of two kinds": Bad(
        component("input: {endpoint: [x], map: {a: {from: b, const: 1}}}"),
        5,
        76,
        f"{AT}.input.map.a",
        'expected exactly one of from, const and each, got ["from", "const"]',
    ),
    "map rule of no kind": Bad(
        component("input: {endpoint: [x], map: {a: {}}}"),
        5,
        76,
        f"{AT}.input.map.a",
        "got an empty mapping",
    ),
    "map rule misspelt": Bad(
        component("input: {endpoint: [x], map: {a: {from: b, scal: 2}}}"),
        5,
        86,
        f"{AT}.input.map.a.scal",
        'did you mean "scale"?',
    ),
    "map rule scale": Bad(
        component("input: {endpoint: [x], map: {a: {from: b, scale: x}}}"),
        5,
        93,
        f"{AT}.input.map.a.scale",
        'expected a number, got "x"',
    ),
    "map rule each without map": Bad(
        component("input: {endpoint: [x], map: {a: {each: b}}}"),
        5,
        76,
        f"{AT}.input.map.a",
        'the key "map" is missing',
    ),
    "map rule within each": Bad(
        component("input: {endpoint: [x], map: {a: {each: b, map: {c: {form: d}}}}}"),
        5,
        95,
        f"{AT}.input.map.a.map.c",
        "expected exactly one of from, const and each",
    ),
    "structure": Bad(
        component("output: {endpoint: [x], structure: {type: strng}}"),
        5,
        86,
        f"{AT}.output.structure.type",
        "not a JSON Schema: expected object, array, string, integer, number, boolean or null, "
        'got "strng" (did you mean "string"?)',
    ),
    "structure, one of its types": Bad(
        component("output: {endpoint: [x], structure: {type: [string, nil]}}"),
        5,
        86,
        f"{AT}.output.structure.type",
        'got "nil"',
    ),
    "structure, deep": Bad(
        component("output: {endpoint: [x], structure: {items: {minimum: low}}}"),
        5,
        97,
        f"{AT}.output.structure.items.minimum",
        'expected a number, got "low"',
    ),
    "structure of an older draft": Bad(
        component("output: {endpoint: [x], structure: {$schema: 'http://x/draft-07/schema#'}}"),
        5,
        89,
        f'{AT}.output.structure["$schema"]',
        "expected https://json-schema.org/draft/2020-12/schema or",
    ),
    "structure of a key's name": Bad(
        component("output: {endpoint: [x], structure: {propertyNames: 3}}"),
        5,
        95,
        f"{AT}.output.structure.propertyNames",
        "not a JSON Schema: expected a mapping or true or false, got 3",
    ),
    "request": Bad(
        component("service: {endpoint: [x], request: {required: a}}"),
        5,
        89,
        f"{AT}.service.request.required",
        "expected a list",
    ),
    "reply is text": Bad(
        component("service: {endpoint: [x], reply: text}"), 5, 76, f"{AT}.service.reply", "mapping"
    ),
}

HOST = "version: 1\nfunctions: {}\nbridges:\n  far: {plugin: python, host: %s}\n"

HOSTS = {
    "host of a wrong type": Bad(
        HOST % "jazzy",
        4,
        31,
        "$.bridges.far.host",
        'expected true or false or a mapping, got "jazzy"',
    ),
    "host with an unknown key": Bad(
        HOST % "{enviroment: jazzy}",
        4,
        32,
        "$.bridges.far.host.enviroment",
        "did you mean",
    ),
    "host with a variable that is no text": Bad(
        HOST % "{variables: {A: 1}}",
        4,
        47,
        "$.bridges.far.host.variables.A",
        "expected text or nothing, got 1",
    ),
    "host with a silence of nothing": Bad(
        HOST % "{silence: 0}", 4, 41, "$.bridges.far.host.silence", "expected more than 0, got 0"
    ),
    "host with two Pythons": Bad(
        HOST % "{environment: a, python: b}",
        4,
        48,
        "$.bridges.far.host.python",
        "give either environment or python, not both",
    ),
}

MEANING = {
    "bridge": Bad(
        one("{name: a, bridge: pyhton, output: {endpoint: [x]}}"),
        5,
        36,
        f"{AT}.bridge",
        'there is no bridge "pyhton" (did you mean "python"?)',
    ),
    "bridge like none": Bad(
        one("{name: a, bridge: zzz, output: {endpoint: [x]}}"),
        5,
        36,
        f"{AT}.bridge",
        "(bridges: python)",
    ),
    "function": Bad(
        HEAD + source("camera") + fed("face", "camra"),
        5,
        68,
        "$.functions.face.components[0].input.from",
        'there is no function "camra" (did you mean "camera"?)',
    ),
    "output": Bad(
        HEAD
        + source("camera", "outputs: {image: {endpoint: [x]}, depth: {endpoint: [y]}}")
        + fed("face", "camera.dept"),
        5,
        68,
        "$.functions.face.components[0].input.from",
        'camera has no output "dept" (did you mean "depth"?)',
    ),
    "which output": Bad(
        HEAD
        + source("camera", "outputs: {image: {endpoint: [x]}, depth: {endpoint: [y]}}")
        + fed("face", "camera"),
        5,
        68,
        "$.functions.face.components[0].input.from",
        "say which: camera.image or camera.depth",
    ),
    "no output": Bad(
        HEAD + source("say", "service: {endpoint: [x]}") + fed("face", "say"),
        5,
        68,
        "$.functions.face.components[0].input.from",
        "no component of say has an output",
    ),
    "from of named inputs": Bad(
        component("inputs: {image: {from: camra, endpoint: [x]}}"),
        5,
        67,
        f"{AT}.inputs.image.from",
        'there is no function "camra"',
    ),
    "name twice": Bad(
        HEAD + source("f") + source("g").replace("c_g", "c_f"),
        5,
        27,
        "$.functions.g.components[0].name",
        'the component name "c_f" is used twice, first in line 4',
    ),
    "no port": Bad(one("{name: a, bridge: python}"), 5, 18, AT, "the component has no port"),
    "input and inputs": Bad(
        component("input: {endpoint: [x]}, inputs: {a: {endpoint: [x]}}"),
        5,
        44,
        f"{AT}.input",
        "either input or inputs",
    ),
    "output and outputs": Bad(
        component("output: {endpoint: [x]}, outputs: {a: {endpoint: [x]}}"),
        5,
        44,
        f"{AT}.output",
        "either output or outputs",
    ),
    "service and output": Bad(
        component("output: {endpoint: [x]}, service: {endpoint: [x]}"),
        5,
        69,
        f"{AT}.service",
        "either a service or streams; here is also output",
    ),
    "needs itself": Bad(HEAD + fed("a", "a"), 4, 3, "$.functions.a", "a -> a"),
    "cycle of three": Bad(
        HEAD + source("x") + fed("a", "b") + fed("b", "c") + fed("c", "a"),
        5,
        3,
        "$.functions.a",
        "a -> b -> c -> a",
    ),
}

NEEDS = {
    "no candidates": Bad(
        HEAD + "  f: {}\n", 4, 3, "$.functions.f", "components or needs is missing"
    ),
    "nothing needed": Bad(
        needing("role: input"), 4, 7, "$.functions.f.needs", "does not say what is needed"
    ),
    "both": Bad(needing("like: g, structure: true"), 4, 15, "$.functions.f.needs.like", "not both"),
    "itself": Bad(needing("like: f"), 4, 21, "$.functions.f.needs.like", "is like itself"),
    "reply of a stream": Bad(
        needing("reply: true"), 4, 15, "$.functions.f.needs.reply", "only a service has a reply"
    ),
    "structure of a service": Bad(
        needing("structure: true, role: service"),
        4,
        15,
        "$.functions.f.needs.structure",
        "a service has no structure of its own",
    ),
    "malformed structure": Bad(
        needing("structure: {type: thing}"),
        4,
        33,
        "$.functions.f.needs.structure.type",
        "not a JSON Schema",
    ),
    "unknown key": Bad(
        needing("names: head"), 4, 15, "$.functions.f.needs.names", 'did you mean "name"?'
    ),
}

TABLE = {
    f"{kind}: {name}": bad
    for kind, table in (
        ("yaml", YAML),
        ("shape", SHAPE),
        ("host", HOSTS),
        ("meaning", MEANING),
        ("needs", NEEDS),
    )
    for name, bad in table.items()
}


def written(problem: Problem) -> str:
    return str(problem).partition(": ")[2]


@pytest.mark.parametrize("bad", TABLE.values(), ids=TABLE.keys())
def test_a_mistake_is_reported_at_its_place(bad: Bad, tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(bad.text, encoding="utf-8")
    report = inspect(path)
    assert report.robot is None
    found = [
        (problem.place.line, problem.place.column, problem.path) for problem in report.problems
    ]
    assert (bad.line, bad.column, bad.path) in found, "\n".join(map(str, report.problems))
    assert any(
        bad.says in written(problem)
        for problem in report.problems
        if (problem.place.line, problem.place.column, problem.path)
        == (bad.line, bad.column, bad.path)
    ), "\n".join(map(str, report.problems))
    assert all(problem.file == str(path) for problem in report.problems)


@pytest.mark.parametrize(
    "bad", [*SHAPE.values(), *MEANING.values()], ids=[*SHAPE.keys(), *MEANING.keys()]
)
def test_one_mistake_gives_one_problem_unless_it_breaks_the_frame(bad: Bad, tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(bad.text, encoding="utf-8")
    problems = inspect(path).problems
    missing = [problem for problem in problems if "is missing" in problem.sentence]
    others = [problem for problem in problems if problem not in missing]
    assert len(others) <= 1 or "the name" in bad.says, "\n".join(map(str, problems))
