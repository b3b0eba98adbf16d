"""Good configurations become the robot that they describe."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from uoarm.config import inspect, load, loads, published_schema
from uoarm.config._parts import _KEYS
from uoarm.errors import ConfigurationError
from uoarm.model import (
    BridgeSpec,
    Component,
    Endpoint,
    Input,
    MessageStructure,
    Output,
    OverflowPolicy,
    PortRef,
    QueuePolicy,
    Role,
    Service,
)

FULL = """
version: 1
bridges:
  python: {options: {path: [here]}}
  ros: {plugin: ros2, options: {domain_id: 7}, host: {environment: jazzy}}
functions:
  camera:
    description: pictures
    components:
      - {name: low, bridge: python, priority: -1, output: {endpoint: ["m:camera"]}}
      - name: high
        bridge: ros
        priority: 20
        parameters: {path: clip.mp4}
        outputs:
          image: {endpoint: [/image, Image], options: {qos: best}}
          default: {endpoint: [/default], structure: {type: object}}
      - {name: also_low, bridge: python, priority: -1.0, output: {endpoint: ["m:other"]}}
  face:
    components:
      - name: finder
        bridge: python
        inputs:
          image:
            from: camera.image
            endpoint: ["m:face"]
            options: {fast: true}
            map: {a: b, c: {const: 1}, d: {each: e, map: {f: {from: g, scale: 2}}}, "pose.x": .}
            allow_loss: [header]
            queue: {length: 3.0, policy: latest, timeout: 2}
            structure: true
          hint: {endpoint: ["m:hint"]}
        output: {endpoint: ["m:face"]}
  say:
    components:
      - name: voice
        bridge: python
        service: {endpoint: ["m:say"], request: {type: string}, reply: false}
"""


def test_everything_that_can_be_written_arrives_in_the_model() -> None:
    robot = loads(FULL, "robot.yaml")
    folder = str(Path.cwd())
    assert robot.origin == str(Path(folder, "robot.yaml"))
    assert robot.bridges == {
        "python": BridgeSpec("python", "python", {"path": ["here"]}, folder=folder),
        "ros": BridgeSpec("ros", "ros2", {"domain_id": 7}, {"environment": "jazzy"}, folder=folder),
    }
    parameters = {"path": "clip.mp4"}

    def high(port: str, address: tuple[str, ...], **options: object) -> Endpoint:
        return Endpoint("ros", "high", Role.OUTPUT, address, port, options, parameters)

    camera = robot.functions["camera"]
    assert camera.description == "pictures"
    assert [component.name for component in camera.components] == ["high", "low", "also_low"]
    assert camera.components[0] == Component(
        "high",
        "camera",
        "ros",
        20,
        outputs=(
            Output("image", high("image", ("/image", "Image"), qos="best")),
            Output("default", high("default", ("/default",)), MessageStructure({"type": "object"})),
        ),
        parameters=parameters,
    )

    def finder(port: str, role: Role, target: str, **options: object) -> Endpoint:
        return Endpoint("python", "finder", role, (target,), port, options)

    assert robot.functions["face"].components == (
        Component(
            "finder",
            "face",
            "python",
            inputs=(
                Input(
                    "image",
                    finder("image", Role.INPUT, "m:face", fast=True),
                    PortRef("camera", "image"),
                    {
                        "a": "b",
                        "c": {"const": 1},
                        "d": {"each": "e", "map": {"f": {"from": "g", "scale": 2}}},
                        "pose.x": ".",
                    },
                    ("header",),
                    MessageStructure(schema=True),
                    QueuePolicy(3, OverflowPolicy.LATEST, 2.0),
                ),
                Input("hint", finder("hint", Role.INPUT, "m:hint")),
            ),
            outputs=(Output("default", finder("default", Role.OUTPUT, "m:face")),),
        ),
    )
    assert robot.functions["say"].components[0].service == Service(
        Endpoint("python", "voice", Role.SERVICE, ("m:say",)),
        MessageStructure({"type": "string"}),
        MessageStructure(schema=False),
    )


def test_whole_numbers_are_integers_however_they_are_written() -> None:
    robot = loads(FULL)
    priorities = [component.priority for component in robot.functions["camera"].components]
    queue = robot.functions["face"].components[0].inputs[0].queue
    assert queue is not None
    assert {type(number) for number in [*priorities, queue.length]} == {int}
    assert type(queue.timeout) is float


def test_python_components_are_found_beside_the_file(tmp_path: Path) -> None:
    text = "version: 1\nbridges: {python: {}, mine: {plugin: python}, ros: {}}\nfunctions: {}\n"
    (tmp_path / "robot.yaml").write_text(text)
    bridges = load(tmp_path / "robot.yaml").bridges
    assert bridges["python"].options == {"path": [str(tmp_path)]}
    assert bridges["mine"].options == {"path": [str(tmp_path)]}
    assert bridges["ros"].options == {}
    assert loads(text).bridges["python"].options == {}


class TestWarnings:
    def said(self, text: str, tmp_path: Path) -> list[tuple[int, str]]:
        path = tmp_path / "robot.yaml"
        path.write_text(text)
        report = inspect(path)
        assert report.robot is not None
        assert report.robot.warnings == tuple(map(str, report.warnings))
        return [(warning.place.line, warning.sentence) for warning in report.warnings]

    def test_unused_bridges(self, tmp_path: Path) -> None:
        text = "version: 1\nbridges:\n  p: {}\n  q: {}\nfunctions: {}\n"
        assert self.said(text, tmp_path) == [
            (3, 'no component uses the bridge "p"'),
            (4, 'no component uses the bridge "q"'),
        ]

    def test_equal_priorities_with_their_order(self, tmp_path: Path) -> None:
        order = "they are tried in this order: low, also_low"
        assert self.said(FULL, tmp_path) == [
            (
                18,
                f"2 components of camera have priority -1; {order}",
            )
        ]

    def test_a_cycle_that_another_component_avoids(self, tmp_path: Path) -> None:
        text = """version: 1
