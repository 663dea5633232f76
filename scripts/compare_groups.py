"""Two metrics.json as one table by group, for documents: before and after.

    python scripts/compare_groups.py BEFORE/metrics.json AFTER/metrics.json --detector fusion

The means leave out what the second run leaves out.
"""

import argparse
import json
from pathlib import Path
from typing import Any

FLOOR = "prior:rows"


def groups(path: Path, detector: str) -> dict[str, Any]:
    """The figures of a detector in a metrics.json by group, those left out among them."""
    found = json.loads(path.read_text(encoding="utf-8"))["detectors"][detector]
    return {**found["groups"], **found.get("left_out", {})}


def table(before: Path, after: Path, detector: str) -> str:
    """Markdown: F of the mask at the default threshold and MaxF, IoU and the floor's MaxF."""
    one, two, floor = groups(before, detector), groups(after, detector), groups(after, FLOOR)
    left_out = json.loads(after.read_text(encoding="utf-8"))["left_out"]
    rows = {
        name: _values(one[name], two[name], floor[name])
        for name in sorted(two)
        if name not in left_out
    }
    means = [sum(column) / len(rows) for column in zip(*rows.values(), strict=True)]
    lines = [
        f"| group | F before | F | MaxF before | MaxF | IoU | `{FLOOR}` MaxF |",
        "|---|---|---|---|---|---|---|",
        *(_line(name, values) for name, values in rows.items()),
        _line(f"**mean of {len(rows)}**", means),
    ]
    return "\n".join(lines)


def _values(one: dict[str, Any], two: dict[str, Any], floor: dict[str, Any]) -> list[float]:
    before_and_after = [run[key] for key in ("f_mask", "maxf") for run in (one, two)]
    return [*before_and_after, two["iou_mask"], floor["maxf"]]


def _line(name: str, values: list[float]) -> str:
    return f"| {name} | " + " | ".join(f"{value:.3f}" for value in values) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description="Two metrics.json as one table by group.")
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("--detector", default="fusion")
    arguments = parser.parse_args()
    print(table(arguments.before, arguments.after, arguments.detector))


if __name__ == "__main__":
    main()
