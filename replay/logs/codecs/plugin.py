"""The codec of channels that a decoder plug-in reads: calls it, and checks and copies what it returns."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import index
from typing import Any, TypeVar

from fbench.replay.contracts.decoders import RESULTS, BoxesIn, Decoder, Payload
from fbench.replay.contracts.errors import INTERRUPTS, DecodeError, FbenchError, one_line
from fbench.replay.data.arrays import own_arrays
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.classes import labels
from fbench.replay.data.images import LAYOUTS, MAX_PIXELS, RAW_CHANNELS, layout_name, pack_rows, read_size, sniff_format
from fbench.replay.data.messages import Image, Message, Truth
from fbench.replay.data.rig import CameraModel
from fbench.replay.data.video import CODECS
from fbench.replay.logs.codecs.boxes import check_boxes
from fbench.replay.logs.codecs.codec import NothingError, Origin, Probe, TruthPart
from fbench.replay.logs.codecs.generic import Parse, parser_of
from fbench.replay.logs.codecs.video.stream import find_codec, peek_size
from fbench.replay.logs.container import Channel
from fbench.replay.logs.coordinate_frames import WORLDS, Edge

_MAX_NS, _MAX_NUMBER, _MAX_NAME = 2**63 - 1, 2**32 - 1, 1000
_COMPRESSED = ("jpeg", "jpg", "png", "webp")
_KNOWN = ", ".join((*_COMPRESSED, *CODECS))
B = TypeVar("B", Boxes2D, Boxes3D)


@dataclass(frozen=True, eq=False)
class NamedDecoder:
    """A decoder, as the user named it."""

    name: str  # For errors: `acme.py:radar`, or that of an entry point
    decoder: Decoder
    is_required: bool = False  # Whether the log must have messages for it

    def codec(self, channel: Channel) -> "PluginCodec | None":
        """Return its codec for a channel; `None` where it is for others."""
        fits = self.decoder.fits(channel.topic, channel.schema_name)
        return PluginCodec(self.name, self.decoder, channel) if fits else None


@dataclass(frozen=True, eq=False)
class PluginCodec:
    """Decodes the messages of one channel through a plug-in; see `Codec`."""

    name: str
    decoder: Decoder
    channel: Channel

    @property
    def kinds(self) -> tuple[str, ...]:
        """The kind that it declares."""
        return ("truth" if self.decoder.kind == "boxes" else self.decoder.kind,)

    def probe(self, data: memoryview) -> Probe:
        """Tell the kind alone; see `probe_at`."""
        return Probe(self.kinds[0], "")

    def probe_at(self, data: memoryview, origin: Origin) -> Probe:
        """Tell kind and coordinate frame from a message. Raises NothingError where it holds nothing."""
        kind = self.kinds[0]
        return Probe(kind, "" if kind == "truth" else self._decode(data, origin).sensor)

    def message(self, kind: str, data: memoryview, origin: Origin) -> Message:
        """Decode a measurement or pose, whose sensor is called as the log's user calls it."""
        return replace(self._decode(data, origin), sensor=origin.sensor)

    def assembler(self) -> None:
        """Each message that holds something is a measurement."""

    def truth(self, data: memoryview, origin: Origin) -> TruthPart:
        """Decode boxes."""
        found = self._call(data, origin)
        truth, frame_id = found if isinstance(found, BoxesIn) else (found, "")
        if not isinstance(truth, Truth) or not isinstance(frame_id, str) or len(frame_id) > _MAX_NAME:
            raise self._wrong(f"gave BoxesIn of {type(truth).__name__} and {type(frame_id).__name__}")
        if (truth.boxes3d is None) == (truth.boxes2d is None):
            raise self._wrong("gave a Truth without boxes, or with boxes3d and boxes2d; give one of them")
        truth = self._stamp(truth, origin)
        boxes3d, boxes2d = self._boxes(truth.boxes3d, Boxes3D), self._boxes(truth.boxes2d, Boxes2D)
        frame_id = WORLDS[0] if truth.in_world and not frame_id else frame_id.removeprefix("/")
        truth = replace(truth, boxes3d=boxes3d, boxes2d=boxes2d, frame_index=None, in_world=False)
        return TruthPart(truth, is_2d=boxes2d is not None, frame_id=frame_id)

    def transforms(self, data: memoryview) -> Sequence[tuple[str, Edge]]:
        """Decoders give none."""
        raise self._wrong("gives no transforms")

    def stamps(self, data: memoryview) -> Sequence[int]:
        """Decoders give no transforms."""
        raise self._wrong("gives no transforms")

    def calibration(self, data: memoryview) -> tuple[str, CameraModel]:
        """Decoders give none."""
        raise self._wrong("gives no calibration")

    @cached_property
    def _parser(self) -> Parse:
        return parser_of(self.channel, self.decoder.definition)

    def _call(self, data: memoryview, origin: Origin) -> Any:
        """Let the plug-in decode a message. Raises DecodeError in its name, whatever it raises or returns wrongly.
        Raises NothingError where it returns nothing.
        """
        channel, schema = self.channel, self.channel.schema
        encoding, definition = ("", b"") if schema is None else (schema.encoding, schema.data)
        payload = Payload(
            bytes(data), channel.topic, origin.log_ns, origin.publish_ns, channel.encoding, channel.schema_name,
            encoding, definition, channel.metadata, lambda: self._parser(data),
        )  # fmt: skip
        try:
            found = self.decoder(payload)
        except FbenchError as error:
            raise self._wrong(str(error)) from error
        except INTERRUPTS:
            raise
        except BaseException as error:
            raise self._wrong(one_line(error)) from error
        if found is None:
            raise NothingError("nothing of interest")
        expected = RESULTS[self.decoder.kind]
        if not isinstance(found, expected):
            names = " or ".join(kind.__name__ for kind in expected)
            raise self._wrong(f"gave {type(found).__name__}, expected {names}")
        return found

    def _decode(self, data: memoryview, origin: Origin) -> Message:
        found = self._call(data, origin)
        if not isinstance(found.sensor, str) or len(found.sensor) > _MAX_NAME:
            raise self._wrong(f"gave a sensor {found.sensor!r}, expected the name of a coordinate frame or ''")
        message: Message = self._stamp(found, origin)
        if isinstance(message, Image):
            message = self._image(message)
        return own_arrays(replace(message, sensor=message.sensor.removeprefix("/")))

    def _stamp(self, item: Any, origin: Origin) -> Any:
        """Return a message with times and number as plain integers, and the time of its recording."""
        numbers: dict[str, int | None] = {}
        for name, limit in (("stamp_ns", _MAX_NS), ("frame_number", _MAX_NUMBER)):
            value = getattr(item, name)
            if value is None and name == "frame_number":
                continue
            try:
                numbers[name] = index(value)
            except TypeError:
                raise self._wrong(f"gave {name} {value!r}, expected an int") from None
            if not 0 <= index(value) <= limit:
                raise self._wrong(f"gave {name} {value}, outside 0 to {limit}")
        return replace(item, **{"log_ns": origin.log_ns, "frame_number": origin.frame_number, **numbers})

    def _image(self, image: Image) -> Image:
        data, encoding = image.data, image.encoding
        if not isinstance(data, bytes | bytearray | memoryview) or not isinstance(encoding, str):
            raise self._wrong(f"gave an Image of {type(data).__name__}, expected bytes, in {encoding!r}")
        try:
            if encoding in _COMPRESSED:
                name = sniff_format(data)
                return replace(image, data=bytes(data), encoding=name, size_wh=read_size(bytes(data)))
            if codec := find_codec(encoding):
                return replace(image, data=bytes(data), encoding=codec, size_wh=peek_size(codec, bytes(data)))
            width, height = (index(side) for side in image.size_wh)
            name = layout_name(encoding)
            if width * height > MAX_PIXELS:
                raise DecodeError(f"image of {width}x{height} px is larger than {MAX_PIXELS} px")
            pixels = pack_rows(memoryview(data).cast("B"), name, (width, height), width * RAW_CHANNELS[name])
        except (TypeError, ValueError) as error:
            raise self._wrong(f"gave an Image with size_wh {image.size_wh!r} ({error})") from error
        except DecodeError as error:
            hint = "" if encoding in (*LAYOUTS, *_COMPRESSED) else f"; compressed ones are {_KNOWN}"
            raise self._wrong(f"gave an Image: {error}{hint}") from error
        return replace(image, data=pixels, encoding=name, size_wh=(width, height))

    def _boxes(self, boxes: B | None, kind: type[B]) -> B | None:
        if boxes is None:
            return None
        if not isinstance(boxes, kind):
            raise self._wrong(f"gave {type(boxes).__name__}, expected {kind.__name__}")
        try:
            checked = check_boxes(own_arrays(boxes))
        except DecodeError as error:
            raise self._wrong(str(error)) from error
        names = checked.source_label if checked.label is None else checked.label
        if names is None:
            return checked
        columns = labels(names.tolist())
        return replace(checked, **columns if checked.source_label is None else {"label": columns["label"]})

    def _wrong(self, text: str) -> DecodeError:
        return DecodeError(f"decoder '{self.name}': {text}")