bridges: {p: {}}
functions:
  a:
    components:
      - {name: a1, bridge: p, priority: 1, input: {from: b, endpoint: [x]}, output: {endpoint: [x]}}
      - {name: a2, bridge: p, output: {endpoint: [x]}}
  b:
    components:
      - {name: b1, bridge: p, input: {from: a, endpoint: [x]}, output: {endpoint: [x]}}
"""
        expected = "some components close a cycle, others avoid it: a -> b -> a"
        assert self.said(text, tmp_path) == [(4, expected)]


def test_mistakes_of_yaml_shape_and_meaning_are_reported_together_in_order() -> None:
    text = """version: 1
bridges: {p: {}, p: {}}
functions:
  a:
    components:
      - {name: a1, bridge: q, prioritty: 1, output: {endpoint: [x]}}
      - {name: a1, bridge: p, priority: !!int 1, input: {from: b.c, endpoint: [x]}}
      - {name: [], bridge: p, output: {endpoint: [x], structure: {type: nix}}}
      - nothing
"""
    with pytest.raises(ConfigurationError) as caught:
        loads(text, "robot.yaml")
    places = [line.split(": ")[0:2] for line in str(caught.value).splitlines()]
    component = "$.functions.a.components"
    assert places == [
        ["robot.yaml:2:18", "$.bridges.p"],
        ["robot.yaml:6:28", f"{component}[0].bridge"],
        ["robot.yaml:6:31", f"{component}[0].prioritty"],
        ["robot.yaml:7:16", f"{component}[1].name"],
        ["robot.yaml:7:41", f"{component}[1].priority"],
        ["robot.yaml:7:64", f"{component}[1].input.from"],
        ["robot.yaml:8:16", f"{component}[2].name"],
        ["robot.yaml:8:73", f"{component}[2].output.structure.type"],
        ["robot.yaml:9:9", f"{component}[3]"],
    ]


def test_a_component_may_have_inputs_only() -> None:
    text = """version: 1
