"""Single messages with their definitions: CDR and ROS 1, definitions in IDL, and Foxglove's schemas in JSON."""

import json
from functools import cache
from pathlib import Path

from rosbags.typesys.base import TypesysError
from rosbags.typesys.store import Typestore
from tests.hostile.damage import Random, damage, edit_number, edit_text
from tests.hostile.target import Case, Found
from tests.replay.logs.codecs.foxglove import test_json
from tests.replay.logs.codecs.ros import test_other_definitions as definitions
from tests.replay.logs.codecs.ros.builders import DISTROS, Ros
from tests.replay.logs.codecs.ros.test_damage import payloads, use
from tests.replay.logs.codecs.ros.test_idl import sections
from tests.replay.logs.codecs.ros.test_objects import autoware

from fbench.replay.contracts.errors import FbenchError
from fbench.replay.logs.codecs.foxglove.codec import foxglove_codec
from fbench.replay.logs.codecs.ros.codec import ros_codec
from fbench.replay.logs.codecs.ros.definitions import types_of
from fbench.replay.logs.container import Channel, Schema

Message = tuple[str, str, bytes, bytes]  # Type, encoding of the definition, definition, payload


@cache
def ros(encoding: str) -> tuple[Message, ...]:
    """One message of every type that fbench reads, and its definition."""
    distro = DISTROS[1] if encoding == "cdr" else DISTROS[2]
    made = Ros(distro, definitions.KNOWN)
    found = [(name, bytes(data)) for name, _, data in payloads(distro)[1]]
    for name in definitions.NAMES:
        schema = made.schema(name)
        found.append((name, bytes(definitions.write(made, name, schema))))
    known = []
    for name, data in found:
        try:
            schema = made.schema(name)
        except TypesysError:  # its definition is not in the store; fbench knows it
            schema = Schema(name, "", b"")
        known.append((name, schema.encoding, schema.data, data))
    return tuple(known)


def make_ros(encoding: str, random: Random) -> Case:
    """Change the payload, the definition, or both so that they fit together."""
    name, form, text, data = ros(encoding)[int(random.integers(len(ros(encoding))))]
    match int(random.integers(8)):
        case 0 if text:  # whose codec takes most of the time
            text = definitions.mutate(text.decode(), random).encode()
            data = _rewrite(encoding, name, Schema(name, form, text)) or data
        case 1 | 2 if text:
            text = [edit_text, damage][int(random.integers(2))](text, random)
        case 3 | 4:
            data = damage(data, random)
        case _:
            data = edit_number(edit_number(data, random), random)
    return _case(encoding, name, form, text, data)


def _case(encoding: str, name: str, form: str, text: bytes, data: bytes) -> Case:
    about = json.dumps({"encoding": encoding, "name": name, "form": form}).encode()
    return Case({"about.json": about, "definition": text, "payload": data})


def _rewrite(encoding: str, name: str, schema: Schema) -> bytes | None:
    """A message that fits an edited definition; `None` where fbench refuses that."""
    store = Typestore()
    try:
        store.register(types_of(name, schema, encoding))
    except FbenchError:
        return None
    message = definitions.instance(store, name)
    return bytes((store.serialize_cdr if encoding == "cdr" else store.serialize_ros1)(message, name))


def use_ros(folder: Path) -> Found:
    """Do with a message what readers do."""
    about = json.loads((folder / "about.json").read_text())
    data = memoryview((folder / "payload").read_bytes())
    schema = Schema(about["name"], about["form"], (folder / "definition").read_bytes())
    codec = ros_codec(Channel("/t", about["encoding"], schema))
    if codec is not None:
        codec.probe(data)
        for kind in codec.kinds:
            use(codec, kind, data)
    return Found()


@cache
def idl() -> tuple[Message, ...]:
    """Objects of Autoware.Auto by their definition in IDL."""
    package, found = "autoware_auto_perception_msgs", []
    made = Ros(DISTROS[1], autoware(package))
    for kind in ("Detected", "Tracked"):
        name = f"{package}/msg/{kind}Objects"
        schema = made.schema(name)
        types = types_of(name, schema, "cdr")
        text = sections(types, [name, *sorted(set(types) - {name})])
        found.append((name, "ros2idl", text, bytes(definitions.write(made, name, schema))))
    return tuple(found)


def make_idl(random: Random) -> Case:
    """Change words and signs of the definition."""
    name, form, text, data = idl()[int(random.integers(len(idl())))]
    return _case("cdr", name, form, [edit_text, edit_text, damage][int(random.integers(3))](text, random), data)


JSON = {
    "PointCloud": test_json.cloud([(1, 2, 3), (4, 5, 6)]),
    "FrameTransform": test_json.edge("lidar", 1.0),
    "CameraCalibration": test_json.CALIBRATION,
    "CompressedImage": {
        "timestamp": test_json.TIME, "frame_id": "cam", "format": "jpeg", "data": test_json.text(test_json.JPEG),
    },
}  # fmt: skip


def make_json(random: Random) -> Case:
    """Change words and signs of a message."""
    name = sorted(JSON)[int(random.integers(len(JSON)))]
    data = edit_text(json.dumps(JSON[name]).encode(), random)
    return _case("json", f"foxglove.{name}", "jsonschema", b"", data)


def use_json(folder: Path) -> Found:
    """Read a message as those in Protobuf."""
    about = json.loads((folder / "about.json").read_text())
    codec = foxglove_codec(Channel("/t", about["encoding"], Schema(about["name"], about["form"], b"")))
    data = memoryview((folder / "payload").read_bytes())
    codec.probe(data)
    for kind in codec.kinds:
        use(codec, kind, data)
    return Found()
