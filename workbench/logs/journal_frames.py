"""File format of a journal: frames with a checksum each, found again behind any damage.

A frame is its kind, the identity of the run, the number of rows before it, the size of its content,
the content, and the CRC-32 of all of these. The schema (`HEAD`, an Arrow schema with the metadata
of the log) comes twice, so that one damaged place leaves one of them; rows (`ROWS`) are float64,
row by row; `END` follows the last row of a journal that was closed in order.

Journals of version 0.3 and before are Arrow IPC streams, without checksums.
"""

import io
import struct
import zlib
from collections.abc import Iterator

import numpy as np
import pyarrow as pa

from aerodima.workbench.core.errors import LogError
from aerodima.workbench.logs.schema import decode_metadata

Content = tuple[pa.Table, list[str]]
"""Rows, and sentences on what is damaged or missing."""
_MARK = b"\x89AJ1"
HEAD = _MARK + b"head"
ROWS = _MARK + b"rows"
END = _MARK + b"end\n"
_START = struct.Struct("<8s8sQI")
"""Kind, identity of the run, rows before, size of the content in bytes."""
_STREAM_END = b"\xff\xff\xff\xff\x00\x00\x00\x00"
"""Last bytes of an Arrow stream that ended in order."""
_CUT_OFF = "not ended in order: the last rows may be lost"
_UNCHECKED = "written by an earlier version, without checksums: its values could not be checked"


def make_frame(kind: bytes, run: bytes, rows_before: int, content: bytes = b"") -> bytes:
    """Makes the bytes of a frame."""
    body = _START.pack(kind, run, rows_before, len(content)) + content
    return body + zlib.crc32(body).to_bytes(4, "little")


def _whole_frames(journal: memoryview, marks: bytes | bytearray) -> Iterator[tuple[int, int]]:
    """Yields begin and end of the frames whose checksum is right, whatever is between them."""
    begin = marks.find(_MARK)
    while 0 <= begin <= len(journal) - _START.size:
        end = begin + _START.size + _START.unpack_from(journal, begin)[3]
        if zlib.crc32(journal[begin:end]).to_bytes(4, "little") == journal[end : end + 4]:
            yield begin, end
            begin = end + 3
        begin = marks.find(_MARK, begin + 1)


def read_content(journal: bytes | bytearray, source: str) -> Content:
    """Reads the whole rows of a journal, and names what is damaged, missing or in doubt.

    Raises:
        LogError: no whole head, not a journal, another schema version.
    """
    if _MARK not in journal:
        return _read_stream(journal, source)
    view = memoryview(journal)
    damage = []
    schema: pa.Schema | None = None
    identity = b""
    place = rows = 0
    last_kind = b""
    blocks: list[np.ndarray] = []
    for begin, end in _whole_frames(view, journal):
        kind, run, rows_before, _ = _START.unpack_from(view, begin)
        content = view[begin + _START.size : end]
        if schema is None and kind == HEAD:
            schema = pa.ipc.read_schema(pa.py_buffer(content))
            decode_metadata(schema.metadata, source)
            identity = run
        if schema is None or run != identity or rows_before < rows * (kind != HEAD):
            continue  # of another run, or copied from elsewhere in the file
        if begin > place or rows_before > rows:
            lost = max(rows_before - rows, 0)
            damage.append(
                f"bytes {place} to {begin} are damaged: {lost} rows after row {rows} are lost"
            )
        place = end + 4
        last_kind = kind
        if kind == ROWS:
            blocks.append(np.frombuffer(content).reshape(-1, len(schema)))
            rows = rows_before + len(blocks[-1])
    if schema is None:
        raise LogError(f"{source}: cut off or damaged in its head; nothing to rescue")
    if place < len(journal):
        damage.append(f"bytes {place} to {len(journal)} are damaged or cut off")
    if last_kind != END:
        damage.append(_CUT_OFF)
    columns = [np.concatenate([[], *(block[:, i] for block in blocks)]) for i in range(len(schema))]
    return pa.table(columns, schema=schema), damage


def _read_stream(journal: bytes | bytearray, source: str) -> Content:
    """Reads an Arrow stream in which any byte may be wrong."""
    file = io.BytesIO(journal)
    batches: list[pa.RecordBatch] = []
    damage = [_UNCHECKED]
    try:
        stream = pa.ipc.open_stream(file)
        schema = stream.schema
        if schema.types != [pa.float64()] * len(set(schema.names)):
            raise ValueError("columns that are no numbers, or named twice")
        for batch in stream:
            batch.validate(full=True)
            batches.append(batch)
        is_whole = file.tell() == len(journal) and journal.endswith(_STREAM_END)
    except Exception as cause:  # whatever Arrow makes of damaged bytes
        if not batches:
            raise LogError(
                f"{source}: cut off before its first whole batch, or not a journal; nothing to "
                "rescue"
            ) from cause
        is_whole = False
    decode_metadata(schema.metadata, source)
    if not is_whole:
        damage.append("damaged or not ended in order: rows that follow may be lost")
    return pa.Table.from_batches(batches, schema=schema), damage
