"""The messages of ROS 1 and ROS 2 bags and of MCAP files, decoded with the definitions in them.

Bags are read by ``rosbags``, single MCAP files by ``mcap``: messages as ROS 1, ROS 2 (CDR),
Protobuf or JSON. Both come with ``pip install 'kedge-nav[ros]'``.
"""

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from kedge.core.errors import DataError

T = TypeVar("T")


class Message(NamedTuple):
    """One message, not decoded yet."""

    topic: str
    type: str
    time: int
    """ns at which it was recorded."""
    decode: Callable[[], Any]


class Bag(NamedTuple):
    """An open bag."""

    topics: dict[str, str]
    """Topic -> name of its type."""
    messages: Callable[[set[str]], Iterator[Message]]
    """Messages of some topics, in the order of their recording."""
    notes: tuple[str, ...] = ()
    """What is missing of it."""


MAGIC = b"\x89MCAP0\r\n"
"""What an MCAP file begins with, and ends with if it was closed."""


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Open a ``.bag`` file, a ROS 2 folder, or a ``.mcap`` file.

    Raises:
        DataError: it is missing or cannot be read.
    """
    if not path.exists():
        raise DataError(f"{path}: no such file")
    with ExitStack() as stack:
        try:
            if path.suffix == ".mcap":
                bag = _mcap(path, stack)
            elif path.is_dir() and not (path / "metadata.yaml").exists():
                bag = _parts(path, stack)
            else:
                bag = _ros(path, stack)
        except ImportError:
            raise DataError(
                f"{path}: reading bags needs more packages: pip install 'kedge-nav[ros]'"
            ) from None
        yield bag


def _ros(path: Path, stack: ExitStack) -> Bag:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    try:
        # Old ROS 2 bags say nothing of their types: then the usual ones are meant.
        usual = get_typestore(Stores.LATEST)
        reader = stack.enter_context(AnyReader([path], default_typestore=usual))
    except Exception as error:
        raise _unreadable(path, "a bag", error) from error

    def messages(wanted: set[str]) -> Iterator[Message]:
        chosen = [c for c in reader.connections if c.topic in wanted]
        found = reader.messages(connections=chosen) if chosen else iter(())
        for connection, time, raw in _guarded(path, "a bag", found):
            kind = connection.msgtype

            def decode(raw: bytes = raw, kind: str = kind) -> Any:
                return reader.deserialize(raw, kind)

            yield Message(connection.topic, kind, time, decode)

    return Bag({c.topic: c.msgtype for c in reader.connections}, messages)


def _mcap(path: Path, stack: ExitStack) -> Bag:
    from mcap.reader import SeekingReader

    try:
        file = stack.enter_context(path.open("rb"))
        # No record is longer than the file, whatever it says of itself.
        most = path.stat().st_size
        if file.read(len(MAGIC)) != MAGIC:
            raise DataError(
                f"{path}: cannot be read as MCAP: its first bytes are another format's"
            )
        file.seek(max(most - len(MAGIC), 0))
        if most < 2 * len(MAGIC) or file.read() != MAGIC:
            return _unclosed(path, stack)
        file.seek(0)
        reader = SeekingReader(file, validate_crcs=True, record_size_limit=most)
        summary = reader.get_summary()
    except (DataError, ImportError):
        raise
    except Exception as error:
        raise _unreadable(path, "MCAP", error) from error
    if summary is None:
        return _unclosed(path, stack)
    kinds = _kinds(summary.channels, summary.schemas)

    def messages(wanted: set[str]) -> Iterator[Message]:
        yield from _decoded(
            _guarded(path, "MCAP", reader.iter_messages(topics=sorted(wanted))), kinds
        )

    return Bag(kinds, messages)


def _unclosed(path: Path, stack: ExitStack) -> Bag:
    """What is whole of an MCAP file that was not closed: all up to where it ends or is damaged.

    Raises:
        DataError: no message is.
    """
    from mcap.records import Channel, Schema
    from mcap.records import Message as Record
    from mcap.stream_reader import StreamReader

    file = stack.enter_context(path.open("rb"))
    records = StreamReader(file, validate_crcs=True, record_size_limit=path.stat().st_size)
    schemas: dict[int, Any] = {}
    channels: dict[int, Any] = {}
    whole: list[tuple[Any, Any, Any]] = []
    try:
        for record in records.records:
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Record):
                channel = channels[record.channel_id]
                whole.append((schemas.get(channel.schema_id), channel, record))
    except Exception as error:  # whatever ends it: what came before is whole
        if not whole:
            raise _unreadable(path, "MCAP", error, 0) from error
    kinds = _kinds(channels, schemas)
    whole.sort(key=lambda triple: triple[2].log_time)

    def messages(wanted: set[str]) -> Iterator[Message]:
        yield from _decoded((one for one in whole if one[1].topic in wanted), kinds)

    seconds = (whole[-1][2].log_time - whole[0][2].log_time) / 1e9 if whole else 0.0
    note = (
        f"{path.name}: it was not closed; {len(whole)} messages, of {seconds:.1f} s, "
        "are whole and were read"
    )
    return Bag(kinds, messages, (note,))


def _parts(folder: Path, stack: ExitStack) -> Bag:
    """The MCAP files of a ROS 2 folder without metadata, by their names.

    Raises:
        DataError: there are none.
    """
    bags = [_mcap(file, stack) for file in sorted(folder.glob("*.mcap"))]
    if not bags:
        raise DataError(
            f"{folder}: found neither metadata.yaml nor .mcap files, expected a ROS 2 bag; "
            "'ros2 bag reindex' writes the metadata of .db3 files"
        )

    def messages(wanted: set[str]) -> Iterator[Message]:
        for bag in bags:
            yield from bag.messages(wanted)

    topics = {topic: kind for bag in bags for topic, kind in bag.topics.items()}
    notes = [f"{folder.name}: no metadata.yaml; its {len(bags)} MCAP files were read by name"]
    return Bag(topics, messages, (*notes, *(note for bag in bags for note in bag.notes)))


def _kinds(channels: dict[int, Any], schemas: dict[int, Any]) -> dict[str, str]:
    return {
        channel.topic: schemas[channel.schema_id].name if channel.schema_id in schemas else "?"
        for channel in channels.values()
    }


def _decoded(
    records: Iterable[tuple[Any, Any, Any]], kinds: dict[str, str]
) -> Iterator[Message]:
    decoders: dict[int, Callable[[bytes], Any]] = {}
    for schema, channel, message in records:

        def decode(schema=schema, channel=channel, message=message) -> Any:
            if channel.id not in decoders:
                decoders[channel.id] = _decoder(channel.message_encoding, schema, message)
            return decoders[channel.id](message.data)

        yield Message(channel.topic, kinds[channel.topic], message.log_time, decode)


def _unreadable(path: Path, kind: str, error: Exception, count: int | None = None) -> DataError:
    """What any failure of a decoding library is to the user: the file is damaged."""
    at = "" if count is None else f" after {count} messages"
    what = f"{type(error).__name__}: {error}".rstrip(": ").partition("\n")[0]
    remedy = {
        "MCAP": "'mcap recover' writes what is whole of it into a new file",
        "a bag": "'rosbag reindex' (ROS 1) or 'ros2 bag reindex' may repair it",
    }[kind]
    return DataError(f"{path}: cannot be read as {kind}{at}: {what}; {remedy}")


def _guarded(path: Path, kind: str, messages: Iterator[T]) -> Iterator[T]:
    """Messages, as long as the library gets them out of the file.

    Raises:
        DataError: it does not; after how many.
    """
    count = 0
    while True:
        try:
            message = next(messages)
        except StopIteration:
            return
        except Exception as error:
            raise _unreadable(path, kind, error, count) from error
        yield message
        count += 1


def _decoder(encoding: str, schema: Any, message: Any) -> Callable[[bytes], Any]:
    """How messages of a channel are decoded; ValueError if nobody knows.

    Raises:
        ValueError: the encoding is none of ros1, cdr, protobuf, json.
    """
    if encoding == "json":
        return json.loads
    if encoding == "protobuf":
        from mcap_protobuf.decoder import DecoderFactory

        decoder = DecoderFactory().decoder_for(encoding, schema)
        if decoder is not None:
            return decoder
    if encoding in ("ros1", "cdr") and schema is not None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        store = get_typestore(Stores.EMPTY)
        kind = schema.name if "/msg/" in schema.name else schema.name.replace("/", "/msg/")
        store.register(get_types_from_msg(schema.data.decode(), kind))
        if encoding == "ros1":
            return lambda data: store.deserialize_ros1(data, kind)
        return lambda data: store.deserialize_cdr(data, kind)
    raise ValueError(f"messages encoded as {encoding!r}, expected ros1, cdr, protobuf or json")
