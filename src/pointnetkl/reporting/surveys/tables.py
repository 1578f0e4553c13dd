"""Tables of surveys: Table I, and what was left out of each survey before it was cut, and why."""

from collections.abc import Iterator
from typing import Any

import pyarrow.parquet as pq

from pointnetkl.reporting import paper
from pointnetkl.reporting.results import Folders
from pointnetkl.reporting.text_table import Block, Numbers, block
from pointnetkl.workflow import artifacts

_SIZES = ("area_km2", "submaps", "sigma_z")
_FLAGS = ("rejected", "impossible", "outliers")
DROPPED = {  # columns, by the words of stage segment
    "alone": "soundings standing alone",
    "on_turns": "pings on turns",
    "in_ends": "pings in them",
    "gaps": "gaps in lines",
    "missed_m": "metres missed in gaps",
}
_READ = ("pings", "pings_left_out", "reordered", "soundings", "soundings_left_out", *_FLAGS, "valid")
_CUT = (*DROPPED, "submaps", "submaps_left_out")
_IN_WORDS = {
    "rejected": "soundings that the sonar or its operator rejects",
    "impossible": "soundings that are impossible",
    "outliers": "outliers: soundings that disagree with their neighbours",
    "pings in them": "pings in ends of lines",
}


def read(folders: Folders) -> dict[str, dict[str, Any]]:
    """Return what stages ingest and segment counted of each survey, from their artifacts."""
    counts = {}
    for name in folders.study.surveys:
        pings, poses = folders.survey(name, "pings.parquet"), folders.product(name, "poses.parquet")
        counts[name] = {
            "ingest": artifacts.table_metadata(pings).get("report", {}),
            "segment": artifacts.table_metadata(poses).get("dropped", {}),
            "pings": pq.read_metadata(pings).num_rows,
            "submaps": pq.read_metadata(poses).num_rows,
        }
    return counts


def every(cleaned: Numbers, datasets: Numbers) -> dict[str, list[Block]]:
    """Return the tables by the stems of their files; `cleaned` is what `read` returns."""
    return {"table_1": table_1(datasets), "cleaning": cleaning(cleaned, datasets)}


def table_1(datasets: Numbers) -> list[Block]:
    """Return Table I: each survey's vehicle, area, submaps and sigma_z, the paper's beside; then their density."""
    rows = [{"survey": name, **numbers, **_paper_sizes(name, numbers)} for name, numbers in datasets.items()]
    sizes = [column for size in _SIZES for column in (size, f"paper_{size}", f"ratio_{size}")]
    density = ("track_km", "points_mean", "points_std", "spacing_m", "label_runs", "self_matching")
    return [
        block(
            "Table I. Surveys: size, and spread of the normalised points.",
            rows,
            ["survey", "simulated", "vehicle", *sizes],
        ),
        block("Points per registration cloud, and registrations per label.", rows, ["survey", "simulated", *density]),
    ]


def cleaning(cleaned: Numbers, datasets: Numbers) -> list[Block]:
    """Return a row for each survey of `read`; then every reason for which something was left out."""
    rows = [{"survey": n, "simulated": datasets[n]["simulated"], **_counts(stages)} for n, stages in cleaned.items()]
    reasons = [
        {"survey": n, "simulated": datasets[n]["simulated"], "stage": stage, "left_out": reason, "count": count}
        for n, stages in cleaned.items()
        for stage, reason, count in _reasons(stages)
    ]
    return [
        block("Cleaning: what was read, left out or flagged, and cut.", rows, ["survey", "simulated", *_READ, *_CUT]),
        block("Left out, by stage and reason.", reasons, ["survey", "simulated", "stage", "left_out", "count"]),
    ]


def _counts(stages: Numbers) -> dict[str, Any]:
    """Return a survey's row, without the columns that its artifacts do not tell."""
    report, dropped = stages["ingest"], stages["segment"]
    row = {name: report[name] for name in _READ if name in report} | dict(report.get("flagged", {}))
    if report:
        row["pings_left_out"] = report["pings"] - stages["pings"]
        row["soundings_left_out"] = report["soundings"] - report["valid"] - sum(report.get("flagged", {}).values())
    row |= {column: dropped[reason] for column, reason in DROPPED.items() if reason in dropped}
    submaps_left_out = sum(count for reason, count in dropped.items() if reason.startswith("submaps"))
    return row | {"submaps": stages["submaps"], "submaps_left_out": submaps_left_out}


def _reasons(stages: Numbers) -> Iterator[tuple[str, str, int]]:
    report = stages["ingest"]
    for stage, counts in (
        ("ingest", {**report.get("skipped", {}), **report.get("flagged", {})}),
        ("segment", stages["segment"]),
    ):
        yield from ((stage, _IN_WORDS.get(reason, reason), count) for reason, count in counts.items() if count)


def _paper_sizes(name: str, ours: Numbers) -> dict[str, Any]:
    if name not in paper.DATASETS:
        return {}
    theirs = {size: getattr(paper.DATASETS[name], size) for size in _SIZES}
    ratios = {f"ratio_{size}": ours[size] / theirs[size] for size in _SIZES}
    return {**{f"paper_{size}": value for size, value in theirs.items()}, **ratios}
