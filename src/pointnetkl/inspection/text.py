"""The facts of a file as text: a block of aligned lines, without those that are unknown."""

import textwrap
from collections.abc import Mapping, Sequence

from pointnetkl.inspection import earth
from pointnetkl.inspection.facts import Facts
from pointnetkl.surveys.survey import SWATHS

_WIDTH = 110
_LABEL = 12  # columns, with the margin
_PURPOSE = {
    "points": "points without pings: submaps are cut in tiles, for labels and predictions, not for SLAM",
    "submaps": "a submap with its pose, as another program cut it",
    "grid": "a grid of depths: a seabed to simulate surveys over (section simulate of the parameters)",
    "navigation": "navigation without soundings: it may take the place of a survey's own",
}
_DAYS = ("Sunday", "Monday", "Tuesday", "Wednesday", "Thursday", "Friday", "Saturday")  # in the order of the GPS week


def block(facts: Facts) -> str:
    """Return the known facts of a file, under its name."""
    rows = [
        ("format", facts.format),
        ("sensor", facts.sensor),
        ("kind", _PURPOSE.get(facts.kind or "")),
        ("time", _time(facts)),
        ("records", facts.records and f"{facts.records:,}"),
        ("pings", _pings(facts)),
        ("soundings", _soundings(facts)),
        ("track", _length(facts.track_m)),
        ("swath", facts.swath_m and f"{_length(facts.swath_m)} wide (median)"),
        ("area", facts.area_m2 and f"about {_area(facts.area_m2)}"),
        ("depth", _depth(facts)),
        ("vertical", facts.vertical),
        ("CRS", _crs(facts)),
        ("extent", _extent(facts)),
        ("pose", _pose(facts.pose)),
        ("skipped", _counts(facts.skipped) or ("nothing" if facts.kind != "grid" else None)),
        *(("problem", problem) for problem in facts.problems),
        *(("plot", plot) for plot in facts.plots),
    ]
    return "\n".join([facts.file, *(_row(label, words) for label, words in rows if words)])


def total(files: Sequence[Facts]) -> str:
    """Return a line of totals over several files."""
    refused = sum(facts.error is not None for facts in files)
    pings, soundings, valid = (
        sum(getattr(facts, name) or 0 for facts in files if facts.kind != "grid")
        for name in ("pings", "soundings", "valid")
    )
    counts = f"{_count(len(files), 'file')}, {_count(pings, 'ping')}, {_count(soundings, 'sounding')}, {valid:,} valid"
    return f"{counts}; {refused} of the files cannot be used" if refused else counts


def _row(label: str, words: str) -> str:
    lines = textwrap.wrap(words, _WIDTH - _LABEL, break_long_words=False, break_on_hyphens=False)
    return f"  {label:<{_LABEL - 2}}" + f"\n{' ' * _LABEL}".join(lines)


def _time(facts: Facts) -> str | None:
    if facts.week_s is not None and facts.duration_s is not None:
        (begin, from_), (end, until) = ((_DAYS[int(second // 86_400) % 7], _clock(second)) for second in facts.week_s)
        last = until if end == begin else f"{end} {until}"
        return f"{begin} {from_} to {last} of a week that the file does not name, {_duration(facts.duration_s)}"
    if facts.start is None or facts.end is None or facts.duration_s is None:
        return None
    (day, begin), (last, end) = (moment.rstrip("Z").split("T") for moment in (facts.start, facts.end))
    return f"{day} {begin} to {end if last == day else f'{last} {end}'} UTC, {_duration(facts.duration_s)}"


def _clock(second: float) -> str:
    minutes, seconds = divmod(int(second) % 86_400, 60)
    return f"{minutes // 60:02d}:{minutes % 60:02d}:{seconds:02d}"


def _duration(seconds: float) -> str:
    if seconds < 60:
        return f"{seconds:.3g} s"
    hours, rest = divmod(round(seconds), 3600)
    minutes, rest_s = divmod(rest, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {rest_s:02d} s"


def _pings(facts: Facts) -> str | None:
    if facts.pings is None or facts.kind in ("points", "submaps", "grid", "navigation"):
        return None
    unused = facts.pings - (facts.pings_used or 0)
    beams = f", {_beams(facts.beams)}" if facts.beams else ""
    return f"{facts.pings:,}{f', {unused:,} of them not used' if unused else ''}{beams}"


def _beams(beams: Mapping[str, int]) -> str:
    if beams["min"] == beams["max"]:
        return _count(beams["max"], "beam") + " each"
    return f"{beams['min']} to {_count(beams['max'], 'beam')} each, {beams['median']} in the median"


def _soundings(facts: Facts) -> str | None:
    if facts.soundings is None or facts.kind == "navigation":
        return None
    if facts.kind == "grid":
        size = f" of {facts.cell_m:g} m" if facts.cell_m else ""
        return f"{facts.soundings:,} cells{size}, {_share(facts)} with a depth"
    flags = f"; {_counts(facts.flagged)}" if facts.flagged else ""
    return f"{facts.soundings:,}, {_share(facts)} valid{flags}" if facts.soundings else "0"


def _share(facts: Facts) -> str:
    share = f" ({100 * (facts.valid or 0) / facts.soundings:.1f} %)" if facts.soundings else ""
    return f"{facts.valid:,}{share}"


def _length(metres: float | None) -> str | None:
    if metres is None:
        return None
    return f"{metres / 1000:.1f} km" if metres >= 10_000 else f"{metres:,.0f} m" if metres >= 100 else f"{metres:.1f} m"


def _area(square_metres: float) -> str:
    return f"{square_metres / 1e6:.2g} km²" if square_metres >= 1e5 else f"{square_metres:,.0f} m²"


def _depth(facts: Facts) -> str | None:
    if facts.depth_min_m is None:
        return None
    shown = f"{facts.depth_min_m:,.2f} to {facts.depth_max_m:,.2f} m"
    if facts.kind != SWATHS or facts.depth_extremes_m is None:
        return shown
    return shown + " (98 % of the valid ones; all: {:,.2f} to {:,.2f} m)".format(*facts.depth_extremes_m)


def _crs(facts: Facts) -> str | None:
    if facts.crs is None:
        return None
    words = earth.name(facts.crs)
    return words if facts.longitude_deg is None else f"{words}, from {_earth(facts.longitude_deg, facts.latitude_deg)}"


def _earth(longitude: float, latitude: float | None) -> str:
    north = latitude or 0.0
    return f"{abs(north):.5f}° {'N' if north >= 0 else 'S'} {abs(longitude):.5f}° {'E' if longitude >= 0 else 'W'}"


def _extent(facts: Facts) -> str | None:
    if facts.extent_m is None:
        return None
    west, south, east, north = facts.extent_m
    return f"{_length(east - west)} from west to east, {_length(north - south)} from south to north"


def _pose(pose: Mapping[str, float] | None) -> str | None:
    if pose is None:
        return None
    return "{x_m:.2f} m east, {y_m:.2f} m north, {z_m:.2f} m up, yaw {yaw_deg:.2f}°".format(**pose)


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count:,} {reason}" for reason, count in counts.items())


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}{'' if number == 1 else 's'}"
