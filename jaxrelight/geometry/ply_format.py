"""The PLY format: a header, and elements in rows of text or bytes."""

import dataclasses
import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxrelight.errors import InputError

TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"double": "f8", "float16": "f2", "float32": "f4", "float64": "f8", "int64": "i8", "uint64": "u8"},
}
# What the list of a polygon's corners is called.
CORNERS = "vertex_indices", "vertex_index"


@dataclasses.dataclass
class Property:
    """A number, or where `counter` is set a list that begins with its length."""

    name: str
    kind: str
    counter: str = ""


@dataclasses.dataclass
class Element:
    """A table of the file: its name, how many rows it has, and its columns."""

    name: str
    count: int
    properties: list[Property]

    def find(self, *names: str) -> Property | None:
        """The first property with one of these names."""
        return next((item for name in names for item in self.properties if item.name == name), None)


class Lists(NamedTuple):
    """Lists one after the other, and how long each is."""

    values: Float[np.ndarray, " n"]
    lengths: Int[np.ndarray, " rows"]


# The content of an element by property: a number or a list of each row.
Content = dict[str, np.ndarray | Lists]


def read_header(data: bytes) -> tuple[str, list[Element], bytes, bytes]:
    """Encoding, elements, the header and what follows it.

    Raises:
        InputError: for whatever is no header of a PLY file.
    """
    if data[:3] != b"ply":
        raise InputError("not a PLY file: it does not begin with 'ply'; check what it is")
    end = re.search(rb"^end_header[ \t]*(\r\n|\n|\r|$)", data, re.MULTILINE)
    if end is None:
        raise InputError("cut short or not a PLY file: its header has no end; export or copy it again")
    encoding, elements, header = "", [], data[: end.start()]
    for line in header.decode("ascii", "replace").splitlines()[1:]:
        match line.split():
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", kind, _]:
                encoding = kind.lower()
            case ["element", name, count] if count.isdecimal():
                elements.append(Element(name, int(count), []))
            case ["property", kind, name] if elements and kind in TYPES:
                elements[-1].properties.append(Property(name, kind))
            case ["property", "list", counter, kind, name] if elements and {counter, kind} <= set(TYPES):
                elements[-1].properties.append(Property(name, kind, counter))
            case _:
                raise InputError(f"PLY header line {line.strip()[:60]!r} is not understood; export it again")
    if encoding not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise InputError(f"PLY encoding {encoding[:30]!r} is unknown; export it as ascii or binary_little_endian")
    required = {"vertex": {"x", "y", "z"}, "face": set()}
    for element in elements:
        names = [item.name for item in element.properties]
        if len(set(names)) < len(names) or [other.name for other in elements].count(element.name) > 1:
            raise InputError("PLY header declares a name twice; export it again")
        if element.count and not required.get(element.name, set()) <= set(names):
            raise InputError("PLY vertices lack x, y or z; export it again")
        lists = [item.name for item in element.properties if item.counter]
        if element.count and element.name in ("face", "tristrips") and not set(CORNERS) & set(lists):
            raise InputError(f"PLY {element.name} elements lack the list vertex_indices; export it again")
    return encoding, elements, header, data[end.end() :]


def read_ascii(elements: Sequence[Element], body: bytes) -> tuple[dict[str, Content], list[str]]:
    """The content of each element of a text file, and what is doubtful.

    Raises:
        InputError: rows are missing, or the last one is incomplete.
    """
    notes = [] if body.endswith((b"\n", b"\r")) else ["the last line has no end: the file may be cut short"]
    rows = [row for row in body.decode("ascii", "replace").splitlines() if row.strip()]
    promised = sum(element.count for element in elements)
    if len(rows) < promised:
        raise InputError(f"cut short: {promised:,} rows promised but {len(rows):,} found; export or copy it again")
    if len(rows) > promised:
        notes.append(f"ignored {len(rows) - promised:,} rows after the promised ones")
    content, start = {}, 0
    for element in elements:
        mine = rows[start : start + element.count]
        start += element.count
        is_last = start == promised and bool(element.count)
        content[element.name] = _ascii_element(element, mine, is_last)
    return content, notes


