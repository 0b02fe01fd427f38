"""The rates of the data generator as markdown tables, for docs/data.md."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from .trial_profile import STAGES


def rate_tables(content: Mapping[str, Any]) -> str:
    """Two tables of `bench_data`'s result: rates and agreement; where the time of a trial goes.

    Args:
        content: of the result file of `megrasp bench --stage data`.
    """
    rows = content["rows"]
    shares = [*STAGES, "around"]
    plain = 1000 * content["reference_timestep"]
    return "\n".join(
        [
            *_table(
                [
                    "gripper",
                    "timestep",
                    "full trials a second",
                    "plain",
                    "plain, CAD model",
                    "grasps that hold",
                    "hands by TCP and +X",
                    "labels as plain",
                    f"two plain runs at {plain:g} ms, 0.05 mm apart",
                    "collision tests a second",
                ],
                (
                    [
                        row["gripper"],
                        f"{1000 * row['timestep']:g} ms",
                        f"{row['full_trials_per_second']:.1f}",
                        f"{row['plain_full_trials_per_second']:.1f}",
                        _or_dash(row["cad_full_trials_per_second"], "{:.1f}"),
                        f"{row['yield']:.0%}",
                        _or_dash(row["yield_at_tcp"], "{:.0%}"),
                        f"{row['agrees_with_plain']:.1%}",
                        f"{row['plain_agrees_with_itself_moved']:.1%}",
                        f"{row['collision_tests_per_second']:,.0f}",
                    ]
                    for row in rows
                ),
            ),
            "",
            "Where the time of a trial goes, and contacts and solver iterations a step; what is "
            "around MuJoCo's\nstep holds the timing itself:",
            "",
            *_table(
                ["gripper", *shares, "contacts", "iterations"],
                (
                    [
                        row["gripper"],
                        *(f"{row['profile']['shares'][name]:.0%}" for name in shares),
                        f"{row['profile']['contacts']:.1f}",
                        f"{row['profile']['iterations']:.1f}",
                    ]
                    for row in rows
                    if row["profile"]
                ),
            ),
            "",
        ]
    )


def _or_dash(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)


def _table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    return [
        f"| {' | '.join(heads)} |",
        "|---" * len(heads) + "|",
        *(f"| {' | '.join(row)} |" for row in rows),
    ]
