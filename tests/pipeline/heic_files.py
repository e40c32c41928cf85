"""HEIC files of several kinds, made of the one small picture tests/data/quadrants.heic (96 x 72 px, 8 bits).

No encoder is needed: a container (ISO/IEC 23008-12) is written anew around its coded picture (HEVC, ITU-T
H.265), whose sequence parameters are changed for ten bits.
"""

import struct
from dataclasses import dataclass
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[1] / "data" / "quadrants.heic"
WIDTH, HEIGHT = 96, 72
_SEQUENCE_NAL = b"\x42\x01"
"""Header of the NAL unit with the sequence parameters (H.265, 7.4.2.2: type 33)."""
_BEFORE_SIZE = 8 * 15
"""Bits of that unit before the picture's size: two bytes of header, one of its number, twelve of its
profile."""


@dataclass(frozen=True, kw_only=True)
class _Item:
    """One picture of a container: its kind, its bytes, and its properties as boxes."""

    kind: bytes
    data: bytes
    properties: tuple[bytes, ...]


def plain(*, rows: int = 1, columns: int = 1) -> bytes:
    """Three colours of 8 bits; of a grid, every tile is the same picture, as phones tile theirs."""
    tile = _tile()
    if rows == columns == 1:
        return _container([tile])
    tiles = rows * columns
    whole = _grid(rows, columns)
    links = [(b"dimg", tiles + 1, list(range(1, tiles + 1)))]
    return _container([*[tile] * tiles, whole], links, primary=tiles + 1)


def claimed(width: int, height: int) -> bytes:
    """The picture in a container that promises another size."""
    return _container([_tile(promised=(width, height))])


def with_alpha() -> bytes:
    """The picture with itself for its transparency."""
    kind = _full(b"auxC", b"urn:mpeg:mpegB:cicp:systems:auxiliary:alpha\0")
    alpha = _Item(kind=b"hvc1", data=_tile().data, properties=(*_tile().properties, kind))
    return _container([_tile(), alpha], [(b"auxl", 2, [1])])


def ten_bits() -> bytes:
    """The same picture of 10 bits a colour: what the coded numbers stand for grows with the depth."""
    return _container([_tile(depth=10)])


def _tile(*, depth: int = 8, promised: tuple[int, int] = (WIDTH, HEIGHT)) -> _Item:
    whole = SOURCE.read_bytes()
    start = whole.index(b"hvcC") + 4
    (length,) = struct.unpack_from(">I", whole, start - 8)
    record = bytearray(whole[start : start + length - 8])
    coded = whole[whole.index(b"mdat") + 4 : whole.index(b"\0\0\0\x06Exif", start)]
    if depth != 8:
        record[17] = record[18] = 0xF8 | (depth - 8)
        at = record.index(_SEQUENCE_NAL)
        (size,) = struct.unpack_from(">H", record, at - 2)
        changed = _deeper(bytes(record[at : at + size]), depth)
        record[at - 2 : at + size] = struct.pack(">H", len(changed)) + changed
    size = _full(b"ispe", struct.pack(">II", *promised))
    bits = _full(b"pixi", bytes((3, depth, depth, depth)))
    return _Item(kind=b"hvc1", data=coded, properties=(_box(b"hvcC", bytes(record)), size, bits))


def _grid(rows: int, columns: int) -> _Item:
    size = (columns * WIDTH, rows * HEIGHT)
    held = struct.pack(">BBBBHH", 0, 0, rows - 1, columns - 1, *size)
    return _Item(kind=b"grid", data=held, properties=(_full(b"ispe", struct.pack(">II", *size)),))


def _deeper(unit: bytes, depth: int) -> bytes:
    """A unit of sequence parameters with another depth of its colours (H.265, 7.3.2.2)."""
    plain_bytes = unit.replace(b"\0\0\x03", b"\0\0")
    bits = "".join(f"{byte:08b}" for byte in plain_bytes)
    at = _BEFORE_SIZE
    at = _after_number(bits, at)  # the unit's own number
    for _ in range(3):  # chroma format, width, height
        at = _after_number(bits, at)
    if bits[at] == "1":  # a window of the picture: four numbers
        at += 1
        for _ in range(4):
            at = _after_number(bits, at)
    else:
        at += 1
    end = _after_number(bits, _after_number(bits, at))
    bits = bits[:at] + 2 * _number(depth - 8) + bits[end:].rstrip("0")
    bits += "0" * (-len(bits) % 8)
    held = bytes(int(bits[k : k + 8], 2) for k in range(0, len(bits), 8))
    out = bytearray()
    for byte in held:
        if byte <= 3 and out[-2:] == b"\0\0":
            out.append(3)  # keeps start codes out (H.265, 7.4.1.1)
        out.append(byte)
    return bytes(out)


def _number(value: int) -> str:
    """An Exp-Golomb number (H.265, 9.2)."""
    bits = f"{value + 1:b}"
    return "0" * (len(bits) - 1) + bits


def _after_number(bits: str, at: int) -> int:
    return at + 2 * (bits.index("1", at) - at) + 1


def _container(
    items: list[_Item], links: list[tuple[bytes, int, list[int]]] | None = None, *, primary: int = 1
) -> bytes:
    """The items, numbered from one, with links (kind, from, to) between them."""
    properties = list(dict.fromkeys(box for item in items for box in item.properties))
    names = b"".join(
        _full(b"infe", struct.pack(">HH", k, 0) + item.kind + b"\0", version=2)
        for k, item in enumerate(items, 1)
    )
    owned = b"".join(
        struct.pack(">HB", k, len(item.properties)) + bytes(properties.index(p) + 1 for p in item.properties)
        for k, item in enumerate(items, 1)
    )
    refers = b"".join(
        _box(kind, struct.pack(f">HH{len(to)}H", start, len(to), *to)) for kind, start, to in links or ()
    )
    boxes = [
        _full(b"hdlr", bytes(4) + b"pict" + bytes(13)),
        _full(b"pitm", struct.pack(">H", primary)),
        _full(b"iinf", struct.pack(">H", len(items)) + names),
        _box(
            b"iprp",
            _box(b"ipco", b"".join(properties)) + _full(b"ipma", struct.pack(">I", len(items)) + owned),
        ),
        *([_full(b"iref", refers)] if refers else []),
    ]
    head = _box(b"ftyp", b"heic" + bytes(4) + b"mif1heic")
    place = len(head) + 12 + sum(map(len, boxes)) + 16 + 14 * len(items) + 8
    held = b"".join(dict.fromkeys(item.data for item in items))
    where = b"".join(
        struct.pack(">HHHII", k, 0, 1, place + held.index(item.data), len(item.data))
        for k, item in enumerate(items, 1)
    )
    boxes.append(_full(b"iloc", struct.pack(">HH", 0x4400, len(items)) + where))
    return head + _full(b"meta", b"".join(boxes)) + _box(b"mdat", held)


def _box(kind: bytes, held: bytes) -> bytes:
    return struct.pack(">I", 8 + len(held)) + kind + held


def _full(kind: bytes, held: bytes, *, version: int = 0) -> bytes:
    return _box(kind, bytes((version, 0, 0, 0)) + held)