bridges: {p: {}}
functions: {f: {components: [{name: a, bridge: p, input: {endpoint: [x]}}]}}
"""
    assert loads(text).functions["f"].components[0].outputs == ()


def test_a_chain_of_two_thousand_functions_is_read() -> None:
    functions = "".join(
        f"  f{n}: {{components: [{{name: c{n}, bridge: p, "
        f"input: {{from: f{n + 1}, endpoint: [x]}}, output: {{endpoint: [x]}}}}]}}\n"
        for n in range(2_000)  # twice what Python's stack has room for
    )
    last = "  f2000: {components: [{name: c, bridge: p, output: {endpoint: [x]}}]}\n"
    robot = loads(f"version: 1\nbridges: {{p: {{}}}}\nfunctions:\n{functions}{last}")
    assert len(robot.functions) == 2_001
    assert robot.warnings == ()


def described_keys(schema: Any, path: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield every key that the file may have, where it stands in the schema."""
    if isinstance(schema, dict):
        properties = schema.get("properties")
        for name, key in properties.items() if isinstance(properties, dict) else ():
            yield f"{path}/{name}", key
        for name, part in schema.items():
            yield from described_keys(part, f"{path}/{name}")
    elif isinstance(schema, list):
        for number, part in enumerate(schema):
            yield from described_keys(part, f"{path}/{number}")


class TestPublishedSchema:
    def test_it_is_a_json_schema(self) -> None:
        Draft202012Validator.check_schema(published_schema())

    def test_every_key_is_described(self) -> None:
        keys = list(described_keys(published_schema()))
        assert len(keys) == 142, "count them again, with the keys that are new"
        assert [path for path, key in keys if not str(key.get("description", "")).strip()] == []

    def test_the_keys_of_a_component_are_the_same_in_both_places(self) -> None:
        assert set(published_schema()["$defs"]["component"]["properties"]) == _KEYS

    def test_the_full_example_fits(self) -> None:
        value = json.loads(json.dumps(_plain(FULL)))
        assert list(Draft202012Validator(published_schema()).iter_errors(value)) == []


def _plain(text: str) -> object:
    from uoarm._support.yaml import read

    return read(text).value


@pytest.mark.parametrize(
    ("host", "settings"),
    [
        ("", None),
        ("host: false", None),
        ("host: true", {}),
        ("host: {}", {}),
        (
            "host: {python: /usr/bin/python3, silence: 5}",
            {"python": "/usr/bin/python3", "silence": 5},
        ),
    ],
)
def test_a_host_is_asked_for_in_any_of_these_ways(
    host: str, settings: dict[str, object] | None
) -> None:
    robot = loads(f"version: 1\nbridges:\n  far: {{plugin: python, {host}}}\nfunctions: {{}}\n")
    assert robot.bridges["far"].host == settings


APPLICATIONS = """
version: 1
bridges: {python: {}}
applications:
  reception: [face, %s]
functions:
  camera:
    components: [{name: eye, bridge: python, output: {endpoint: ["m:camera"]}}]
  face:
    components:
      - {name: finder, bridge: python, input: {from: camera, endpoint: ["m:find"]}}
  lamp:
    components: [{name: bulb, bridge: python, input: {endpoint: ["m:lamp"]}}]
"""


def test_functions_without_a_user_are_named_where_applications_are_declared() -> None:
    robot = loads(APPLICATIONS % "camera")
    assert robot.applications == {"reception": ("face", "camera")}
    (warning,) = robot.warnings
    assert 'no application and no component uses the function "lamp"' in warning
    assert "<text>:12:3" in warning
    assert loads(APPLICATIONS % "lamp").warnings == ()


def test_an_application_cannot_ask_for_what_is_not_there() -> None:
    with pytest.raises(ConfigurationError, match=r'no function "lmap" \(did you mean "lamp"\?\)'):
        loads(APPLICATIONS % "lmap")