def _ascii_element(element: Element, rows: Sequence[str], is_last: bool) -> Content:
    """An element by its rows; a list with fewer words than it promises is empty."""
    scalars: dict[str, list[str]] = {item.name: [] for item in element.properties if not item.counter}
    values: dict[str, list[str]] = {item.name: [] for item in element.properties if item.counter}
    lengths: dict[str, list[int]] = {name: [] for name in values}
    for number, row in enumerate(rows):
        words, at = row.split(), 0
        for item in element.properties:
            if item.counter:
                count = int(words[at])
                mine = words[at + 1 : at + 1 + count]
                if len(mine) < count:
                    if is_last and number == len(rows) - 1:
                        raise InputError("cut short: its last row is incomplete; export or copy it again")
                    mine = []
                if TYPES[item.kind][0] in "iu":
                    for word in mine:
                        int(word)
                values[item.name] += mine
                lengths[item.name].append(len(mine))
                at += 1 + count
            elif at < len(words):
                scalars[item.name].append(words[at])
                at += 1
            elif is_last and number == len(rows) - 1:
                raise InputError("cut short: its last row is incomplete; export or copy it again")
            else:
                raise ValueError(f"row {number + 1} of {element.name} is incomplete")
    content: Content = {name: np.array(words, float) for name, words in scalars.items()}
    for name, words in values.items():
        content[name] = Lists(np.array(words, float), np.array(lengths[name], np.int64))
    return content


def read_binary(elements: Sequence[Element], body: bytes, encoding: str) -> tuple[dict[str, Content], list[str]]:
    """The content of each element of a binary file, and what is doubtful.

    Raises:
        InputError: bytes are missing.
    """
    order = ">" if "big" in encoding else "<"
    least = sum(e.count * sum(_dtype(p.counter or p.kind, order).itemsize for p in e.properties) for e in elements)
    if least > len(body):
        raise InputError(
            f"cut short: at least {least:,} bytes promised after its header but {len(body):,} found; "
            "export or copy it again"
        )
    content, at = {}, 0
    for element in elements:
        even = _even_rows(element, body, at, order)
        content[element.name], at = _uneven_rows(element, body, at, order) if even is None else even
    notes = [f"ignored {len(body) - at:,} bytes after the promised ones"] if at < len(body) else []
    return content, notes


def _dtype(kind: str, order: str) -> np.dtype:
    return np.dtype(order + TYPES[kind])


def _even_rows(element: Element, body: bytes, at: int, order: str) -> tuple[Content, int] | None:
    """An element whose lists are all as long as in its first row, read at once; None where they are not."""
    fields, row = [], at
    for number, item in enumerate(element.properties if element.count else ()):
        kind = _dtype(item.kind, order)
        if not item.counter:
            fields.append((f"{number}", kind))
            row += kind.itemsize
            continue
        counter = _dtype(item.counter, order)
        if row + counter.itemsize > len(body):
            return None
        length = int(np.frombuffer(body, counter, 1, row)[0])
        if length < 0 or row + counter.itemsize + length * kind.itemsize > len(body):
            return None
        fields += [(f"count {number}", counter), (f"{number}", kind, (length,))]
        row += counter.itemsize + length * kind.itemsize
    table = np.dtype(fields)
    if at + element.count * table.itemsize > len(body):
        return None
    rows = np.frombuffer(body, table, element.count, at) if fields else np.zeros(0, table)
    content: Content = {}
    for number, item in enumerate(element.properties):
        if not element.count:
            content[item.name] = Lists(np.zeros(0), np.zeros(0, np.int64)) if item.counter else np.zeros(0)
        elif item.counter:
            values, counts = rows[f"{number}"], rows[f"count {number}"]
            if (counts != values.shape[-1]).any():
                return None
            content[item.name] = Lists(values.reshape(-1).astype(float), counts.astype(np.int64))
        else:
            content[item.name] = rows[f"{number}"]
    return content, at + element.count * table.itemsize


def _uneven_rows(element: Element, body: bytes, at: int, order: str) -> tuple[Content, int]:
    """An element row by row, and where it ends."""
    columns: dict[str, list] = {item.name: [] for item in element.properties}
    lengths: dict[str, list[int]] = {item.name: [] for item in element.properties if item.counter}
    kinds = [
        (item.name, _dtype(item.kind, order), _dtype(item.counter, order) if item.counter else None)
        for item in element.properties
    ]
    for _ in range(element.count):
        for name, kind, counter in kinds:
            length = 1
            if counter is not None:
                if at + counter.itemsize > len(body):
                    raise InputError(f"cut short: {element.count:,} rows of {element.name!r} promised; export it again")
                length = int(np.frombuffer(body, counter, 1, at)[0])
                at += counter.itemsize
                lengths[name].append(length)
            if length < 0 or at + length * kind.itemsize > len(body):
                raise InputError(f"cut short: {element.count:,} rows of {element.name!r} promised; export it again")
            columns[name].append(np.frombuffer(body, kind, length, at))
            at += length * kind.itemsize
    content: Content = {}
    for name, _, counter in kinds:
        values = np.concatenate([np.zeros(0), *columns[name]]).astype(float)
        content[name] = values if counter is None else Lists(values, np.array(lengths[name], np.int64))
    return content, at
