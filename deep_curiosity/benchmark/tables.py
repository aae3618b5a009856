"""Tables of what was measured: rows read from CSV files, and medians and ranges of them."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from deep_curiosity.benchmark.agents import Row
from deep_curiosity.experiments.tables import median_and_range, read_table

Key = tuple[object, ...]


def read_rows(path: Path) -> list[Row]:
    """Rows of a CSV, numbers as such; none where there is no file."""
    return [
        {name: _number_or_text(value) for name, value in row.items()} for row in read_table(path)
    ]


def _number_or_text(value: str) -> float | str:
    try:
        return float(value)
    except ValueError:
        return value


def grouped(rows: Sequence[Row], *columns: str) -> dict[Key, list[Row]]:
    """Rows that agree in some columns, in the order of their first."""
    groups: dict[Key, list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[column] for column in columns), []).append(row)
    return groups


def summarize(rows: Sequence[Row], value: str | Callable[[Row], float]) -> str:
    """`median [lowest, highest]` over rows of a column or of what is computed of each row."""
    return median_and_range([row[value] if isinstance(value, str) else value(row) for row in rows])


def median(rows: Sequence[Row], column: str) -> float:
    """Of a column."""
    return float(np.median([row[column] for row in rows]))


def ratio(over: str, under: str) -> Callable[[Row], float]:
    """One column over another."""
    return lambda row: row[over] / row[under]


def rate_over(
    rows: Sequence[Row], reference: str, column: str = "runner"
) -> Callable[[Row], float]:
    """Steps per second of a row over those of a reference in the same round."""
    rates = {row["repeat"]: row["steps_per_second"] for row in rows if row[column] == reference}
    return lambda row: row["steps_per_second"] / rates[row["repeat"]]


def slope(values: Sequence[float], costs: Sequence[float]) -> float:
    """Exponent of a power law through all points: slope of the line through their logarithms.

    Example:
        >>> round(slope([1.0, 10.0, 100.0], [3.0, 30.0, 300.0]), 6)
        1.0
    """
    return float(np.polyfit(np.log(values), np.log(costs), 1)[0])


def size_name(column: str) -> str:
    """A size in words: `num_members` is the number of members."""
    return column.removeprefix("num_").replace("_", " ")
