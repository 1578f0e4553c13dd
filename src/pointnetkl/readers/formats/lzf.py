"""LZF, the compression of PCD files: literal runs, and copies of up to 264 bytes from up to 8 KiB before."""

_MOST_PER_BYTE = 88  # of three bytes, a copy of 264


def decompress(content: bytes, size: int) -> bytes:
    """Return the `size` bytes that were compressed.

    Raises:
        ValueError: the content is damaged or of another size.
    """
    if size > _MOST_PER_BYTE * len(content):
        raise ValueError(f"{len(content)} bytes cannot hold {size} compressed")
    out, at = bytearray(), 0
    try:
        while at < len(content) and len(out) <= size:
            control = content[at]
            if control < 32:
                out += content[at + 1 : at + 2 + control]
                at += 2 + control
                continue
            length = control >> 5
            if length == 7:
                at += 1
                length += content[at]
            back = ((control & 0x1F) << 8 | content[at + 1]) + 1
            at += 2
            _copy(out, back, length + 2)
    except IndexError as error:
        raise ValueError("its compressed points are cut") from error
    if len(out) != size:
        raise ValueError(f"its compressed points are damaged: {len(out)} bytes instead of {size}")
    return bytes(out)


def _copy(out: bytearray, back: int, length: int) -> None:
    if back > len(out):
        raise ValueError("its compressed points are damaged")
    found = out[len(out) - back :][:length]
    # a copy may reach into itself: then it repeats
    out += (found * (length // len(found) + 1))[:length]
