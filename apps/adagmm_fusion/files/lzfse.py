"""LZFSE, Apple's compression: what is stored uncompressed is read here, the rest by the package pyliblzfse.

bvx-  uint32 size, so many bytes as they are        bvx1, bvx2, bvxn  compressed blocks        bvx$  the end
"""

import struct

from adagmm_fusion.errors import RecordingError

END, STORED = b"bvx$", b"bvx-"


def decoded_lzfse(data: bytes, size: int, where: str) -> bytes:
    """Exactly `size` bytes. Raises RecordingError, starting with `where`, if the data is damaged or of another size."""
    out = data if len(data) == size else _stored(data)  # some programs leave it out altogether
    if out is None:
        try:
            import liblzfse
        except ImportError as problem:
            raise RecordingError(f"{where}: is compressed with LZFSE; install pyliblzfse to read it") from problem
        try:
            out = liblzfse.decompress(data)
        except Exception as problem:  # its own error class
            raise RecordingError(f"{where}: is damaged: {problem}") from problem
    if len(out) != size:
        raise RecordingError(f"{where}: expected {size} bytes, got {len(out)}")
    return out


def _stored(data: bytes) -> bytes | None:
    """The bytes of blocks that are all uncompressed; None where one is compressed."""
    parts, at = [], 0
    while data[at : at + 4] == STORED and at + 8 <= len(data):
        (size,) = struct.unpack_from("<I", data, at + 4)
        parts.append(data[at + 8 : at + 8 + size])
        at += 8 + size
    return b"".join(parts) if parts and data[at : at + 4] == END else None
