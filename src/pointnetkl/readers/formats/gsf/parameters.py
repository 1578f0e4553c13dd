"""The processing parameters of a GSF file: the corrections that its depths have, and the level that they are below."""

import struct

_UNKNOWN = ("", "UNKNOWN", "UNKNWN")
_LONGEST = 40  # characters of a value; a longer one is damaged


def parameters(content: memoryview) -> dict[str, str]:
    """Return the parameters in a record's bytes by name; a cut record gives the first of them."""
    values, offset = {}, 10  # after the time and the count
    while offset + 2 <= len(content):
        (size,) = struct.unpack_from(">H", content, offset)
        text = bytes(content[offset + 2 : offset + 2 + size]).decode("ascii", "replace").rstrip("\0")
        name, equals, value = text.partition("=")
        if equals:
            values[name.strip()] = value.strip()[:_LONGEST]
        offset += 2 + size
    return values


def vertical(parameters: dict[str, str], tide: bool) -> str:
    """Return the level that depths are below; `tide`: whether a ping has a tide added, if the parameters do not say."""
    datum, compensated = parameters.get("TIDAL_DATUM", ""), parameters.get("TIDE_COMPENSATED", "")
    if tide or compensated == "YES":
        below = f"below {datum}" if datum not in _UNKNOWN else "below a tidal datum that the file does not name"
        return f"{below}; tide applied"
    return "below the water line; tide not applied"


def unapplied(parameters: dict[str, str]) -> list[str]:
    """Return a sentence on offsets and biases that the file leaves to its readers; none of them is applied here."""
    corrections = [
        f"{name} {value}" for name, value in parameters.items() if name.endswith("_TO_APPLY") and _not_zero(value)
    ]
    return (
        [f"it leaves corrections to apply, and they are not applied here ({', '.join(corrections[:5])})"]
        if corrections
        else []
    )


def _not_zero(value: str) -> bool:
    """Whether any number in a parameter is not zero."""
    return any(digit in "123456789" for digit in value)
