"""The echo sounder of a GSF file, by the kind of the part in which a ping holds the sonar's own values."""

import struct
from functools import lru_cache

# kinds of Kongsberg's parts that begin with model, count of pings and serial number
_MODEL_PING_SERIAL = {118, 119, 120, *range(128, 136), *range(139, 150), 157}
_KMALL, _R2SONIC = 156, (151, 152, 153)

_NAMES = {
    102: "SeaBeam",
    103: "Kongsberg EM12",
    104: "Kongsberg EM100",
    105: "Kongsberg EM950",
    106: "Kongsberg EM121A",
    107: "Kongsberg EM121",
    108: "SASS",
    109: "SeaMap",
    110: "Reson SeaBat",
    111: "Kongsberg EM1000",
    112: "SeaBeam type III",
    113: "SeaBeam with amplitudes",
    114: "Reson SeaBat II",
    115: "Reson SeaBat 8101",
    116: "SeaBeam 2112",
    117: "ELAC Bottomchart MkII",
    118: "Kongsberg EM3000",
    119: "Kongsberg EM1002",
    120: "Kongsberg EM300",
    121: "SASS, compressed",
    122: "Reson SeaBat 8101",
    123: "Reson SeaBat 8111",
    124: "Reson SeaBat 8124",
    125: "Reson SeaBat 8125",
    126: "Reson SeaBat 8150",
    127: "Reson SeaBat 8160",
    128: "Kongsberg EM120",
    129: "Kongsberg EM3002",
    130: "Kongsberg EM3000D",
    131: "Kongsberg EM3002D",
    132: "Kongsberg EM121A",
    133: "Kongsberg EM710",
    134: "Kongsberg EM302",
    135: "Kongsberg EM122",
    136: "GeoSwath Plus",
    137: "Klein 5410 BSS",
    138: "Reson SeaBat 7125",
    139: "Kongsberg EM2000",
    140: "Kongsberg EM300",
    141: "Kongsberg EM1002",
    142: "Kongsberg EM2000",
    143: "Kongsberg EM3000",
    144: "Kongsberg EM120",
    145: "Kongsberg EM3002",
    146: "Kongsberg EM3000D",
    147: "Kongsberg EM3002D",
    148: "Kongsberg EM121A",
    149: "Kongsberg EM2040",
    150: "Imagenex Delta T",
    151: "R2Sonic 2022",
    152: "R2Sonic 2024",
    153: "R2Sonic 2020",
    155: "Reson SeaBat T series",
    156: "Kongsberg",
    157: "Kongsberg ME70BO",
    201: "Odom Echotrac",
    202: "ODEC Bathy 2000",
    203: "MGD77 track line",
    204: "BDB track line",
    205: "NOS HDB track line",
    206: "Odom Echotrac",
    207: "ODEC Bathy 2000",
    208: "MGD77 track line",
    209: "BDB track line",
    210: "NOS HDB track line",
    211: "PDD",
    212: "Navisound",
}


def name(kind: int, content: bytes) -> str:
    """Return maker and model for a kind of part, with the model and serial number in its bytes; "" for kind 0."""
    return _named(kind, content[:24] if kind in _R2SONIC else content[:2] + content[4:6]) if kind else ""


@lru_cache(maxsize=64)
def _named(kind: int, content: bytes) -> str:
    sensor = _NAMES.get(kind, f"sensor id {kind}")
    if kind in _R2SONIC:
        serial = content[12:].split(b"\0")[0].decode("ascii", "replace").strip()
        return f"{sensor}, serial {serial}" if serial else sensor
    if len(content) < 4:
        return sensor
    model, number = struct.unpack(">HH", content)
    if kind == _KMALL:
        return f"{sensor} EM{number}"
    if kind not in _MODEL_PING_SERIAL or not model:
        return sensor
    return f"{sensor}, serial {number}" if str(model) in sensor else f"{sensor}, model {model}, serial {number}"
