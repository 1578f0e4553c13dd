"""The processing parameters of a GSF file: which corrections its depths have, and what they are below."""

import struct

_UNKNOWN = ("", "UNKNOWN", "UNKNWN")
_LONGEST = 40  # of a value; what is longer is damaged


def parameters(content: memoryview) -> dict[str, str]:
    """Return the parameters of a record's bytes by name, as far as the bytes hold them."""
    found, at = {}, 10  # behind the time and the count
    while at + 2 <= len(content):
        (size,) = struct.unpack_from(">H", content, at)
        text = bytes(content[at + 2 : at + 2 + size]).decode("ascii", "replace").rstrip("\0")
        name, equals, value = text.partition("=")
        if equals:
            found[name.strip()] = value.strip()[:_LONGEST]
        at += 2 + size
    return found


def vertical(known: dict[str, str], tide: bool) -> str:
    """Return what depths are below; `tide` says whether a ping has one added, where the parameters do not."""
    datum, compensated = known.get("TIDAL_DATUM", ""), known.get("TIDE_COMPENSATED", "")
    if tide or compensated == "YES":
        below = f"below {datum}" if datum not in _UNKNOWN else "below a tidal datum that the file does not name"
        return f"{below}; tide applied"
    return "below the water line; tide not applied"


def unapplied(known: dict[str, str]) -> list[str]:
    """Return a sentence on the offsets and biases that the file leaves to its readers, which none of them are here."""
    left = [f"{name} {value}" for name, value in known.items() if name.endswith("_TO_APPLY") and _some(value)]
    return [f"it leaves corrections to apply, and they are not applied here ({', '.join(left[:5])})"] if left else []


def _some(value: str) -> bool:
    """Whether any of the numbers in a parameter is other than zero."""
    return any(digit in "123456789" for digit in value)
