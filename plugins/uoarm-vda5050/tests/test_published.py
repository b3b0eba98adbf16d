"""The standard's own schemas, where they are given: read, refused with the line, and held against.

VDA5050_SCHEMAS names a folder with the folders 2.0.0, 2.1.0 and 3.0.0, each with the schemas
that the release published, 2.0.0 without its factsheet. Without it, what needs them is skipped.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest
from brokers import Broker, Peer
from jsonschema import Draft202012Validator
from uoarm_vda5050._messages import Headers, Published, read_published
from uoarm_vda5050._orders import Order, cancel_order
from uoarm_vda5050._releases import RELEASES, TOPICS, body_of

from fleet import bridge_to, driven, endpoint, goal
from uoarm.bridge import Registry
from uoarm.errors import ConfigurationError
from uoarm.schema import check
from uoarm.testing import wait

GIVEN = os.environ.get("VDA5050_SCHEMAS", "")
NEEDS_THEM = pytest.mark.skipif(not GIVEN, reason="VDA5050_SCHEMAS is not set")
SCHEMA = {"type": "object", "properties": {"headerId": {"type": "integer"}, "orderId": {}}}


def test_a_published_schema_loses_its_header(tmp_path: Path) -> None:
    required = {"required": ["headerId", "orderId"]}
    (tmp_path / "order.schema").write_text(json.dumps({**SCHEMA, **required}))
    release = RELEASES["2.1"]
    found = Published(release, read_published(str(tmp_path), release))
    body: Any = found.body("order").schema
    assert (body["properties"], body["required"]) == ({"orderId": {}}, ["orderId"])
    assert found.body("state") == body_of("state", "2.1"), "what is not there is the plugin's own"


def test_a_schema_of_an_older_draft_is_read_as_one(tmp_path: Path) -> None:
    draft, old = "http://json-schema.org/draft-07/schema#", {"dependencies": {"a": ["b"]}}
    (tmp_path / "order.schema").write_text(json.dumps({"$schema": draft, **SCHEMA, **old}))
    found = read_published(str(tmp_path), RELEASES["2.1"])
    assert found["order"] == {**SCHEMA, "dependentRequired": {"a": ["b"]}}


@pytest.mark.parametrize(
    ("text", "refusal"),
    [
        (
            '{\n "type": "object",\n}',
            r"order.schema, line 2: no JSON: the comma before '}' must go",
        ),
        ("{\n nothing", r"order.schema, line 2: no JSON: Expecting"),
        ('{"type": "nonsense", "properties": {}}', r"order.schema: no JSON Schema: 'nonsense'"),
        (
            '{"type": "object", "headerId": {}}',
            r"order.schema: no JSON Schema: .* beside them, as release 2.0.0 .* or remove it",
        ),
        ("[]", r"order.schema: no JSON Schema: it is no schema of an object"),
        ('{"a": "' + "x" * 2**20 + '"}', r"it has more than 1,048,576 bytes"),
    ],
)
def test_what_is_no_schema_is_refused_with_its_place(
    tmp_path: Path, text: str, refusal: str
) -> None:
    (tmp_path / "order.schema").write_text(text)
    with pytest.raises(ConfigurationError, match=refusal):
        read_published(str(tmp_path), RELEASES["2.1"])


@pytest.mark.parametrize("name", ["", "long" * 100])
def test_a_folder_without_schemas_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ConfigurationError, match=r"has none of the files order.schema"):
        read_published(str(tmp_path / name), RELEASES["2.1"])


@NEEDS_THEM
def test_three_files_of_the_third_release_are_no_json() -> None:
    wrong = []
    for topic in TOPICS:
        try:
            json.loads((Path(GIVEN) / "3.0.0" / f"{topic}.schema").read_text())
        except json.JSONDecodeError:
            wrong.append(topic)
    assert wrong == ["order", "visualization", "factsheet"]
    with pytest.raises(ConfigurationError, match=r"Three schemas of release 3.0.0 were published"):
        read_published(str(Path(GIVEN) / "3.0.0"), RELEASES["3.0"])


@NEEDS_THEM
@pytest.mark.parametrize("release", ["2.0", "2.1"])
def test_orders_and_cancellations_are_as_published(release: str) -> None:
    found = RELEASES[release]
    schemas = read_published(str(Path(GIVEN) / f"{release}.0"), found)
    headers = Headers(found, "uoa", "agv1")
    action = {"actionType": "pick", "actionParameters": [{"key": "height", "value": 0.5}]}
    wanted = goal("a", "b", "c")
    wanted["nodes"][1] |= {"actions": [action], "nodePosition": {"x": 1, "y": 2, "mapId": "floor"}}
    for topic, body in {
        "order": Order.of(wanted, "one", found, 100).body,
        "instantActions": cancel_order(found, "c", "one"),
    }.items():
        Draft202012Validator(schemas[topic]).validate({**headers.next(topic), **body})


@NEEDS_THEM
@pytest.mark.parametrize(
    ("release", "topics"),
    [
        ("2.0", ["state", "connection", "visualization"]),  # the other one has no properties
        ("2.1", ["state", "connection", "visualization", "factsheet"]),
        ("3.0", ["state", "connection"]),  # the others are no JSON
    ],
)
def test_what_a_vehicle_says_is_as_published(
    broker: Broker, release: str, topics: list[str]
) -> None:
    peer, serial = Peer(broker), f"published{release}"
    prefix = RELEASES[release].prefix("published")
    said = peer.collect(f"{prefix}/uoa/{serial}/#")
    with (
        driven(broker, serial, release=release, interface="published") as driver,
        bridge_to(broker, release=release, interface="published") as bridge,
    ):
        order = goal("a", "b", b="pick")
        bridge.call(endpoint(serial, "transport"), order)
        driver.vehicle.raise_error("tired", "of driving")

        def came(topic: str) -> list[Any]:
            return [json.loads(item.payload) for item in said if item.topic.endswith(topic)]

        wait(lambda: all(came(topic) for topic in topics), "not all was said")
        wait(lambda: any(item["errors"] for item in came("state")), "no error")
    peer.close()
    for topic in topics:
        (file,) = (Path(GIVEN) / f"{release}.0").glob(f"{topic}.*")
        validator = Draft202012Validator(json.loads(file.read_text()))
        for item in came(topic):
            validator.validate(item)


@NEEDS_THEM
@pytest.mark.parametrize("release", ["2.0", "2.1", "3.0"])
@pytest.mark.parametrize("topic", ["state", "connection"])
def test_what_is_published_fits_our_structures(tmp_path: Path, release: str, topic: str) -> None:
    found = RELEASES[release]
    file = f"{topic}.schema"  # alone: of the third release others are no JSON
    (tmp_path / file).write_bytes((Path(GIVEN) / f"{release}.0" / file).read_bytes())
    published = Published(found, read_published(str(tmp_path), found)).body(topic)
    verdict = check(published.schema, body_of(topic, release).schema)
    assert verdict.compatible, verdict


def test_paths_begin_at_the_configuration() -> None:
    located = Registry().types["vda5050"].located
    options = {"schemas": "published", "tls": {"ca": "ca.pem"}, "interface": "uagv"}
    expected = {"schemas": "/robot/published", "tls": {"ca": "/robot/ca.pem"}}
    assert located(options, "/robot") == {**options, **expected}
