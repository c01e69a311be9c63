"""Structured mutants of the files that pcnav reads: a fixed seed makes the same ones every time."""

import contextlib
import io
import json
import math
import random
import re
import struct
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path

NUMBERS = (
    *("nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "1e999", "0", "-0.0", "-1", "1", "0.5"),
    *("2147483648", "-9223372036854775809", "99999999999999999999", "1e18", "4" * 5000, "1" * 400),
    *('"text"', '""', "true", "[]", "{}", "null", "''", "1_000", "0x10", "+1", ".", "-", "٣"),
)
_NUMBER = re.compile(rb"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_JUNK = (
    b"\0",
    b"\xff",
    b"\x1b[31m",
    b"\r",
    b"\n",
    b",",
    b'"',
    b"[",
    b"]",
    b"{",
    b"}",
    b"\xe2\x80\xae",
)


def mutant(content: bytes, suffix: str, draw: random.Random) -> bytes:
    """A file with one or two things wrong with it, of a kind that its format has."""
    kinds = [*_ANY, *_BY_SUFFIX.get(suffix, _TEXT)]
    for _ in range(draw.choice((1, 1, 2))):
        content = draw.choice(kinds)(content, draw)
    return content


def _cut(content: bytes, draw: random.Random) -> bytes:
    return content[: draw.randrange(len(content) + 1)]


def _bytes(content: bytes, draw: random.Random) -> bytes:
    changed = bytearray(content or b"\0")
    for _ in range(draw.choice((1, 4, 64))):
        changed[draw.randrange(len(changed))] = draw.randrange(256)
    return bytes(changed)


def _doubled(content: bytes, draw: random.Random) -> bytes:
    start = draw.randrange(len(content) + 1)
    return content[:start] + content[start : start + 200] * draw.choice((2, 50)) + content[start:]


def _emptied(content: bytes, draw: random.Random) -> bytes:
    return draw.choice((b"", b"\n", b"\xef\xbb\xbf", b"\0" * 1000, b"\xff\xfe" + content))


def _number(content: bytes, draw: random.Random) -> bytes:
    found = list(_NUMBER.finditer(content[:200_000]))
    if not found:
        return _junk(content, draw)
    for match in sorted(
        draw.sample(found, min(len(found), draw.choice((1, 1, 3)))), key=lambda m: -m.start()
    ):
        text = draw.choice(NUMBERS).encode()
        content = content[: match.start()] + text + content[match.end() :]
    return content


def _column(content: bytes, draw: random.Random) -> bytes:
    """The same number wherever it stands: what is checked in one place may not be in another."""
    found = sorted({match[0] for match in _NUMBER.finditer(content[:20_000])})
    if not found:
        return content
    old, new = draw.choice(found), draw.choice(NUMBERS).encode()
    return re.sub(
        rb"(?<![\w.])" + re.escape(old) + rb"(?![\w.])", new.replace(b"\\", rb"\\"), content
    )


def _junk(content: bytes, draw: random.Random) -> bytes:
    at = draw.randrange(len(content) + 1)
    return content[:at] + draw.choice(_JUNK) * draw.choice((1, 1, 200)) + content[at:]


def _lines(content: bytes, draw: random.Random) -> bytes:
    lines = content.splitlines(keepends=True)
    if not lines:
        return content
    k = draw.randrange(len(lines))
    changed: Sequence[bytes] = draw.choice(
        (
            lines[:k] + lines[k + 1 :],
            [*lines[:k], lines[k], *lines[k:]],
            [*lines[:k], b"\n", *lines[k:]],
            [*lines[:k], lines[k].rstrip(b"\n"), *lines[k + 1 :]],
            lines[::-1],
            [*lines[:k], draw.choice(lines), *lines[k + 1 :]],
        )
    )
    return b"".join(changed)


def _nested(content: bytes, draw: random.Random) -> bytes:
    depth = draw.choice((20, 2000, 100_000))
    whole = draw.choice((True, False))
    text = b"[" * depth + b"]" * depth
    if whole:
        return draw.choice(
            (b"a = " + text, text, b'{"a":' * depth, b".".join([b"a"] * depth) + b" = 1")
        )
    found = list(_NUMBER.finditer(content[:200_000]))
    if not found:
        return text
    match = draw.choice(found)
    return content[: match.start()] + text + content[match.end() :]


def _key(content: bytes, draw: random.Random) -> bytes:
    words = sorted(set(re.findall(rb"[A-Za-z_]{3,}", content[:50_000])))
    if not words:
        return content
    old = draw.choice(words)
    new = draw.choice(
        (b"", b"x" * 5000, b"\x1b[2J", draw.choice(words), b"/dev/zero", b"../../x", b"\xc3\xa9")
    )
    return content.replace(old, new, draw.choice((1, -1)))


def _png(content: bytes, draw: random.Random) -> bytes:
    """A chunk with another content and a right sum: what the sum guards is not what is tested."""
    if len(content) < 45:
        return content
    header = bytearray(content[16:29])
    k = draw.randrange(3)
    if k == 0:
        header[:8] = struct.pack(
            ">II", *draw.choice(((0, 0), (1, 1), (65535, 65535), (2**31 - 1, 1), (9000, 9000)))
        )
    elif k == 1:
        header[8] = draw.choice((1, 2, 8, 16, 255))
    else:
        header[9] = draw.choice((0, 2, 3, 4, 6, 9))
    chunk = b"IHDR" + bytes(header)
    return content[:12] + chunk + struct.pack(">I", zlib.crc32(chunk)) + content[33:]


def _binary_count(content: bytes, draw: random.Random) -> bytes:
    """Four or eight bytes of a count, an index or a float that are extreme."""
    changed = bytearray(content or b"\0" * 8)
    words = (
        b"\xff" * 4,
        b"\0" * 4,
        b"\xff\xff\xff\x7f",
        b"\0\0\xc0\x7f",
        b"\0\0\x80\x7f",
        b"\xff" * 8,
        b"\0\0\0\x80",
        *(struct.pack("<d", number) for number in (math.nan, math.inf, -1e308, 0.0, 1e300)),
        *(struct.pack("<f", number) for number in (-math.inf, 3e38, -1.0)),
        b"\x01",
        b"\xff",
    )
    for _ in range(draw.choice((1, 3))):
        at = draw.randrange(max(1, min(len(changed), draw.choice((100, 100_000_000)))))
        word = draw.choice(words)
        changed[at : at + len(word)] = word
    return bytes(changed)


def _glb_json(content: bytes, draw: random.Random) -> bytes:
    """The JSON of a GLB, with its length made right again."""
    if content[:4] != b"glTF" or len(content) < 20:
        return content
    length = int.from_bytes(content[12:16], "little")
    text = draw.choice((_number, _column, _key, _nested))(content[20 : 20 + length], draw)
    text += b" " * (-len(text) % 4)
    rest = content[20 + length :]
    head = b"glTF" + struct.pack("<II", 2, 20 + len(text) + len(rest))
    return head + struct.pack("<I", len(text)) + b"JSON" + text + rest


def _npz(content: bytes, draw: random.Random) -> bytes:
    import zipfile

    import numpy as np

    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    except Exception:  # What was mutated before is no archive any more.
        return content
    stream = io.BytesIO()
    for name in draw.sample(sorted(members), draw.choice((1, len(members)))):
        with contextlib.suppress(ValueError):
            was = np.load(io.BytesIO(members[name]))
            array = draw.choice(
                (
                    np.array([None, {}], dtype=object),
                    np.zeros((3, 2, 2)),
                    np.full((3, 20, 20), np.nan),
                    np.array(["a"] * 3),
                    np.zeros(len(was) if was.ndim else 0),
                    was.astype(complex),
                    was.astype(bool),
                    np.full(was.shape, draw.choice((math.nan, math.inf, 1e308, 0.0, -1.0))),
                    was[..., None],
                )
            )
            member = io.BytesIO()
            np.save(member, array, allow_pickle=True)
            size = f"({array.shape[0]}".encode() if array.ndim else b"()"
            new = b"(" + draw.choice((b"-3", b"9" * 12, b"1e9"))
            data = member.getvalue()
            members[name] = data.replace(size, new, 1) if draw.random() < 0.3 else data
    with zipfile.ZipFile(stream, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    whole = bytearray(stream.getvalue())
    if draw.random() < 0.4:
        method = draw.choice((1, 12, 14, 99))
        for mark, offset in ((b"PK\x03\x04", 8), (b"PK\x01\x02", 10)):
            at = whole.find(mark)
            whole[at + offset : at + offset + 2] = struct.pack("<H", method)
    return bytes(whole)


def _parquet(content: bytes, draw: random.Random) -> bytes:
    """A record whose values of the run are of other types, in a file that is whole."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(pa.BufferReader(content))
    except Exception:  # What was mutated before is no table any more.
        return content
    meta = dict(table.schema.metadata or {})
    keys = [key for key in meta if key not in (b"ARROW:schema", b"pandas")]
    if keys and draw.random() < 0.7:
        about = json.loads(meta[keys[0]])
        name = draw.choice(sorted(about))
        value: object = draw.choice(
            (
                None,
                1,
                -1.5,
                "a",
                [],
                {},
                [[1]],
                {"a": []},
                [["a", "b", "c"]],
                "/dev/zero",
                "x" * 9000,
                10**400,
                "\x1b[31m",
            )
        )
        inner = about[name]
        if isinstance(inner, dict) and inner and draw.random() < 0.5:
            inner[draw.choice(sorted(inner))] = value
        elif isinstance(inner, list) and inner and draw.random() < 0.5:
            inner[draw.randrange(len(inner))] = value
        elif draw.random() < 0.3:
            del about[name]
        else:
            about[name] = value
        meta[keys[0]] = json.dumps(about).encode()
        table = table.replace_schema_metadata(meta)
    else:
        name = draw.choice(table.column_names) if table.column_names else None
        if name is not None:
            k = table.column_names.index(name)
            column = draw.choice(
                (
                    pa.array(["a"] * len(table)),
                    pa.nulls(len(table)),
                    pa.array([[1.0]] * len(table)),
                    pa.array([float("inf")] * len(table)),
                )
            )
            table = draw.choice(
                (table.drop_columns([name]), table.set_column(k, name, column), table.slice(0, 0))
            )
    sink = io.BytesIO()
    pq.write_table(table, sink)
    return sink.getvalue()


Mutation = Callable[[bytes, random.Random], bytes]
_ANY: tuple[Mutation, ...] = (_cut, _bytes, _emptied)
_TEXT: tuple[Mutation, ...] = (
    _number,
    _number,
    _number,
    _column,
    _junk,
    _lines,
    _nested,
    _key,
    _doubled,
)
_BINARY: tuple[Mutation, ...] = (_binary_count, _binary_count, _bytes, _doubled)
_BY_SUFFIX: dict[str, tuple[Mutation, ...]] = {
    ".png": (_png, _png, _binary_count),
    ".stl": _BINARY,
    ".ply": (*_BINARY, _number, _key),
    ".gltf": (*_TEXT, _number, _column),
    ".glb": (_glb_json, _glb_json, _glb_json, _binary_count),
    ".npz": (_npz, _npz, _npz, _binary_count),
    ".npy": (_binary_count, _number, _key),
    ".tiff": _BINARY,
    ".parquet": (_parquet, _parquet, _parquet, _binary_count),
    ".viser": _BINARY,
    ".bag": _BINARY,
    ".mcap": _BINARY,
    ".db3": _BINARY,
    ".exr": _BINARY,
    ".tif": _BINARY,
    ".pcd": (*_BINARY, *_TEXT),
}


def mutated(path: Path, draw: random.Random) -> None:
    """Replace a file by a mutant of it."""
    path.write_bytes(mutant(path.read_bytes(), path.suffix, draw))
