"""The schema in the repository is the one that the generated code speaks."""

import re
from pathlib import Path

from fbench.pipelines.external import fbench_exec_pb2 as schema

PROTO = Path(__file__).resolve().parents[3] / "pipelines" / "external" / "fbench_exec.proto"
FIELD = re.compile(r"^(?:(repeated|optional) )?(map<\w+, \w+>|\w+) (\w+) = (\d+)$")
Field = tuple[str, str, str, int]


def written() -> dict[str, set[Field]]:
    """Fields by message, and values by enum, as the file has them."""
    found: dict[str, set[Field]] = {}
    current = ""
    text = re.sub(r"//.*", "", PROTO.read_text())
    for token in re.split(r"[;{}\n]", text.replace("{", "{\n").replace("}", "\n}\n")):
        line = token.strip()
        if match := re.match(r"(message|enum) (\w+)$", line):
            current = match[2]
            found[current] = set()
        elif match := FIELD.match(line):
            found[current].add((match[1] or "", match[2].replace(" ", ""), match[3], int(match[4])))
        elif match := re.match(r"(\w+) = (\d+)$", line):
            found[current].add(("", "", match[1], int(match[2])))
    return found


def generated() -> dict[str, set[Field]]:
    file = schema.DESCRIPTOR
    messages = {m.name: {_field(f) for f in m.fields} for m in file.message_types_by_name.values()}
    enums = {e.name: {("", "", v.name, v.number) for v in e.values} for e in file.enum_types_by_name.values()}
    return messages | enums


def _field(field) -> Field:
    types = {v: k.removeprefix("TYPE_").lower() for k, v in vars(type(field)).items() if k.startswith("TYPE_")}
    kind = field.message_type or field.enum_type
    if kind is not None and field.message_type and kind.GetOptions().map_entry:
        key, value = (types[kind.fields_by_name[n].type] for n in ("key", "value"))
        return "", f"map<{key},{value}>", field.name, field.number
    label = "repeated" if field.is_repeated else "optional" if _is_optional(field) else ""
    return label, kind.name if kind else types[field.type], field.name, field.number


def _is_optional(field) -> bool:
    oneof = field.containing_oneof
    return oneof is not None and oneof.name == f"_{field.name}"


def test_schema_and_generated_code_agree():
    assert written() == generated()


def test_package_and_version_agree():
    from fbench.pipelines.external.messages import VERSION

    assert schema.DESCRIPTOR.package == f"fbench.exec.v{VERSION}"
    assert f"package fbench.exec.v{VERSION};" in PROTO.read_text()


def test_digests_of_stages_reach_the_other_process():
    from fbench.pipelines.external.host import write_output
    from fbench.pipelines.external.messages import read_output
    from fbench.replay.data.boxes import Boxes3D
    from fbench.replay.data.frames import Output

    message = schema.Output()
    write_output(Output(Boxes3D.empty(), None, {}, digests={"lidar": "ab", "camera": "cd"}), message)
    assert list(read_output(message).digests.items()) == [("lidar", "ab"), ("camera", "cd")]
    message.digests.extend([schema.Digest(stage=f"{n}" * 100, digest="x" * 100) for n in range(200)])
    assert len(read_output(message).digests) <= 64
