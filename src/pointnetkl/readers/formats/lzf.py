"""LZF, the compression of PCD files: literal runs, and copies of up to 264 bytes from up to 8 KiB before."""

_MOST_PER_BYTE = 88  # decompressed: three bytes code a copy of 264


def decompress(content: bytes, size: int) -> bytes:
    """Return the decompressed content, of `size` bytes.

    Raises:
        ValueError: the content is damaged, or its size is another.
    """
    if size > _MOST_PER_BYTE * len(content):
        raise ValueError(f"{len(content)} bytes cannot hold {size} compressed")
    out, position = bytearray(), 0
    try:
        while position < len(content) and len(out) <= size:
            control = content[position]
            if control < 32:
                out += content[position + 1 : position + 2 + control]
                position += 2 + control
                continue
            length = control >> 5
            if length == 7:
                position += 1
                length += content[position]
            back = ((control & 0x1F) << 8 | content[position + 1]) + 1
            position += 2
            _copy(out, back, length + 2)
    except IndexError as error:
        raise ValueError("its compressed points are cut") from error
    if len(out) != size:
        raise ValueError(f"its compressed points are damaged: {len(out)} bytes instead of {size}")
    return bytes(out)


def _copy(out: bytearray, back: int, length: int) -> None:
    if back > len(out):
        raise ValueError("its compressed points are damaged")
    source = out[len(out) - back :][:length]
    # a copy that reaches into itself repeats
    out += (source * (length // len(source) + 1))[:length]
