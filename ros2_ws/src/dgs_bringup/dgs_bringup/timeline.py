"""What ran beside what: a picture of some attempts of a demo run, from its summary.json.

python -m dgs_bringup.timeline RUN/summary.json --first 2 --count 3 --out docs/images/timeline.png
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

_LOOK = ("capture", "predict", "planning", "waiting", "look_again")
"""Stages in which the arm does nothing for this attempt."""
_NO_STAGE = ("predicted", "recorded", "rejected")
"""Feedback that tells of a result; the first may come while the arm plans already."""


@dataclass(frozen=True)
class Bar:
    """One stage of one attempt; times in simulated seconds."""

    attempt: int
    stage: str
    start: float
    end: float

    @property
    def moves(self) -> bool:
        """Whether arm or hand work."""
        return self.stage not in _LOOK


def bars(timeline: Sequence[Mapping[str, Any]]) -> list[Bar]:
    """Every stage until the next one of the same attempt; what never ended is left out.

    `timeline`: entries with time, attempt and stage, in the order of time.
    """
    out = []
    for k, entry in enumerate(timeline):
        if entry["stage"] in _NO_STAGE:
            continue
        later = (e for e in timeline[k + 1 :] if e["attempt"] == entry["attempt"])
        end = next(
            (e["time"] for e in later if entry["stage"] == "predict" or e["stage"] != "predicted"), None
        )
        if end is not None:
            out.append(Bar(entry["attempt"], entry["stage"], entry["time"], end))
    return out


def overlap_seconds(stages: Sequence[Bar]) -> float:
    """How long looking and planning for one attempt ran beside motion for another [s]."""
    pairs = ((a, b) for a in stages for b in stages if not a.moves and a.stage != "waiting" and b.moves)
    return sum(max(0.0, min(a.end, b.end) - max(a.start, b.start)) for a, b in pairs)


def draw(stages: Sequence[Bar], path: Path) -> None:
    """A row per attempt."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    attempts = sorted({bar.attempt for bar in stages})
    begin = min(bar.start for bar in stages)
    figure, axes = pyplot.subplots(figsize=(11, 0.9 + 0.8 * len(attempts)), dpi=110)
    for bar in stages:
        colour = "#4878a8" if bar.moves else "#d8d8d8" if bar.stage == "waiting" else "#e0a040"
        row, width = attempts.index(bar.attempt), bar.end - bar.start
        axes.barh(row, width, left=bar.start - begin, height=0.7, color=colour, edgecolor="white")
        middle = bar.start - begin + width / 2
        axes.text(middle, row, bar.stage, ha="center", va="center", fontsize=7, rotation=90, color="black")
    axes.set_yticks(range(len(attempts)), [f"pick {attempt}" for attempt in attempts])
    axes.invert_yaxis()
    axes.set_xlabel("simulated time [s]")
    axes.spines[["top", "right", "left"]].set_visible(False)
    figure.tight_layout()
    figure.savefig(path)
    pyplot.close(figure)


def main(
    summary: Annotated[Path, typer.Argument(help="summary.json of a demo run.")],
    out: Annotated[Path, typer.Option(help="Picture.")] = Path("timeline.png"),
    first: Annotated[int, typer.Option(min=1, help="Attempt to begin with.")] = 1,
    count: Annotated[int, typer.Option(min=1, help="So many attempts.")] = 3,
) -> None:
    """Draw what ran beside what in some attempts of a demo run."""
    wanted = range(first, first + count)
    try:
        stages = [bar for bar in bars(json.loads(summary.read_text())["timeline"]) if bar.attempt in wanted]
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise typer.BadParameter(f"{summary} is no summary.json of a demo run: {error!r}") from error
    if not stages:
        raise typer.BadParameter(f"the run has no attempts {first} to {first + count - 1}")
    try:
        draw(stages, out)
    except (OSError, ValueError) as error:
        raise typer.BadParameter(f"no picture can be written to {out}: {error}") from error
    typer.echo(f"{out}: {overlap_seconds(stages):.1f} s of looking and planning beside motion")


if __name__ == "__main__":
    typer.run(main)
