"""The messages of ROS 2 in a stream of MCAP, one by one; a thread of its own reads the stream."""

import logging
import threading
import time
from collections import deque
from functools import cached_property
from pathlib import Path
from typing import IO, Any

from pcnav.core._extras import mcap, rosbags
from pcnav.core.errors import InputError

_CDR = "cdr"
_MAX_RECORD_BYTES = 500_000_000
_MAX_HELD_BYTES = 200_000_000
"""More than this is left in the pipe: its writer waits."""
_WAIT_S = 0.005
_WHERE = Path("standard input")
_LOG = logging.getLogger("pcnav")


class Came:
    """One message of the stream."""

    def __init__(self, topic: str, kind: str, log_ns: int, data: bytes, types: Any) -> None:
        self.topic, self.kind, self.log_ns = topic, kind, log_ns
        self.size = len(data)
        self.came_s = time.monotonic()
        """When it was all there."""
        self._data, self._types = data, types

    def content(self) -> Any:
        """Its fields. Raises `InputError` for a damaged one."""
        return self._content

    @cached_property
    def _content(self) -> Any:
        try:
            return self._types.deserialize_cdr(self._data, self.kind)
        except Exception as error:
            # The library raises what its parsers happen to: all is the stream's.
            why = " ".join(str(error).split())[:200] or type(error).__name__
            raise InputError(_WHERE, self.topic, f"expected a {self.kind} ({why})") from error


class McapMessages:
    """What has come of a stream so far."""

    def __init__(self, stream: IO[bytes]) -> None:
        """The stream is closed at its end. Raises `InputError` where a library is missing."""
        typesys = rosbags("typesys", "streams of MCAP")
        self._types = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        reader = mcap("stream_reader", "streams of MCAP").StreamReader
        self._records = mcap("records", "streams of MCAP")
        self._stream = stream
        self._reader = reader(stream, record_size_limit=_MAX_RECORD_BYTES)
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, tuple[str, int]] = {}
        self._came: deque[Came] = deque()
        self._held, self._has_stopped = 0, False
        self._failure: InputError | None = None
        threading.Thread(target=self._read, daemon=True).start()

    @property
    def kinds(self) -> dict[str, str]:
        """Of the messages by topic, as far as the stream has told."""
        told = list(self._channels.values())
        return {topic: self._schemas.get(schema, "") for topic, schema in told}

    @property
    def is_over(self) -> bool:
        """Whether all that ever comes was given."""
        return self._has_stopped and not self._came and self._failure is None

    def next(self) -> Came | None:
        """The next message, if there is one. Raises `InputError` for a stream of something else."""
        if self._failure is not None and not self._came:
            raise self._failure
        try:
            came = self._came.popleft()
        except IndexError:
            return None
        self._held -= came.size
        return came

    def _read(self) -> None:
        try:
            with self._stream:
                for record in self._reader.records:
                    self._take(record)
        except InputError as error:
            self._failure = error
        except Exception as error:
            why = " ".join(str(error).split())[:200] or type(error).__name__
            if self._channels:
                # Whoever wrote it was killed, as like as not.
                _LOG.warning("%s: ends early (%s)", _WHERE, why)
            else:
                expected = f"expected MCAP with messages of ROS 2 ({why})"
                self._failure = InputError(_WHERE, "stream", expected)
        self._has_stopped = True

    def _take(self, record: Any) -> None:
        records = self._records
        if isinstance(record, records.Schema):
            self._schemas[record.id] = record.name
        elif isinstance(record, records.Channel):
            if record.message_encoding != _CDR:
                expected = f"expected messages of ROS 2 ({_CDR}), got {record.message_encoding!r}"
                raise InputError(_WHERE, record.topic, expected)
            self._channels[record.id] = (record.topic, record.schema_id)
        elif isinstance(record, records.Message):
            topic, schema = self._channels[record.channel_id]
            kind = self._schemas.get(schema, "")
            came = Came(topic, kind, record.log_time, record.data, self._types)
            while self._held > _MAX_HELD_BYTES:
                time.sleep(_WAIT_S)
            self._held += came.size
            self._came.append(came)
