"""Candidates that are not in the file: the same for the same findings in any order, and few."""

from __future__ import annotations

from collections.abc import Sequence

from hypothesis import given
from hypothesis import strategies as st
from tests.structures import closed

from uoarm._resolve import Proofs, StructureCache, add_candidates, without_candidates
from uoarm.config import loads
from uoarm.model import (
    BridgeFindings,
    Endpoint,
    FoundComponent,
    FoundPort,
    MessageStructure,
    PortRef,
    Robot,
    Role,
    Schema,
)

SMALL: Schema = {"type": "integer", "minimum": 0, "maximum": 9}
NUMBER: Schema = {"type": "integer"}
TEXT: Schema = {"type": "string"}
ROBOT = loads("""
version: 1
bridges: {a: {plugin: memory}, b: {plugin: memory, host: true}}
functions:
  camera: {needs: {structure: {type: integer}}}
  label: {needs: {structure: {type: string}}}
  both: {needs: {name: both}}
""")
PROOFS = Proofs()
COMPONENTS = st.dictionaries(
    st.sampled_from(["head", "hand", "sign", "both", "eye"]),
    st.tuples(st.sampled_from([None, SMALL, NUMBER, TEXT]), st.sampled_from([SMALL, NUMBER, TEXT])),
)


def found(bridge: str, name: str, taken: Schema | None, emitted: Schema) -> FoundComponent:
    """Return a component with an output, and an input where it takes something."""

    def port(role: Role, schema: Schema) -> FoundPort:
        end = Endpoint(bridge, name, role, (name, role.value), role.value)
        return FoundPort(end, MessageStructure(schema))

    ports = [port(Role.OUTPUT, emitted)]
    if taken is not None:
        ports.append(port(Role.INPUT, taken))
    return FoundComponent(name, tuple(ports))


def matched(robot: Robot, findings: Sequence[BridgeFindings]) -> Robot:
    def bridge(name: str) -> object:
        raise AssertionError(f"nothing is named that {name} could be asked for")

    PROOFS.begin_round()
    cache = StructureCache(bridge)  # type: ignore[arg-type]
    return add_candidates(
        robot, findings, structures=cache.structures, topic=lambda _: None, proofs=PROOFS
    )


@given(COMPONENTS, COMPONENTS, st.randoms(use_true_random=False))
def test_the_order_in_which_things_are_seen_says_nothing(
    one: dict[str, tuple[Schema | None, Schema]],
    two: dict[str, tuple[Schema | None, Schema]],
    random: object,
) -> None:
    findings = [
        BridgeFindings(name, "memory", tuple(found(name, key, *said) for key, said in seen.items()))
        for name, seen in (("a", one), ("b", two))
    ]
    robot = matched(ROBOT, findings)
    shuffled = []
    for finding in reversed(findings):
        components = list(finding.components)
        random.shuffle(components)  # type: ignore[attr-defined]
        shuffled.append(BridgeFindings(finding.bridge, finding.plugin, tuple(components)))
    assert matched(robot, shuffled) == robot
    assert without_candidates(robot) == ROBOT
    _require_no_cycle(robot)
    for function in robot.functions.values():
        for component in function.components:
            reports = {"a": one, "b": two}[component.bridge][
                component.outputs[0].endpoint.address[0]
            ]
            assert (reports[0] is None) == (component.inputs == ())


def _require_no_cycle(robot: Robot) -> None:
    sources = {
        name: {
            port.source.function
            for component in function.components
            for port in component.inputs
            if isinstance(port.source, PortRef)
        }
        for name, function in robot.functions.items()
    }
    while sources:
        free = {name for name, needed in sources.items() if not needed & sources.keys()}
        assert free, f"a cycle in {sources}"
        sources = {name: source for name, source in sources.items() if name not in free}


def test_rules_and_options_of_a_need_go_to_the_ports_they_are_for() -> None:
    view: Schema = closed(tm={"type": "integer", "minimum": 0}, data={"type": "string"})
    image: Schema = closed(tm={"type": "integer"}, data=TEXT, step=NUMBER)
    wanted = """
version: 1
bridges: {a: {plugin: memory}}
functions:
  camera: {needs: {name: head}}
  face: {needs: {name: eye%s}}
"""
    findings = [
        BridgeFindings(
            "a", "memory", (found("a", "head", None, image), found("a", "eye", view, TEXT))
        )
    ]
    without = matched(loads(wanted % ""), findings).functions["face"]
    assert without.components == ()
    assert without.passed_over[0][1] == (
        "no function feeds its input input, which `unfed` does not name"
    )
    more = ", options: {activate: true}, map: {tm: {const: 0}, other: {const: 1}}"
    (eye,) = matched(loads(wanted % more), findings).functions["face"].components
    assert eye.inputs[0].mapping == {"tm": {"const": 0}}  # nothing has a field `other`
    assert eye.inputs[0].allow_loss == ("tm", "step")
    assert eye.inputs[0].endpoint.options == eye.outputs[0].endpoint.options == {"activate": True}
    wrong = ", map: {tm: {const: -1}}"
    assert matched(loads(wanted % wrong), findings).functions["face"].components == ()


def test_of_thousands_that_fit_the_first_are_candidates_and_the_others_are_counted() -> None:
    many = tuple(found("a", f"camera{number:04}", None, NUMBER) for number in range(2_000))
    camera = matched(ROBOT, [BridgeFindings("a", "memory", many)]).functions["camera"]
    names = [component.name for component in camera.components]
    assert names == [f"camera@a/camera{number:04}:output" for number in range(32)]
    assert len(camera.passed_over) == 21
    assert camera.passed_over[-1] == ("1,948 more", "not listed")
